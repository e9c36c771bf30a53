//! Which dataset, and where it lies.

use super::sets::{self, DiodeConfig, Folder, FolderConfig, NyuConfig, Rooms, RoomsConfig};
use super::{Dataset, Split, check_name};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
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
    /// DIODE.
    Diode,
    /// KITTI depth completion.
    Kitti,
    /// VOID.
    Void,
    /// A TUM RGB-D sequence.
    Tum,
    /// Marigold-DC's folder of images, points and truth.
    Marigold,
    /// Any tree described by path templates.
    Folder,
}

impl DatasetKind {
    /// All kinds.
    pub const ALL: [Self; 8] = [
        Self::Rooms,
        Self::Nyu,
        Self::Diode,
        Self::Kitti,
        Self::Void,
        Self::Tum,
        Self::Marigold,
        Self::Folder,
    ];

    /// The name in configs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rooms => "rooms",
            Self::Nyu => "nyu",
            Self::Diode => "diode",
            Self::Kitti => "kitti",
            Self::Void => "void",
            Self::Tum => "tum",
            Self::Marigold => "marigold",
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
    /// Its folder, or the file that holds it; `LSDC_DATA/<dataset>` or `LSDC_DATA` if absent.
    pub root: Option<PathBuf>,
    /// Settings of `dataset = "nyu"`.
    pub nyu: NyuConfig,
    /// Settings of `dataset = "diode"`.
    pub diode: DiodeConfig,
    /// Templates of `dataset = "folder"`.
    pub folder: FolderConfig,
    /// Settings of `dataset = "rooms"`.
    pub rooms: RoomsConfig,
}

impl DataConfig {
    /// Opens the dataset; `fallback` is the folder that holds datasets by name.
    ///
    /// # Errors
    /// An unknown or unreadable folder, no frame in it, or frames whose names are not their own or
    /// lead out of a folder.
    pub fn open(&self, split: Split, fallback: Option<&Path>) -> Result<Arc<dyn Dataset>> {
        let root = || self.folder(fallback);
        let frames: Arc<dyn Dataset> = match self.dataset {
            DatasetKind::Rooms => Arc::new(Rooms::new(split, &self.rooms)?),
            DatasetKind::Nyu => sets::nyu(&root()?, split, self.nyu)?,
            DatasetKind::Diode => Arc::new(sets::diode(&root()?, split, self.diode)?),
            DatasetKind::Kitti => Arc::new(sets::kitti(&root()?, split)?),
            DatasetKind::Void => Arc::new(sets::void(&root()?, split)?),
            DatasetKind::Tum => Arc::new(sets::tum(&root()?)?),
            DatasetKind::Marigold => Arc::new(sets::marigold(&root()?)?),
            DatasetKind::Folder => Arc::new(Folder::open(&root()?, split, &self.folder)?),
        };
        // Results are kept under the names of frames.
        let mut names = HashSet::new();
        for index in 0..frames.len() {
            let name = frames.id(index);
            check_name(&name)?;
            if let Some(name) = names.replace(name) {
                let what = format!("two frames are called `{name}` in {}", frames.about());
                return Err(Error::config(what).hint("give folders or files other names"));
            }
        }
        Ok(frames)
    }

    /// Where the files of the dataset lie: its `root`, or below `fallback`.
    ///
    /// # Errors
    /// Neither is known.
    pub fn folder(&self, fallback: Option<&Path>) -> Result<PathBuf> {
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
        Ok(if named.exists() {
            named
        } else {
            base.to_owned()
        })
    }
}
