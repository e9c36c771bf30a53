//! Readers and writers of the files of images, depths, points, cameras and guides.
//!
//! Depth maps as NumPy arrays, PNG, TIFF, EXR, PFM and HDF5; points as tables, PLY, PCD, LAS, Velodyne scans and COLMAP
//! models; cameras as TOML, ROS and COLMAP files. Ambiguous contents are recognised, and assumptions are returned as
//! remarks with the result ([`Sparse`]). Results are written to a temporary file, which then replaces the old one.
//!
//! ```no_run
//! # fn main() -> lsdc_files::error::Result<()> {
//! let image = lsdc_files::read_rgb("rgb.png".as_ref())?;
//! let points = lsdc_files::read_npy("sparse.npy".as_ref(), 1.0)?;
//! lsdc_files::write_depth_png("sparse.png".as_ref(), &points, 0.001)?;
//! # Ok(())
//! # }
//! ```
//!
//! Maps and observations are types of `lsdc-core`; `lsdc-recordings` reads recordings of robots, and `lsdc-weights` reads
//! weights.

mod camera;
mod certain;
pub mod checks;
mod cloud;
mod colmap;
mod columns;
mod contents;
mod depth_kind;
mod described;
pub mod error;
mod file_unit;
mod files;
mod foreign;
mod grid;
mod guide;
mod orientation;
mod pose;
mod poses;
mod raster;
mod sparse;
mod stored;
mod unit;
mod workspaces;

pub use camera::{Camera, CameraInfo};
pub use certain::{DeviationLimits, without_uncertain};
pub use cloud::{CloudOptions, ColoredCloud};
pub use colmap::{Colmap, View};
pub use contents::Contents;
pub use depth_kind::{DepthKind, DepthReadOptions};
pub use described::{
    DescribedCloud, DescribedDepth, DescribedFit, DescribedPng, DescribedPoints, MOST_TESTED,
    clamped_pixels,
};
pub use files::{
    AtomicFile, ColoredPoint, Hdf5, NumberList, UprightImage, are_far, check_output,
    check_writable, encode_depth_png, encode_exr, encode_npy, encode_npz, encode_ply, from_planes,
    has_ending, hide_caught_panics, image_orientation, image_size, images_below, is_depth_image,
    is_image, png_unit, raised_in_png, read_depth, read_depth_png, read_mask, read_npy,
    read_npz_lists, read_pair, read_rgb, read_upright, reading_at_most, remove_leftovers,
    stored_unit, would_replace, write_atomically, write_colour_map, write_depth_png, write_exr,
    write_folder_atomically, write_npy, write_npz, write_pfm, write_ply, write_rgb, write_tiff,
};
pub use foreign::check_foreign;
pub use guide::{GUIDE_ENDINGS, GuideSource};
pub use lsdc_core::{DepthMap, Point};
pub use orientation::Orientation;
pub use pose::{Pose, rotation_matrix};
pub use poses::Poses;
pub use sparse::Sparse;
pub use stored::StoredMap;
pub use unit::Unit;
pub use workspaces::{
    Workspace, WorkspaceCounts, WorkspaceFormat, WorkspaceFrame, WorkspaceImages,
};
