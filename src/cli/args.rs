//! What can be typed.

use crate::data::{DatasetKind, Split};
use crate::error::{Error, Result};
use crate::predict::Method;
use crate::sample::{Interpolation, Size};
use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Depth completion: an RGB image and a few sparse depths in, dense depth in metres out.
#[derive(Debug, Parser)]
#[command(name = "lsdc", version, max_term_width = 100)]
pub(super) struct Args {
    /// Say more (-v: progress of the parts, -vv: everything); RUST_LOG overrides.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub(super) verbose: u8,
    #[command(subcommand)]
    pub(super) command: Command,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Complete the depth of one image.
    Complete(Complete),
    /// Measure methods on a dataset.
    Eval(Eval),
    /// Train a network.
    Train(Train),
    /// Write a frame of a dataset, with sparse points, as files for `complete`.
    Export(Export),
    /// Measure how fast this machine completes depth.
    Bench(Bench),
    /// Print every setting with its value.
    Config(Settings),
}

#[derive(Debug, ClapArgs)]
pub(super) struct Complete {
    /// Colour image (JPEG or PNG).
    pub(super) rgb: PathBuf,
    /// Sparse depths as large as the image: npy of shape (height, width), or 16-bit PNG; 0, NaN,
    /// infinite and negative values mean no measurement.
    pub(super) sparse: PathBuf,
    /// Folder for the results [default: the folder of the image].
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: Option<PathBuf>,
    /// Metres per stored unit of the sparse depths [default: 1 for npy, 0.001 for PNG].
    #[arg(long, value_name = "M")]
    pub(super) depth_scale: Option<f32>,
    /// Size of the result, as WIDTHxHEIGHT [default: that of the image].
    #[arg(long, value_parser = size)]
    pub(super) size: Option<Size>,
    /// How to complete.
    #[arg(long, default_value = "lsdc", value_name = "lsdc|linear")]
    pub(super) method: Method,
    /// Fit by iteratively reweighted least squares, against outliers.
    #[arg(long)]
    pub(super) irls: bool,
    /// Show the network every pixel, instead of a large image reduced to the size of training.
    #[arg(long)]
    pub(super) full: bool,
    /// Replace existing results.
    #[arg(long)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) model: Model,
}

#[derive(Debug, ClapArgs)]
pub(super) struct Model {
    /// Weights file [default: the weights in the program].
    #[arg(long, value_name = "FILE")]
    pub(super) weights: Option<PathBuf>,
    /// Where to compute: cpu, wgpu, wgpu:N, wgpu:integrated, wgpu:software, ndarray.
    #[arg(long, default_value = "cpu", env = "LSDC_DEVICE")]
    pub(super) device: String,
}

/// Settings, in rising order: built-in, file, --set, flags.
#[derive(Debug, ClapArgs)]
pub(super) struct Settings {
    /// Configuration file, or the name of a built-in one (nyu.toml,
    /// nyu-medium.toml, smoke.toml).
    #[arg(long, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// Change one setting, as in --set train.steps=100; may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub(super) set: Vec<String>,
}

#[derive(Debug, ClapArgs)]
pub(super) struct Source {
    /// Dataset.
    #[arg(long, value_enum)]
    pub(super) dataset: Option<DatasetKind>,
    /// Folder of the dataset [default: `data.root` of the configuration, or LSDC_DATA].
    #[arg(long, value_name = "DIR")]
    pub(super) root: Option<PathBuf>,
}

#[derive(Debug, ClapArgs)]
pub(super) struct Eval {
    #[command(flatten)]
    pub(super) settings: Settings,
    #[command(flatten)]
    pub(super) source: Source,
    /// Split of the dataset.
    #[arg(long, value_enum, default_value = "val")]
    pub(super) split: Split,
    /// Sparse points per frame [default: 500].
    #[arg(long)]
    pub(super) points: Option<usize>,
    /// Names the masks; the same for every method [default: 0].
    #[arg(long)]
    pub(super) seed: Option<u64>,
    /// Methods, side by side on the same points [default: lsdc,linear].
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    pub(super) method: Vec<Method>,
    /// How true depths are resized [default: bilinear].
    #[arg(long, value_enum)]
    pub(super) depth_resize: Option<Interpolation>,
    /// Measure only the first frames.
    #[arg(long, value_name = "N")]
    pub(super) limit: Option<usize>,
    /// Write the whole report here.
    #[arg(long, value_name = "FILE")]
    pub(super) json: Option<PathBuf>,
    /// Write the scores of each frame here.
    #[arg(long, value_name = "FILE")]
    pub(super) csv: Option<PathBuf>,
    #[command(flatten)]
    pub(super) model: Model,
}

