//! The context of experiments: frames, networks, and training recipes.

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

/// The inputs shared by all experiments.
pub struct ExperimentContext {
    /// Folder of all results: records of parts in `cells`, trained networks in `runs`.
    pub folder: PathBuf,
    /// Description of dataset and split.
    pub dataset: String,
    /// Frames for evaluation.
    pub frames: Arc<dyn Dataset>,
    /// Protocol of the frames.
    pub preset: ProtocolPreset,
    /// Parameters of the metrics.
    pub rules: Rules,
    /// Limit of the number of frames; the first frames are used.
    pub limit: Option<usize>,
    /// Seeds of the draws of points.
    pub seeds: Vec<u64>,
    /// Network with its fit.
    pub completer: Completer,
    /// Description of the weights.
    pub weights: String,
    /// Configuration of the network.
    pub network: NetworkConfig,
    /// Guides for the experiment `knowledge`, by frame names.
    pub guides: Option<GuideSource>,
    /// Depth maps of other programs for the benchmark, by name.
    pub predictions: Vec<(String, PathBuf)>,
    /// Trained systems for the experiment `systems`, by name; if empty, the experiment trains them.
    pub systems: Vec<(String, Predictor)>,
    /// DIODE with a description of its location, if available.
    pub diode: Option<Arc<dyn Dataset>>,
    /// Recipe of networks trained by experiments.
    pub recipe: Recipe,
    /// Device with its name.
    pub device: (Device, String),
    /// Further inputs of the numbers: locations of datasets and how they are opened. Results with other inputs are not reused.
    pub place: serde_json::Value,
    /// Duration of the first run of each part, to estimate the remaining time.
    pub probe_time: Duration,
}

impl ExperimentContext {
    pub(super) fn trials(&self) -> PathBuf {
        self.folder.join("cells")
    }

    pub(super) fn runs(&self) -> PathBuf {
        self.folder.join("runs")
    }

    /// Returns the file of a part.
    pub(super) fn trial(&self, name: &str, ending: &str) -> PathBuf {
        self.trials().join(format!("{name}.{ending}"))
    }

    /// Describes the settings shared by all experiments on the dataset.
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

/// Settings and data for training networks.
pub struct Recipe {
    /// Base network, which experiments vary.
    pub network: NetworkConfig,
    /// Fit used in training.
    pub fit: FitConfig,
    /// Training settings shared by all networks.
    pub train: TrainConfig,
    /// Systems trained for comparison.
    pub systems: Vec<SystemRecipe>,
    /// Opens the training frames when they are needed.
    pub frames: Box<dyn Fn() -> Result<Arc<dyn Dataset>>>,
}

/// Settings for training a system.
pub struct SystemRecipe {
    /// Name in tables.
    pub name: String,
    /// System with its sizes.
    pub system: SystemConfig,
    /// Training settings of the system, with the same steps, images and frames as the others.
    pub train: TrainConfig,
}
