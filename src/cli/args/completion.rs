//! What is typed to complete depth, and to measure how fast.

use super::values::{size, typed};
use super::{FitFlags, Model};
use crate::predict::{Method, Preserve};
use crate::sample::Size;
use clap::Args as ClapArgs;
use std::path::PathBuf;

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Complete {
    /// Colour image (JPEG or PNG).
    pub(in crate::cli) rgb: PathBuf,
    /// Sparse depths as large as the image: npy of shape (height, width), or 16-bit PNG; 0, NaN,
    /// infinite and negative values mean no measurement.
    pub(in crate::cli) sparse: PathBuf,
    /// Folder for the results [default: the folder of the image].
    #[arg(short, long, value_name = "DIR")]
    pub(in crate::cli) output: Option<PathBuf>,
    /// Metres per stored unit of the sparse depths [default: 1 for npy, 0.001 for PNG].
    #[arg(long, value_name = "M")]
    pub(in crate::cli) depth_scale: Option<f64>,
    /// Size of the result, as WIDTHxHEIGHT [default: that of the image].
    #[arg(long, value_parser = size)]
    pub(in crate::cli) size: Option<Size>,
    /// How to complete: lsdc, nearest, linear, idw, tps, wls, levin, steering, ip-basic.
    #[arg(long, value_parser = typed::<Method>, default_value = "lsdc", value_name = "NAME")]
    pub(in crate::cli) method: Method,
    #[command(flatten)]
    pub(in crate::cli) fit: FitFlags,
    /// What becomes of the given depths: none (the fit need not meet them), exact (at their
    /// pixels), blend (and their neighbourhood follows).
    #[arg(long, value_enum, default_value = "none", value_name = "HOW")]
    pub(in crate::cli) preserve_input: Preserve,
    /// The standard deviation of each sparse depth in metres, an npy array as large as the image.
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) sigma: Option<PathBuf>,
    /// Write the standard deviation of every pixel of the result, in metres.
    #[arg(long)]
    pub(in crate::cli) uncertainty: bool,
    /// Write a list of the points that do not agree with the others.
    #[arg(long)]
    pub(in crate::cli) outliers: bool,
    /// Show the network every pixel, instead of a large image reduced to the size of training.
    #[arg(long)]
    pub(in crate::cli) full: bool,
    /// Replace existing results.
    #[arg(long)]
    pub(in crate::cli) force: bool,
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
    /// Show the network every pixel, instead of a large image reduced to the size of training.
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
