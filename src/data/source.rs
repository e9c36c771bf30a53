//! Which dataset, and where it lies.

use super::{Dataset, Folder, FolderConfig, Rooms, RoomsConfig, Split, nyu};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The kinds of datasets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DatasetKind {
    /// Procedural rooms; needs no files.
    #[default]
    Rooms,
    /// NYU Depth v2.
    Nyu,
    /// Any tree described by path templates.
    Folder,
}

impl DatasetKind {
    /// The name in configs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rooms => "rooms",
            Self::Nyu => "nyu",
            Self::Folder => "folder",
        }
    }
}

/// A dataset and its place.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// The kind of dataset.
    pub dataset: DatasetKind,
    /// Its folder; `LSDC_DATA/<dataset>` or `LSDC_DATA` if absent.
    pub root: Option<PathBuf>,
    /// Templates of `dataset = "folder"`.
    pub folder: FolderConfig,
    /// Settings of `dataset = "rooms"`.
    pub rooms: RoomsConfig,
}

impl DataConfig {
    /// Opens the dataset; `fallback` is the folder that holds datasets by name.
    ///
    /// # Errors
    /// An unknown or unreadable folder, or no frame in it.
    pub fn open(&self, split: Split, fallback: Option<&Path>) -> Result<Arc<dyn Dataset>> {
        Ok(match self.dataset {
            DatasetKind::Rooms => Arc::new(Rooms::new(split, &self.rooms)?),
            DatasetKind::Nyu => Arc::new(nyu(&self.folder_of(fallback)?, split)?),
            DatasetKind::Folder => Arc::new(Folder::open(
                &self.folder_of(fallback)?,
                split,
                &self.folder,
            )?),
        })
    }

    fn folder_of(&self, fallback: Option<&Path>) -> Result<PathBuf> {
        if let Some(root) = &self.root {
            return Ok(root.clone());
        }
        let name = self.dataset.name();
        let base = fallback.ok_or_else(|| {
            Error::config(format!("dataset `{name}` needs a folder")).hint(
                "give --root DIR, set `data.root` in the config, or LSDC_DATA in the environment",
            )
        })?;
        let named = base.join(name);
        Ok(if named.is_dir() {
            named
        } else {
            base.to_owned()
        })
    }
}
