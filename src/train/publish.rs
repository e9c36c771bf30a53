//! What a run measures, and the weights file that it leaves.

use super::calibrate;
use super::record::Record;
use super::run::{Bases, Trainer};
use crate::data::{DepthMap, write_atomically};
use crate::error::{Cause, Error, Result};
use crate::metrics::{Rules, Scores, Tally};
use crate::model::{AnyEncoder, BasisNet, OnDevice, Precision, to_bytes, weights_of};
use crate::predict::{complete, completer};
use crate::sample::Pattern;
use crate::systems::{Net, Predictor, SystemConfig, Trained};
use burn::module::Module;
use image::RgbImage;
use lsdc_core::{Completer, Weights};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

/// The note of a weights file that holds the `TrainConfig` it was trained by.
pub const TRAINING_NOTE: &str = "training";

/// The note of a weights file that holds the `Scores` on frames kept out of training, at 500
/// points.
pub const SCORES_NOTE: &str = "held_out";

impl Trainer {
    /// What completes with the network of a run.
    pub(super) fn completer(&self, bases: &Bases, net: &BasisNet) -> Result<Completer> {
        let weights = Weights::new(bases.network.clone(), self.normalisation, BTreeMap::new());
        let network = OnDevice::new(
            net.valid(),
            bases.encoder.clone().map(AnyEncoder::Prepared),
            self.device(),
        )?;
        let completer = Completer::builder(&weights).network(Arc::new(network));
        Ok(completer.fit(bases.fit).build()?)
    }

    /// The scores on the frames kept out of training.
    pub(super) fn measure(&self, method: &impl Completes) -> Result<Scores> {
        let mut tally = Tally::default();
        for &index in &self.held_out {
            let frame = self.config.protocol.apply(&self.frames.load(index)?)?;
            let sparse = Pattern::Exactly(500).draw(&frame, 0)?;
            let depth = method.depth(&frame.rgb, &sparse)?;
            tally.add(&Scores::of(&depth, &frame.depth, &Rules::default())?);
        }
        Ok(tally.mean().unwrap_or_default())
    }

    /// The file of the result.
    fn weights(&self) -> PathBuf {
        self.folder.join("weights.safetensors")
    }

    /// The settings of the training, as weights files hold them.
    fn note(&self) -> Result<String> {
        serde_json::to_string(&self.config)
            .map_err(|e| Error::new(Cause::Write, "cannot encode the settings").because(e))
    }

    /// What weights files tell of the run, whose subject has these settings.
    pub(super) fn record(&self, mut settings: Value) -> Result<Record> {
        settings["train"] = json!(self.config);
        settings["devices"] = json!(self.devices.len());
        Record::new(&self.config, self.data.clone(), settings)
    }

    /// Writes `weights.safetensors`.
    pub(super) fn publish(&self, bases: &Bases, net: &BasisNet, record: Record) -> Result<()> {
        let mut weights = weights_of(&net.valid(), bases.network.clone(), self.normalisation);
        record.keep(&mut weights.notes, &self.folder)?;
        weights.notes.insert(TRAINING_NOTE.to_owned(), self.note()?);
        weights.record_fit(&bases.fit);
        let write = |weights: &Weights| {
            let bytes = to_bytes(weights, Precision::Half)?;
            write_atomically(&self.weights(), |out| out.write_all(&bytes))
        };
        // What was trained is not lost if its calibration fails.
        write(&weights)?;
        if self.config.calibrate {
            let (frames, config) = (self.frames.as_ref(), &self.config);
            calibrate(&mut weights, frames, config, self.device(), |_, _| {})?;
        }
        if !self.held_out.is_empty() {
            let completer = completer(&weights, self.device())?;
            let scores = encoded(&self.measure(&completer)?)?;
            weights.notes.insert(SCORES_NOTE.to_owned(), scores);
        }
        write(&weights)?;
        Ok(())
    }

    /// The same for a system.
    pub(super) fn publish_system(
        &self,
        system: &SystemConfig,
        net: &Net,
        measure: impl Fn(&Net) -> Result<Scores>,
        record: Record,
    ) -> Result<()> {
        let mut trained = Trained::of(&net.valid(), system.clone(), self.normalisation);
        record.keep(&mut trained.notes, &self.folder)?;
        trained.notes.insert(TRAINING_NOTE.to_owned(), self.note()?);
        if !self.held_out.is_empty() {
            let scores = encoded(&measure(net)?)?;
            trained.notes.insert(SCORES_NOTE.to_owned(), scores);
        }
        let bytes = trained.to_bytes(Precision::Half)?;
        write_atomically(&self.weights(), |out| out.write_all(&bytes))
    }
}

fn encoded(scores: &Scores) -> Result<String> {
    serde_json::to_string(scores)
        .map_err(|e| Error::new(Cause::Write, "cannot encode the scores").because(e))
}

/// What a run is measured by.
pub(super) trait Completes {
    fn depth(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap>;
}

impl Completes for Completer {
    fn depth(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
        Ok(complete(self, rgb, sparse)?.depth()?)
    }
}

impl Completes for Predictor {
    fn depth(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
        self.complete(rgb, sparse)
    }
}
