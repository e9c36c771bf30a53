//! NYU Depth v2 (Silberman et al. 2012) as a tree of JPEG and 16-bit PNG files.

use super::{Folder, FolderConfig, Split};
use crate::error::Result;
use std::path::Path;

/// Opens `root/<split>/<scene>/<frame>.jpg` with depths in millimetres in `<frame>_depth.png`.
///
/// # Errors
/// As [`Folder::open`].
pub fn nyu(root: &Path, split: Split) -> Result<Folder> {
    let config = FolderConfig {
        rgb: "{split}/{scene}/{frame}.jpg".into(),
        depth: "{split}/{scene}/{frame}_depth.png".into(),
        depth_scale: 0.001,
    };
    Folder::open(root, split, &config)
}