#[derive(Debug, ClapArgs)]
pub(super) struct Train {
    #[command(flatten)]
    pub(super) settings: Settings,
    #[command(flatten)]
    pub(super) source: Source,
    /// Run folder [default: runs/ and the name of the configuration].
    #[arg(short, long, value_name = "DIR", conflicts_with = "resume")]
    pub(super) output: Option<PathBuf>,
    /// Go on with the run in this folder, with its own settings.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["config", "set", "dataset"])]
    pub(super) resume: Option<PathBuf>,
    /// Seed of weights, order, augmentation and points.
    #[arg(long)]
    pub(super) seed: Option<u64>,
    /// Where to compute.
    #[arg(long, default_value = "cpu", env = "LSDC_DEVICE")]
    pub(super) device: String,
}

#[derive(Debug, ClapArgs)]
pub(super) struct Bench {
    /// Size of image and result, as WIDTHxHEIGHT [default: 640x480; with --training 304x228].
    #[arg(long, value_parser = size)]
    pub(super) size: Option<Size>,
    /// Sparse points.
    #[arg(long, default_value_t = 500)]
    pub(super) points: usize,
    /// Completions or steps to measure, after one that is not.
    #[arg(long, default_value_t = 15)]
    pub(super) runs: usize,
    /// Show the network every pixel, instead of a large image reduced to the size of training.
    #[arg(long)]
    pub(super) full: bool,
    /// Time steps of training instead: two images, every pixel in the loss.
    #[arg(long, conflicts_with_all = ["full", "points"])]
    pub(super) training: bool,
    /// Print one JSON object.
    #[arg(long)]
    pub(super) json: bool,
    #[command(flatten)]
    pub(super) model: Model,
}

#[derive(Debug, ClapArgs)]
pub(super) struct Export {
    #[command(flatten)]
    pub(super) settings: Settings,
    #[command(flatten)]
    pub(super) source: Source,
    /// Split of the dataset.
    #[arg(long, value_enum, default_value = "val")]
    pub(super) split: Split,
    /// Which frame, counted from 0.
    #[arg(long, default_value_t = 0)]
    pub(super) index: usize,
    /// Sparse points to draw.
    #[arg(long, default_value_t = 500)]
    pub(super) points: usize,
    /// Names the draw.
    #[arg(long, default_value_t = 0)]
    pub(super) seed: u64,
    /// Folder for rgb.png, depth.npy and sparse.npy.
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: PathBuf,
    /// Replace existing files.
    #[arg(long)]
    pub(super) force: bool,
}

fn size(text: &str) -> Result<Size> {
    let wrong = || Error::config(format!("`{text}` is not a size")).hint("as in 640x480");
    let (width, height) = text.split_once('x').ok_or_else(wrong)?;
    let length = |t: &str| {
        t.parse()
            .ok()
            .filter(|n| (1..=1 << 16).contains(n))
            .ok_or_else(wrong)
    };
    Ok(Size {
        height: length(height)?,
        width: length(width)?,
    })
}

macro_rules! by_name {
    ($kind:ty, $($variant:ident = $name:literal),+) => {
        impl ValueEnum for $kind {
            fn value_variants<'a>() -> &'a [Self] {
                &[$(Self::$variant),+]
            }

            fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
                Some(clap::builder::PossibleValue::new(match self {
                    $(Self::$variant => $name),+
                }))
            }
        }
    };
}

by_name!(Split, Train = "train", Val = "val");
by_name!(DatasetKind, Rooms = "rooms", Nyu = "nyu", Folder = "folder");
by_name!(Interpolation, Bilinear = "bilinear", Nearest = "nearest");
