//! Datasets: reading frames from files, and describing datasets.

mod frame;
mod mixture;
mod sequence;
mod sets;
mod shard;
mod source;

pub use frame::{Environment, Frame, FrameId, Target, check_name};
pub use lsdc_files::{
    Camera, Colmap, ColoredCloud, ColoredPoint, Contents, DepthKind, DepthMap, DepthReadOptions,
    GUIDE_ENDINGS, GuideSource, Orientation, Point, Sparse, StoredMap, Unit, UprightImage, View,
    check_foreign, check_output, check_writable, hide_caught_panics, images_below, is_depth_image,
    is_image, png_unit, raised_in_png, read_depth, read_depth_png, read_mask, read_npy, read_rgb,
    read_upright, remove_leftovers, stored_unit, without_uncertain, would_replace,
    write_atomically, write_colour_map, write_depth_png, write_exr, write_folder_atomically,
    write_npy, write_npz, write_pfm, write_ply, write_rgb, write_tiff,
};
pub use mixture::Mixture;
pub use sequence::{PosedFrame, Sequence};
pub use sets::{
    Depths, DiodeConfig, Folder, FolderConfig, NyuConfig, RoomPath, Rooms, RoomsConfig,
    seven_scenes,
};
pub use shard::Shard;
pub use source::{DataConfig, DatasetKind};

use lsdc_files::error::Result;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Part of a dataset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Frames for training.
    #[default]
    Train,
    /// Frames for validation.
    Val,
}

impl Split {
    /// Returns the name in paths and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
        }
    }

    /// Returns whether a folder of this name contains the split.
    fn is_called(self, folder: &str) -> bool {
        match self {
            Self::Train => folder == "train",
            Self::Val => matches!(folder, "val" | "test"),
        }
    }
}

/// A list of frames, loaded one at a time.
pub trait Dataset: Send + Sync {
    /// Describes the dataset: its name, storage format and kind of depths.
    fn description(&self) -> String;

    /// Returns the name of the protocol that is conventional for this dataset.
    fn protocol(&self) -> &'static str {
        "full"
    }

    /// Returns whether frames have depths. Images without depth can be used in training with a teacher.
    fn has_depth(&self) -> bool {
        true
    }

    /// Returns the number of frames.
    fn len(&self) -> usize;

    /// Returns whether there are no frames.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the name of frame `index`, which must be below `len`.
    fn id(&self, index: usize) -> FrameId;

    /// Returns the scene or recording of frame `index`, if the dataset defines it other than by the folders in names.
    fn scene(&self, _index: usize) -> Option<String> {
        None
    }

    /// Returns the files of frame `index`, if there are any. Stored results are reused only if these files are unchanged.
    fn files(&self, _index: usize) -> Vec<PathBuf> {
        Vec::new()
    }

    /// Reads frame `index`, which must be below `len`.
    ///
    /// # Errors
    /// A missing or damaged file, or image and depth of different sizes.
    fn load(&self, index: usize) -> Result<Frame>;
}

/// Describes the frames of a dataset by their source, number and names, for the records of derived files.
pub fn frames_record(frames: &dyn Dataset) -> Value {
    let names: Vec<FrameId> = (0..frames.len()).map(|index| frames.id(index)).collect();
    json!({
        "found": frames.description(),
        "frames": names.len(),
        "names": format!("{:016x}", lsdc_rng::hash(&names)),
    })
}
