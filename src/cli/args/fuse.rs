//! Arguments of `fuse`.

use super::values::{edge, typed};
use clap::Args as ClapArgs;
use lsdc_eval::data::{Camera, Unit};
use lsdc_fusion::Up;
use std::path::PathBuf;

#[derive(Debug, ClapArgs)]
#[command(after_help = "`lsdc fuse --help` shows every option.")]
pub(in crate::cli) struct Fuse {
    /// Folder of the results of `lsdc complete`, or of any other depth maps.
    ///
    /// Of the files `NAME_depth.*` of a frame, one with standard deviations is preferred (npz, exr), else npy, tiff, pfm, png;
    /// standard deviations may also be in `NAME_sigma.npy` (`lsdc complete --uncertainty`). In a folder without such names
    /// every depth map is a frame. Folders below it are searched too.
    pub(in crate::cli) results: PathBuf,
    /// Poses of the cameras: a TUM trajectory, KITTI poses, a folder of 4x4 matrices (NAME.pose.txt), a transforms.json, or
    /// a COLMAP model.
    ///
    /// Frames are found by name, or in a trajectory by the time that their name is (within 0.02 s), or in KITTI poses by the
    /// number that their name ends in. Depths and poses are in the same unit.
    #[arg(long, value_name = "PATH", help_heading = "Input")]
    pub(in crate::cli) poses: PathBuf,
    /// File for the surface: .ply or .glb (glTF 2.0).
    #[arg(short, long, value_name = "FILE", help_heading = "Output")]
    pub(in crate::cli) output: PathBuf,
    /// Camera of all depth maps: a file, or FX,FY,CX,CY in pixels [default: those of a transforms.json or COLMAP model].
    #[arg(long, value_parser = typed::<Camera>, value_name = "CAMERA", help_heading = "Input")]
    pub(in crate::cli) camera: Option<Camera>,
    /// Folder of the images, for colours.
    #[arg(long, value_name = "DIR", help_heading = "Input")]
    pub(in crate::cli) images: Option<PathBuf>,
    /// Unit of depths in files that do not name it, as for `complete` [default: mm for integers, m for other numbers].
    #[arg(long, value_parser = typed::<Unit>, value_name = "UNIT", help_heading = "Input", hide_short_help = true)]
    pub(in crate::cli) depth_unit: Option<Unit>,
    /// Fuse only every Nth frame.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..), help_heading = "Input", hide_short_help = true)]
    pub(in crate::cli) every: u32,
    /// Edge length of a voxel in metres [default: twice the median width of a pixel on the surface or half the median
    /// standard deviation, whichever is larger].
    #[arg(long, value_parser = edge, allow_negative_numbers = true, value_name = "METRES", help_heading = "Surface")]
    pub(in crate::cli) voxel: Option<f64>,
    /// Leave out pixels of larger depth, in metres.
    #[arg(long, value_parser = edge, allow_negative_numbers = true, value_name = "METRES", help_heading = "Surface")]
    pub(in crate::cli) max_depth: Option<f64>,
    /// Leave out pixels whose standard deviation is a larger part of their depth [default: 0.1].
    #[arg(
        long,
        value_name = "PART",
        help_heading = "Surface",
        hide_short_help = true
    )]
    pub(in crate::cli) max_deviation: Option<f64>,
    /// Memory for the voxels in GiB. Without --voxel, voxels that do not fit are made larger [default: 4].
    #[arg(
        long,
        value_name = "GIB",
        help_heading = "Surface",
        hide_short_help = true
    )]
    pub(in crate::cli) max_memory: Option<f64>,
    /// Write points with normals instead of triangles.
    #[arg(long, help_heading = "Output")]
    pub(in crate::cli) points: bool,
    /// Axis of the world that is up, for .glb: x, -x, y, -y, z or -z [default: the axis nearest to the mean upward direction
    /// of the images].
    #[arg(
        long,
        value_name = "AXIS",
        allow_hyphen_values = true,
        help_heading = "Output",
        hide_short_help = true
    )]
    pub(in crate::cli) up: Option<Up>,
    /// Replace an existing file.
    #[arg(long, help_heading = "Output")]
    pub(in crate::cli) force: bool,
    /// Print one JSON object.
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) json: bool,
}
