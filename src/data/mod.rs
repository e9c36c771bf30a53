//! Files to frames: what a dataset is, and the readers that make one.

mod depth;
mod folder;
mod npy;
mod nyu;
mod picture;
mod rooms;
mod save;
mod source;
mod template;

pub use depth::{DepthMap, Point};
pub use folder::{Folder, FolderConfig};
pub use npy::{read_npy, write_npy};
pub use nyu::nyu;
pub use picture::{read_depth_png, read_rgb, write_depth_png, write_rgb};
pub use rooms::{Rooms, RoomsConfig};
pub use save::write_atomically;
pub use source::{DataConfig, DatasetKind};

use crate::error::Result;
use image::RgbImage;
use serde::{Deserialize, Serialize};

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
}

/// The name of a frame: unique in its dataset, stable between machines.
pub type FrameId = String;

/// A colour image and the depth of the same pixels.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The frame's name.
    pub id: FrameId,
    /// 8-bit sRGB.
    pub rgb: RgbImage,
    /// Metres along the optical axis, as large as `rgb`.
    pub depth: DepthMap,
}

/// A list of frames, loaded one at a time.
pub trait Dataset: Send + Sync {
    /// The number of frames.
    fn len(&self) -> usize;

    /// Whether there are no frames.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The name of frame `index`, which must be below `len`.
    fn id(&self, index: usize) -> FrameId;

    /// Reads frame `index`, which must be below `len`.
    ///
    /// # Errors
    /// A missing or damaged file, or image and depth of different sizes.
    fn load(&self, index: usize) -> Result<Frame>;
}
