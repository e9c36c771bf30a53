//! Choice and location of a dataset.

use super::sets::{self, DiodeConfig, Folder, FolderConfig, NyuConfig, Rooms, RoomsConfig};
use super::{Dataset, Mixture, Split, check_name};
use lsdc_files::error::{Error, Result};
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
    /// Images with the returns of a laser scanner.
    Scans,
    /// Any tree described by path templates.
    Folder,
}

impl DatasetKind {
    /// All kinds.
    pub const ALL: [Self; 9] = [
        Self::Rooms,
        Self::Nyu,
        Self::Diode,
        Self::Kitti,
        Self::Void,
        Self::Tum,
        Self::Marigold,
        Self::Scans,
        Self::Folder,
    ];

    /// Returns the name in configs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rooms => "rooms",
            Self::Nyu => "nyu",
            Self::Diode => "diode",
            Self::Kitti => "kitti",
            Self::Void => "void",
            Self::Tum => "tum",
            Self::Marigold => "marigold",
            Self::Scans => "scans",
            Self::Folder => "folder",
        }
    }
}

/// A dataset with its location and settings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// The kind of dataset.
    pub dataset: DatasetKind,
    /// Folder or file of the dataset; `LSDC_DATA/<dataset>` or `LSDC_DATA` if absent.
    pub root: Option<PathBuf>,
    /// For datasets in `more`: share of all training frames. If absent, each frame is drawn as often as a frame of the first
    /// dataset.
    pub share: Option<f64>,
    /// Settings of `dataset = "nyu"`.
    pub nyu: NyuConfig,
    /// Settings of `dataset = "diode"`.
    pub diode: DiodeConfig,
    /// Templates of `dataset = "folder"`.
    pub folder: FolderConfig,
    /// Settings of `dataset = "rooms"`.
    pub rooms: RoomsConfig,
    /// Further datasets for `lsdc train`. Validation and calibration use only the first dataset.
    pub more: Vec<Self>,
}

impl DataConfig {
    /// Checks the shares.
    ///
    /// # Errors
    /// A share that is not above 0, or shares that leave none to the first dataset.
    pub fn check(&self) -> Result<()> {
        let shares = || self.more.iter().filter_map(|more| more.share);
        let sum: f64 = shares().sum();
        if self.share.is_some() || self.more.iter().any(|more| !more.more.is_empty()) {
            return Err(Error::config(
                "`data.share` and `more` of `more` have no meaning: only those of `data.more` have shares",
            ));
        }
        if sum < 1.0 && shares().all(|share| share > 0.0) {
            return Ok(());
        }
        Err(
            Error::config("the shares of `data.more` must be above 0 and add up to less than 1")
                .hint("the first dataset has the rest"),
        )
    }

    /// Opens the dataset and all further ones.
    ///
    /// # Errors
    /// The errors of [`Self::open`].
    pub fn open_all(&self, split: Split, fallback: Option<&Path>) -> Result<Mixture> {
        let first = self.open(split, fallback)?;
        let more = self.more.iter();
        let more = more.map(|more| Ok((more.open(split, fallback)?, more.share)));
        Ok(Mixture::new(first, more.collect::<Result<_>>()?))
    }

    /// Opens the dataset without further ones; `fallback` is the folder that contains datasets by name.
    ///
    /// # Errors
    /// An unknown or unreadable folder, no frame in it, or frames whose names are not unique or lead out of the folder.
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
            DatasetKind::Scans => Arc::new(sets::scans(&root()?)?),
            DatasetKind::Folder => Arc::new(Folder::open(&root()?, split, &self.folder)?),
        };
        // Results are stored under the names of frames.
        let mut names = HashSet::new();
        for index in 0..frames.len() {
            let name = frames.id(index);
            check_name(&name)?;
            if let Some(name) = names.replace(name) {
                let what = format!("two frames are called `{name}` in {}", frames.description());
                return Err(Error::config(what).hint("give folders or files other names"));
            }
        }
        Ok(frames)
    }

    /// Returns the location of the dataset: its `root`, or a path below `fallback`.
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
