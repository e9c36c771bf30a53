//! Single files: one reader or writer per format.

mod depth_png;
mod exr;
mod hdf5;
mod las;
mod list;
mod npy;
mod npz;
mod pcd;
mod pfm;
mod picture;
mod ply;
mod save;
mod tiff;

pub use depth_png::{png_unit, stored_unit, write_depth_png};
pub(super) use exr::read_exr;
pub use exr::write_exr;
pub(super) use hdf5::{Hdf5, from_planes, read_pair};
pub(super) use list::{Listed, read_list};
pub(super) use npy::{Array, read_array};
pub use npy::{read_npy, write_npy};
pub(super) use npz::read_npz;
pub use npz::write_npz;
pub(super) use pfm::read_pfm;
pub use pfm::write_pfm;
pub(super) use picture::image_kind;
pub use picture::{read_depth_png, read_rgb, write_rgb};
pub use ply::{Colored, write_ply};
pub use save::{check_writable, remove_leftovers, write_atomically, write_folder_atomically};
pub(super) use tiff::read_tiff;
pub use tiff::write_tiff;

use super::DepthMap;
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Whether a file of `size` bytes can hold `bytes` of values: deflate makes at most 1032 of one
/// (zlib), what is small may be asked for in any case, and no image or scan at a time is so large as
/// a gigabyte. Damaged headers promise much more.
fn plausible(bytes: u64, size: u64) -> bool {
    bytes <= (1 << 20).max(size.saturating_mul(1100)).min(1 << 30)
}

/// The endings of colour images.
pub(super) const IMAGES: [&str; 6] = ["jpg", "jpeg", "png", "webp", "tif", "tiff"];

/// What is done with each point of a cloud: x, y, z in stored units, maybe not finite.
pub(super) type Visit<'a> = dyn FnMut([f64; 3]) + 'a;

/// The endings of clouds.
pub(super) const CLOUDS: [&str; 4] = ["ply", "pcd", "las", "laz"];

/// Visits every point of a cloud, which is read by its ending and never whole.
pub(super) fn read_cloud(path: &Path, visit: &mut Visit<'_>) -> Result<()> {
    if has_ending(path, "ply") {
        ply::read_ply(path, visit)
    } else if has_ending(path, "pcd") {
        pcd::read_pcd(path, visit)
    } else {
        las::read_las(path, visit)
    }
}

/// Whether the path ends in `.ending`, in capitals or not.
pub(super) fn has_ending(path: &Path, ending: &str) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case(ending))
}

/// The images in a folder and those below it, in the order of their paths.
///
/// # Errors
/// A folder that cannot be read.
pub fn images_below(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut images = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        let entries = std::fs::read_dir(&folder).map_err(|e| Error::read(&folder, e))?;
        for entry in entries {
            let path = entry.map_err(|e| Error::read(&folder, e))?.path();
            if path.is_dir() {
                folders.push(path);
            } else if IMAGES.iter().any(|e| has_ending(&path, e)) {
                images.push(path);
            }
        }
    }
    images.sort();
    Ok(images)
}

/// Reads depths from `.npy` or 16-bit grey PNG, by the file's ending: metres = value x `scale`.
///
/// # Errors
/// As [`read_npy`] and [`read_depth_png`].
pub fn read_depth(path: &Path, scale: f64) -> Result<DepthMap> {
    if has_ending(path, "npy") {
        read_npy(path, scale)
    } else if has_ending(path, "png") {
        read_depth_png(path, scale)
    } else {
        Err(Error::format(path, "is no kind of depth file")
            .hint("depths are read from npy and PNG"))
    }
}

/// Reads a validity mask from `.npy` (booleans or numbers) or grey PNG: what is not 0 is valid.
/// Returns columns, rows, and the values row by row.
///
/// # Errors
/// As [`read_depth`].
pub fn read_mask(path: &Path) -> Result<(usize, usize, Vec<bool>)> {
    let map = read_depth(path, 1.0)?;
    let valid = map.values().iter().map(|&v| v != 0.0).collect();
    Ok((map.width(), map.height(), valid))
}
