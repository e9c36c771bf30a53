//! What experiments work with: frames, networks, and how others are trained.

use crate::systems::{Predictor, SystemConfig};
use burn::tensor::Device;
use lsdc_core::Completer;
use lsdc_core::fit::FitConfig;
use lsdc_core::network::NetworkConfig;
use lsdc_eval::data::{Dataset, GuideSource};
use lsdc_eval::metrics::Rules;
use lsdc_eval::sampling::ProtocolPreset;
use lsdc_files::error::Result;
use lsdc_train::training::TrainConfig;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// What experiments work with.
pub struct ExperimentContext {
    /// Where everything is kept: records of parts below `cells`, trained networks below `runs`.
    pub folder: PathBuf,
    /// The dataset and split in words.
    pub dataset: String,
    /// The frames to measure on.
    pub frames: Arc<dyn Dataset>,
    /// Their protocol.
    pub preset: ProtocolPreset,
    /// What the measures leave open.
    pub rules: Rules,
    /// Only the first frames.
    pub limit: Option<usize>,
    /// Names the draws of points.
    pub seeds: Vec<u64>,
    /// The network and its fit.
    pub completer: Completer,
    /// Its weights in words.
    pub weights: String,
    /// The shape of the network.
    pub network: NetworkConfig,
    /// Guides for the experiment `knowledge`, by the names of frames.
    pub guides: Option<GuideSource>,
    /// Depth maps of other programs for the benchmark, by name.
    pub predictions: Vec<(String, PathBuf)>,
    /// Trained systems for the experiment `systems`, by name; none: it trains them.
    pub systems: Vec<(String, Predictor)>,
    /// DIODE, and where it lies in words, if there is one.
    pub diode: Option<Arc<dyn Dataset>>,
    /// How the ablation trains.
    pub recipe: Recipe,
    /// Where to compute, and its name.
    pub device: (Device, String),
    /// What numbers depend on beside the settings here: where datasets lie and how they are opened.
    /// What was measured from something else is not used again.
    pub place: serde_json::Value,
    /// How long each part runs first, to estimate the time of the rest.
    pub probe_time: Duration,
}

impl ExperimentContext {
    pub(super) fn trials(&self) -> PathBuf {
        self.folder.join("cells")
    }

    pub(super) fn runs(&self) -> PathBuf {
        self.folder.join("runs")
    }

    /// The file of a part.
    pub(super) fn trial(&self, name: &str, ending: &str) -> PathBuf {
        self.trials().join(format!("{name}.{ending}"))
    }

    /// What all experiments on the dataset have in common, in words.
    pub(super) fn about(&self) -> String {
        let frames = self.frames.len().min(self.limit.unwrap_or(usize::MAX));
        let draws = match self.seeds.len() {
            1 => "one draw of points".to_owned(),
            n => format!("mean of {n} draws of points"),
        };
        format!(
            "{}, {frames} frames, protocol {} ({}), {draws}; {}.",
            self.dataset, self.preset.name, self.preset.protocol, self.weights
        )
    }
}

/// How networks are trained, and on what.
pub struct Recipe {
    /// The network that is changed in one way or another.
    pub network: NetworkConfig,
    /// The fit to train through.
    pub fit: FitConfig,
    /// The settings of all trainings.
    pub train: TrainConfig,
    /// The systems that are trained beside it.
    pub systems: Vec<SystemRecipe>,
    /// The frames to learn from, opened when they are needed.
    pub frames: Box<dyn Fn() -> Result<Arc<dyn Dataset>>>,
}

/// How a system is trained.
pub struct SystemRecipe {
    /// Its name in tables.
    pub name: String,
    /// The system and its sizes.
    pub system: SystemConfig,
    /// Its own settings, with the steps, images and frames of the others.
    pub train: TrainConfig,
}
