//! What is typed to complete depth, and to measure how fast.

use super::values::{Format, range, size, typed};
use super::{FitFlags, Model};
use crate::data::{Camera, Shard, Unit};
use crate::predict::{Method, Preserve};
use crate::sample::Size;
use clap::Args as ClapArgs;
use std::path::PathBuf;

#[derive(Clone, Debug, ClapArgs)]
#[command(
    after_help = "`lsdc complete --help` shows every option.",
    after_long_help = "docs/guide.md has a command for every kind of data."
)]
pub(in crate::cli) struct Complete {
    /// Colour image (JPEG, PNG, WebP, TIFF, BMP, PNM), or several: images, a folder, a pattern such as
    /// 'left/*.png', or a list (txt) with an image to a line, its points behind it or in the folder of
    /// points; quote names with blanks. `-` is standard input.
    #[arg(required = true)]
    pub(in crate::cli) rgb: Vec<PathBuf>,
    /// Sparse depths: a map of the image's shape (npy, npz, 16-bit PNG, PGM, TIFF, EXR, PFM, HDF5); a
    /// table of points (csv, txt, npy of shape (points, 3 or 4)) of u, v, depth[, sigma], u and v in
    /// pixels from the centre of the first, or with --camera of x, y, z, which a first line `u,v,depth`
    /// or `x,y,z` says (without it, a table is x, y, z if there is --camera and most of its points
    /// cannot be pixels, and what may be either is refused); a cloud (PLY, PCD, LAS, LAZ, xyz, KITTI's
    /// bin; needs --camera); or a sparse model of COLMAP. 0, NaN, infinite and negative values mean no
    /// measurement. For several images: a folder of such files of the same names, or a model. `-` is
    /// standard input.
    pub(in crate::cli) sparse: PathBuf,
    /// Folder for the results, or for one image the file, whose ending says the format, or `-`, which
    /// is standard output [default: the folder of the image].
    #[arg(short, long, value_name = "PATH", help_heading = "Output")]
    pub(in crate::cli) output: Option<PathBuf>,
    /// Unit of the sparse depths: m, cm, mm, kitti (1/256 m), tum (1/5000), vkitti (1/100), or how
    /// many make a metre [default: mm for integers, m for other numbers, that of the model for COLMAP].
    #[arg(long, value_parser = typed::<Unit>, value_name = "UNIT", help_heading = "Input")]
    pub(in crate::cli) depth_unit: Option<Unit>,
    /// Camera intrinsics and pose, to project clouds and back-project pixels: a file (TOML or JSON with
    /// fx, fy, cx, cy, distortion, pose, or the YAML of a calibration by ROS), or FX,FY,CX,CY in pixels.
    /// Of an image that EXIF turns, those of the pixels as stored, unless only upright fits.
    #[arg(long, value_parser = typed::<Camera>, value_name = "CAMERA", help_heading = "Input")]
    pub(in crate::cli) camera: Option<Camera>,
    /// What is written of a result: npy (float32 metres), png (16-bit millimetres,
    /// or a coarser unit that the file says, if these do not fit), color, tiff, exr,
    /// pfm (metres), npz (metres; exr and npz with standard deviations, if these are asked for), ply
    /// (a cloud with colours; needs a camera), json (what is said of it) [default: npy,png,color].
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        value_name = "FORMAT,...",
        help_heading = "Output"
    )]
    pub(in crate::cli) formats: Option<Vec<Format>>,
    /// Metres of the first and the last colour [default: the nearest and the farthest].
    #[arg(long, value_parser = range, value_name = "LOW,HIGH", help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) range: Option<(f32, f32)>,
    /// Leave pixels out of clouds whose standard deviation is larger, in metres.
    #[arg(
        long,
        value_name = "METRES",
        help_heading = "Output",
        hide_short_help = true
    )]
    pub(in crate::cli) max_sigma: Option<f32>,
    /// Size of the result, as WIDTHxHEIGHT [default: that of the image].
    #[arg(long, value_parser = size, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) size: Option<Size>,
    /// How to complete: lsdc, nearest, linear, idw, tps, wls, levin, steering, ip-basic.
    #[arg(long, value_parser = typed::<Method>, default_value = "lsdc", value_name = "NAME", help_heading = "Fit", hide_short_help = true)]
    pub(in crate::cli) method: Method,
    #[command(flatten)]
    pub(in crate::cli) fit: FitFlags,
    /// How to preserve the input depths: none (the fit need not meet them), exact (at their
    /// pixels), blend (and their neighbourhood follows).
    #[arg(
        long,
        value_enum,
        default_value = "none",
        value_name = "HOW",
        help_heading = "Fit",
        hide_short_help = true
    )]
    pub(in crate::cli) preserve_input: Preserve,
    /// The standard deviation of each sparse depth, a map in the unit of the depths [default: what a
    /// table has]. Points at the median of these count as points without any do, the others by the
    /// square of the ratio.
    #[arg(
        long,
        value_name = "FILE",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) sigma: Option<PathBuf>,
    /// Write the standard deviation of every pixel of the result, in metres.
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) uncertainty: bool,
    /// Write a list of the points that do not agree with the others.
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) outliers: bool,
    /// Show the network the image as it is, instead of resized to the number of pixels of training.
    #[arg(long, help_heading = "Network", hide_short_help = true)]
    pub(in crate::cli) full: bool,
    /// The images are a video: weights are drawn towards those of the frame before, so that few
    /// points flicker less. Writes the weights of each frame.
    #[arg(long, help_heading = "Several frames", hide_short_help = true)]
    pub(in crate::cli) temporal: bool,
    /// Of a folder, complete only part I of N (I from 0).
    #[arg(long, value_parser = typed::<Shard>, default_value = "0/1", value_name = "I/N", help_heading = "Several frames", hide_short_help = true)]
    pub(in crate::cli) shard: Shard,
    /// Replace existing results.
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) force: bool,
    /// Print one JSON object to a frame.
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Bench {
    /// Size of image and result, as WIDTHxHEIGHT [default: 640x480; with --training 304x228].
    #[arg(long, value_parser = size)]
    pub(in crate::cli) size: Option<Size>,
    /// Sparse points.
    #[arg(long, default_value_t = 500)]
    pub(in crate::cli) points: usize,
    /// Completions or steps to measure, after one that is not.
    #[arg(long, default_value_t = 15)]
    pub(in crate::cli) runs: usize,
    #[command(flatten)]
    pub(in crate::cli) fit: FitFlags,
    /// Show the network the image as it is, instead of resized to the number of pixels of training.
    #[arg(long)]
    pub(in crate::cli) full: bool,
    /// Time steps of training instead: two images, every pixel in the loss.
    #[arg(long, conflicts_with_all = ["full", "points"])]
    pub(in crate::cli) training: bool,
    /// Print one JSON object.
    #[arg(long)]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
}
