//! Training of basis functions.

use super::TrainConfig;
use super::calibrate;
use super::learner::{FitObjective, Learner};
use super::record::TrainingRecord;
use super::run::{Subject, Trainer};
use super::setup::{check_network, teacher_weights, with_backbone};
use crate::device::Device;
use crate::model::{AnyEncoder, BasisNet, InitNetwork as _, OnDevice, load, transfer, weights_of};
use crate::predict::completer;
use crate::sample::Encoding;
use burn::module::Module as _;
use lsdc_core::fit::FitConfig;
use lsdc_core::network::{Encoder, NetworkConfig};
use lsdc_core::weights::Normalisation;
use lsdc_core::{Completer, Weights};
use lsdc_eval::data::{Mixture, write_atomically};
use lsdc_eval::predict::DepthCompleter;
use lsdc_files::error::Result;
use lsdc_weights::{Precision, SCORES_NOTE, TRAINING_NOTE, encoder_of, open_weights, to_bytes};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Settings and inputs for training basis functions.
pub struct BasisFunctions {
    pub(super) network: NetworkConfig,
    pub(super) fit: FitConfig,
    /// Weights of the teacher, if its network is compared with.
    pub(super) teacher_weights: Option<Weights>,
    /// Pretrained encoder whose features the network reads, if it has one.
    pub(super) encoder: Option<Arc<Encoder>>,
}

impl Trainer<BasisFunctions> {
    /// Prepares a run in `folder`, which must exist. Several devices divide every batch; the first one also evaluates and
    /// calibrates.
    ///
    /// # Errors
    /// A setting is out of range, there is no device or more devices than images in a batch, or no frame can be read.
    pub fn new(
        folder: &Path,
        network: NetworkConfig,
        fit: FitConfig,
        config: TrainConfig,
        frames: impl Into<Mixture>,
        devices: &[Device],
    ) -> Result<Self> {
        network.check()?;
        check_network(&network, &config)?;
        fit.check()?;
        let normal = |input| Normalisation {
            input,
            ..Normalisation::default()
        };
        let subject = |normalisation: &Normalisation| {
            Ok(BasisFunctions {
                teacher_weights: teacher_weights(&config, normalisation)?,
                encoder: encoder_of(&network)?,
                network: network.clone(),
                fit,
            })
        };
        let mut run = Self::of(folder, normal, subject, config.clone(), frames, devices)?;
        let bases = &run.subject;
        let encoding = match (&bases.encoder, &bases.teacher_weights) {
            (None, Some(weights)) => encoder_of(&weights.network)?,
            _ => bases.encoder.clone(),
        }
        .map(|encoder| Encoding::new(encoder, run.normalisation, config.features.clone()));
        run.sampler = run.sampler.encoded(encoding);
        Ok(run)
    }
}

impl BasisFunctions {
    /// Returns the initial network, and the number of its tensors that the start weights do not have.
    fn initial(&self, run: &Trainer<Self>, device: &Device) -> Result<(BasisNet, usize)> {
        let net = self.network.init(run.config.seed, device)?;
        let net = with_backbone(net, &self.network, &run.config.backbone)?;
        let Some(path) = &run.config.start else {
            return Ok((net, 0));
        };
        transfer(&open_weights(Some(path))?, net)
    }
}

impl Subject for BasisFunctions {
    type Net = BasisNet;
    type Objective = FitObjective;

    fn settings(&self) -> Value {
        json!({ "network": self.network, "fit": self.fit })
    }

    fn start(&self, run: &Trainer<Self>, device: &Device) -> Result<BasisNet> {
        Ok(self.initial(run, device)?.0)
    }

    fn learner(&self, run: &Trainer<Self>, device: &Device) -> Result<Learner> {
        let (net, new) = self.initial(run, device)?;
        if run.config.start.is_some() {
            tracing::info!(
                "{new} tensors are not those of the start weights: they begin at random, or with the backbone's"
            );
        }
        let teacher = self.teacher_weights.as_ref();
        let teacher = teacher.map(|weights| load(weights, run.device()));
        Ok(Learner::new(net, &self.fit, &run.config).with_teacher(teacher.transpose()?))
    }

    fn completes(&self, run: &Trainer<Self>, net: &BasisNet) -> Result<Box<dyn DepthCompleter>> {
        let weights = Weights::new(self.network.clone(), run.normalisation, BTreeMap::new());
        let network = OnDevice::new(
            net.valid(),
            self.encoder.clone().map(AnyEncoder::Prepared),
            run.device(),
        );
        let completer = Completer::builder(&weights).network(Arc::new(network));
        Ok(Box::new(completer.fit(self.fit).build()?))
    }

    fn publish(&self, run: &Trainer<Self>, net: &BasisNet, record: TrainingRecord) -> Result<()> {
        let mut weights = weights_of(&net.valid(), self.network.clone(), run.normalisation);
        let start_prior = record.start_prior(&self.network).cloned();
        record.add_to(&mut weights.notes, &run.folder)?;
        weights.notes.insert(TRAINING_NOTE.to_owned(), run.note()?);
        weights.record_fit(&self.fit);
        let write = |weights: &Weights| {
            let bytes = to_bytes(weights, Precision::Half)?;
            write_atomically(&run.weights_path(), |out| out.write_all(&bytes))
        };
        // The trained weights are not lost if the calibration fails.
        write(&weights)?;
        if run.config.calibrate {
            if let Some(prior) = &start_prior {
                // Kept if there are too few frames to learn another prior.
                weights.record_prior(prior, 1.0, None);
            }
            let (frames, config) = (run.frames.as_ref(), &run.config);
            calibrate(&mut weights, frames, config, run.device(), |_, _| {})?;
        }
        if let Some(scores) =
            run.scores_note(|| Ok(Box::new(completer(&weights, run.device())?)))?
        {
            weights.notes.insert(SCORES_NOTE.to_owned(), scores);
        }
        write(&weights)
    }
}
