//! Datasets: frames of files, and what makes a dataset of them.

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

/// Which part of a dataset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Frames to learn from.
    #[default]
    Train,
    /// Frames to measure on.
    Val,
}

impl Split {
    /// The name in paths and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
        }
    }

    /// Whether a folder of this name holds the split.
    fn is_called(self, folder: &str) -> bool {
        match self {
            Self::Train => folder == "train",
            Self::Val => matches!(folder, "val" | "test"),
        }
    }
}

/// A list of frames, loaded one at a time.
pub trait Dataset: Send + Sync {
    /// What was found: the dataset's name, how it is stored, which depths these are.
    fn description(&self) -> String;

    /// The name of the protocol by which it is measured by convention.
    fn protocol(&self) -> &'static str {
        "full"
    }

    /// Whether frames have depths. Images alone can be learned from with a teacher.
    fn has_depth(&self) -> bool {
        true
    }

    /// The number of frames.
    fn len(&self) -> usize;

    /// Whether there are no frames.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The name of frame `index`, which must be below `len`.
    fn id(&self, index: usize) -> FrameId;

    /// The scene or recording that frame `index` shows, if the dataset knows it by other means than the folders in names.
    fn scene(&self, _index: usize) -> Option<String> {
        None
    }

    /// The files that frame `index` is read from, as far as it has any: results are used again only
    /// if these are as they were.
    fn files(&self, _index: usize) -> Vec<PathBuf> {
        Vec::new()
    }

    /// Reads frame `index`, which must be below `len`.
    ///
    /// # Errors
    /// A missing or damaged file, or image and depth of different sizes.
    fn load(&self, index: usize) -> Result<Frame>;
}

/// The frames of a dataset by what was found, their number and their names, for the records of what was made from them.
pub fn frames_record(frames: &dyn Dataset) -> Value {
    let names: Vec<FrameId> = (0..frames.len()).map(|index| frames.id(index)).collect();
    json!({
        "found": frames.description(),
        "frames": names.len(),
        "names": format!("{:016x}", lsdc_rng::hash(&names)),
    })
}
