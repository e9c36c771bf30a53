//! Readers for the file layouts of datasets.

mod diode;
mod folder;
mod kitti;
mod listing;
mod marigold;
mod nyu;
mod rooms;
mod scans;
mod seven_scenes;
mod template;
mod tum;
mod void;

pub use diode::DiodeConfig;
pub(super) use diode::diode;
pub use folder::{Folder, FolderConfig};
pub(super) use kitti::kitti;
pub(super) use marigold::marigold;
pub(super) use nyu::nyu;
pub use nyu::{Depths, NyuConfig};
pub use rooms::{RoomPath, Rooms, RoomsConfig};
pub(super) use scans::scans;
pub use seven_scenes::seven_scenes;
pub(super) use tum::tum;
pub(super) use void::void;

use super::Split;
use lsdc_files::error::Error;
use std::path::Path;

/// Returns the error for a folder without a frame of a dataset.
fn no_frame(dataset: &str, split: Split, root: &Path) -> Error {
    Error::config(format!(
        "no `{}` frame of {dataset} in `{}`",
        split.name(),
        root.display()
    ))
}
