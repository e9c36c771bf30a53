//! Single files: one reader or writer per format.

mod chunks;
mod colour_map;
mod depth_png;
mod exr;
mod grey;
mod hdf5;
mod las;
mod limit;
mod npy;
mod npz;
mod pcd;
mod pfm;
mod pgm;
mod picture;
mod ply;
mod quiet;
mod save;
mod table;
mod tags;
mod tiff;
mod velodyne;

pub use colour_map::write_colour_map;
pub(super) use depth_png::encode_grey16;
pub use depth_png::{encode_depth_png, png_unit, raised_in_png, stored_unit, write_depth_png};
pub(super) use exr::read_exr;
pub use exr::{encode_exr, write_exr};
pub use grey::read_depth_png;
pub(super) use grey::read_grey;
pub(crate) use hdf5::read_h5;
pub use hdf5::{Hdf5, from_planes, read_pair};
pub use limit::reading_at_most;
use limit::{LARGEST, check_pixels, check_unfolded, plausible};
pub(super) use npy::read_array;
pub use npy::{NumberList, encode_npy, read_npy, write_npy};
pub use npz::{encode_npz, read_npz_lists, write_npz};
pub(super) use npz::{read_npz, read_npz_table};
pub(super) use pfm::read_pfm;
pub use pfm::write_pfm;
pub(super) use picture::image_kind;
pub use picture::{
    UprightImage, image_orientation, image_size, is_depth_image, read_rgb, read_upright, write_rgb,
};
pub use ply::{ColoredPoint, are_far, encode_ply, write_ply};
pub use quiet::hide_caught_panics;
pub(super) use save::link_or_copy;
pub use save::{
    AtomicFile, check_output, check_writable, remove_leftovers, would_replace, write_atomically,
    write_folder_atomically,
};
pub(super) use table::{ColumnMeaning, PointTable, TableRow, read_table};
pub use tiff::write_tiff;
pub(super) use tiff::{is_grey_tiff, read_tiff};

use super::DepthMap;
use crate::error::{Cause, Error, Result};
use std::path::{Path, PathBuf};

/// File extensions of colour images.
pub(super) const IMAGES: [&str; 9] = [
    "jpg", "jpeg", "png", "webp", "tif", "tiff", "bmp", "ppm", "pgm",
];

/// Callback for each point of a cloud: x, y, z in stored units, possibly not finite.
pub(super) type PointVisitor<'a> = dyn FnMut([f64; 3]) + 'a;

/// File extensions of clouds.
pub(super) const CLOUDS: [&str; 5] = ["ply", "pcd", "las", "laz", "bin"];

/// Visits every point of a cloud. The file is read by its extension and never loaded whole.
pub(super) fn read_cloud(path: &Path, visit: &mut PointVisitor<'_>) -> Result<()> {
    if has_ending(path, "ply") {
        ply::read_ply(path, visit)
    } else if has_ending(path, "pcd") {
        pcd::read_pcd(path, visit)
    } else if has_ending(path, "bin") {
        velodyne::read_velodyne(path, visit)
    } else {
        las::read_las(path, visit)
    }
}

/// Whether the path has this extension, ignoring case.
pub fn has_ending(path: &Path, ending: &str) -> bool {
    path.extension()
        .is_some_and(|e| e.eq_ignore_ascii_case(ending))
}

/// Returns the images in a folder and its subfolders, sorted by path. A link to a folder above it is not followed.
///
/// # Errors
/// A folder cannot be read.
pub fn images_below(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut images = Vec::new();
    walk(folder, &mut Vec::new(), &mut images)?;
    images.sort();
    Ok(images)
}

/// `above` contains the real paths of the parent folders.
fn walk(folder: &Path, above: &mut Vec<PathBuf>, images: &mut Vec<PathBuf>) -> Result<()> {
    let unreadable = |e| Error::read(folder, e);
    let real = folder.canonicalize().map_err(unreadable)?;
    if above.contains(&real) {
        return Ok(());
    }
    above.push(real);
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.is_dir() {
            walk(&path, above, images)?;
        } else if is_image(&path) {
            images.push(path);
        }
    }
    above.pop();
    Ok(())
}

/// Whether a path has the extension of an image.
pub fn is_image(path: &Path) -> bool {
    IMAGES.iter().any(|ending| has_ending(path, ending))
}

/// Reads depths from `.npy` or 16-bit grey PNG, by the file's extension: metres = value x `scale`.
///
/// # Errors
/// As [`read_npy`] and [`read_depth_png`].
pub fn read_depth(path: &Path, scale: f64) -> Result<DepthMap> {
    if has_ending(path, "npy") {
        read_npy(path, scale)
    } else if has_ending(path, "png") {
        read_depth_png(path, scale)
    } else {
        Err(not_depth(path))
    }
}

/// Reads a validity mask from `.npy` (booleans or numbers) or grey PNG; values other than 0 are valid. Returns columns,
/// rows, and the values row by row.
///
/// # Errors
/// As [`read_depth`].
pub fn read_mask(path: &Path) -> Result<(usize, usize, Vec<bool>)> {
    let mut raster = if has_ending(path, "npy") {
        read_array(path)?
    } else if has_ending(path, "png") {
        read_grey(path)?
    } else {
        return Err(not_depth(path));
    };
    // Values that mark missing measurements in a map are valid in a mask.
    let map = raster.scaled(1.0)?;
    let valid = map.values().iter().map(|&v| v != 0.0).collect();
    Ok((map.width(), map.height(), valid))
}

/// Rejects depths at an offset within a larger picture, which the field `named` declares.
fn refuse_window(path: &Path, offset: Option<[i64; 2]>, named: &str) -> Result<()> {
    let Some([x, y]) = offset else {
        return Ok(());
    };
    let what = format!("is a window at {x}, {y} of a larger picture ({named})");
    Err(Error::format(path, what).hint("write the whole picture, 0 where there is no measurement"))
}

/// Encodes a file in memory.
fn encoded(
    what: &str,
    encode: impl FnOnce(&mut Vec<u8>) -> std::io::Result<()>,
) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    encode(&mut bytes)
        .map_err(|e| Error::new(Cause::Write, format!("cannot make {what}")).because(e))?;
    Ok(bytes)
}

fn not_depth(path: &Path) -> Error {
    Error::format(path, "is no kind of depth file").hint("depths are read from npy and PNG")
}
