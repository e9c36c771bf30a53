//! Flags laid over the configuration.

use super::args::{Settings, Source};
#[cfg(not(feature = "train"))]
use super::ui;
use crate::config::Config;
#[cfg(feature = "train")]
use lsdc_eval::data::Mixture;
use lsdc_eval::data::{DataConfig, Dataset, Split};
use lsdc_files::error::Result;
use std::path::{Path, PathBuf};
use std::sync::Arc;

impl Settings {
    /// The configuration of file and `--set`.
    pub(super) fn load(&self) -> Result<Config> {
        let config = Config::load(self.config.as_deref(), &self.set)?;
        #[cfg(not(feature = "train"))]
        if config.has_ignored_settings() {
            ui::say("settings of `train` and `system` are ignored: this build cannot train");
        }
        Ok(config)
    }
}

impl Source {
    /// Lays `--dataset` and `--root` over the configuration.
    pub(super) fn apply(&self, data: &mut DataConfig) {
        if let Some(dataset) = self.dataset {
            data.dataset = dataset;
        }
        if let Some(root) = &self.root {
            data.root = Some(root.clone());
        }
    }
}

/// Full path of the folder of a dataset; `None` if none is known.
pub(super) fn folder(data: &DataConfig) -> Option<PathBuf> {
    let folder = data.folder(fallback().as_deref()).ok()?;
    Some(absolute(&folder))
}

/// A path that means the same in every working folder.
pub(super) fn absolute(path: &Path) -> PathBuf {
    std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned())
}

fn fallback() -> Option<PathBuf> {
    std::env::var_os("LSDC_DATA").map(PathBuf::from)
}

/// Opens a dataset, looking below `LSDC_DATA` if the configuration names no folder.
pub(super) fn open(data: &DataConfig, split: Split) -> Result<Arc<dyn Dataset>> {
    data.open(split, fallback().as_deref())
}

/// Opens the dataset and all further ones that are learned from, in the same way.
#[cfg(feature = "train")]
pub(super) fn open_all(data: &DataConfig) -> Result<Mixture> {
    data.open_all(Split::Train, fallback().as_deref())
}
