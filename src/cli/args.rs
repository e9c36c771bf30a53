//! What can be typed.

use crate::data::{DatasetKind, Split};
use crate::error::{Error, Result};
use crate::eval::{EvalConfig, Shard};
use crate::fit::{FitConfig, FitMethod, Lambda, Loss, PriorKind, Robust, Space};
use crate::model::Precision;
use crate::predict::{Method, Preserve};
use crate::sample::{Interpolation, Noise, Pattern, Size};
use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;
use std::str::FromStr;

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
    Eval(Box<Eval>),
    /// Join and show reports.
    #[command(subcommand)]
    Report(ReportCommand),
    /// Train a network.
    Train(Train),
    /// List, describe and convert weights.
    #[command(subcommand)]
    Weights(WeightsCommand),
    /// Learn which weights are likely, and how far predictions are off: what training does after
    /// its last step, for weights that exist.
    Calibrate(Calibrate),
    /// Write frames of a dataset at the protocol's size, with the points of `eval`, as files.
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
    pub(super) depth_scale: Option<f64>,
    /// Size of the result, as WIDTHxHEIGHT [default: that of the image].
    #[arg(long, value_parser = size)]
    pub(super) size: Option<Size>,
    /// How to complete: lsdc, nearest, linear, idw, tps, wls, levin, steering, ip-basic.
    #[arg(long, value_parser = typed::<Method>, default_value = "lsdc", value_name = "NAME")]
    pub(super) method: Method,
    #[command(flatten)]
    pub(super) fit: FitFlags,
    /// What becomes of the given depths: none (the fit need not meet them), exact (at their
    /// pixels), blend (and their neighbourhood follows).
    #[arg(long, value_enum, default_value = "none", value_name = "HOW")]
    pub(super) preserve_input: Preserve,
    /// The standard deviation of each sparse depth in metres, an npy array as large as the image.
    #[arg(long, value_name = "FILE")]
    pub(super) sigma: Option<PathBuf>,
    /// Write the standard deviation of every pixel of the result, in metres.
    #[arg(long)]
    pub(super) uncertainty: bool,
    /// Write a list of the points that do not agree with the others.
    #[arg(long)]
    pub(super) outliers: bool,
    /// Show the network every pixel, instead of a large image reduced to the size of training.
    #[arg(long)]
    pub(super) full: bool,
    /// Replace existing results.
    #[arg(long)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) model: Model,
}

/// Settings of the fit, laid over those of the weights.
#[derive(Debug, ClapArgs)]
pub(super) struct FitFlags {
    /// What depth is made of: lse (the paper's base functions), wls (a field that is smooth but for
    /// the image's edges), joint (both) [default: as the weights say].
    #[arg(long = "fit", value_enum, value_name = "METHOD")]
    fit_method: Option<FitMethod>,
    /// Fit without following outliers [default: as the weights say].
    #[arg(long, value_enum, value_name = "LOSS")]
    robust: Option<Robustness>,
    /// What is assumed before any depth is seen: none (the paper's fit), flat, learned [default: as
    /// the weights say].
    #[arg(long, value_enum)]
    prior: Option<PriorKind>,
    /// What base functions add up to: depth, log, inverse [default: as the weights say].
    #[arg(long, value_enum)]
    space: Option<Space>,
}

impl FitFlags {
    /// Lays the flags over settings. A learned prior is one over weights of depths: in another
    /// space the flat one takes its place. A lambda that was chosen for base functions beside a
    /// field says nothing of base functions alone, and the reverse.
    pub(super) fn apply(&self, fit: &mut FitConfig) {
        if let Some(method) = self.fit_method.filter(|&method| method != fit.method) {
            fit.method = method;
            fit.lambda = Lambda::Evidence;
        }
        fit.robust = self.robust.map_or(fit.robust, Robustness::settings);
        fit.space = self.space.unwrap_or(fit.space);
        if fit.space != Space::Depth && fit.prior == PriorKind::Learned {
            fit.prior = PriorKind::Flat;
        }
        fit.prior = self.prior.unwrap_or(fit.prior);
    }
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
    /// Configuration file, or the name of a built-in one (nyu.toml, nyu-medium.toml,
    /// nyu-joint.toml, smoke.toml).
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
    /// Published protocol: full, nyu, nyu-s2d, nyu-cspn, nyu-conti, diode-paper, diode-masked,
    /// diode-robustdc, kitti, void, marigold [default: that of the dataset].
    #[arg(long, value_name = "NAME", help_heading = "Protocol")]
    pub(super) protocol: Option<String>,
    /// Sparse points: N, exactly:N, bernoulli:N, bernoulli-all:N, grid:STEP, lines:N, corners:N,
    /// given, files:DIR [default: those of the protocol].
    #[arg(long, value_parser = typed::<Pattern>, value_name = "POINTS", help_heading = "Protocol")]
    pub(super) points: Option<Pattern>,
    /// Spoil points: added:SHARE:METRES or outliers:SHARE.
    #[arg(long, value_parser = typed::<Noise>, value_name = "NOISE", help_heading = "Protocol")]
    pub(super) noise: Option<Noise>,
    /// Names the first draw of points; the same for every method [default: 0].
    #[arg(long, help_heading = "Protocol")]
    pub(super) seed: Option<u64>,
    /// Draws of points, with consecutive seeds [default: 1].
    #[arg(long, value_name = "N", help_heading = "Protocol")]
    pub(super) seeds: Option<usize>,
    /// How true depths are resized [default: that of the protocol].
    #[arg(long, value_enum, help_heading = "Protocol")]
    pub(super) depth_resize: Option<Interpolation>,
    /// Measure only the first frames.
    #[arg(long, value_name = "N", help_heading = "Protocol")]
    pub(super) limit: Option<usize>,
    /// Methods, side by side on the same points: lsdc, nearest, linear, idw, tps, wls, levin,
    /// steering, ip-basic [default: lsdc,linear].
    #[arg(long, value_parser = typed::<Method>, value_delimiter = ',', value_name = "NAMES")]
    pub(super) method: Vec<Method>,
    #[command(flatten)]
    pub(super) fit: FitFlags,
    /// Measure the standard deviations of `lsdc` too: how many errors they cover, and how well they
    /// rank them.
    #[arg(long)]
    pub(super) uncertainty: bool,
    /// Score the depth maps of another program: FRAME.npy in metres or FRAME.png in millimetres,
    /// named as `lsdc export` names frames; may be repeated.
    #[arg(long, value_parser = named_folder, value_name = "[NAME=]DIR")]
    pub(super) predictions: Vec<(String, PathBuf)>,
    /// Measure only part I of N (I from 0); `lsdc report merge` joins the parts.
    #[arg(long, value_parser = typed::<Shard>, default_value = "0/1", value_name = "I/N")]
    pub(super) shard: Shard,
    /// Folder for the report in every form, and for a journal: begun again, an evaluation goes on
    /// where it stopped. A part writes to DIR/I-of-N.
    #[arg(short, long, value_name = "DIR", help_heading = "Output")]
    pub(super) output: Option<PathBuf>,
    /// Replace existing files, and begin anew in a folder that holds another evaluation.
    #[arg(long, help_heading = "Output")]
    pub(super) force: bool,
    /// Write the whole report here.
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    pub(super) json: Option<PathBuf>,
    /// Write the scores of each frame here.
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    pub(super) csv: Option<PathBuf>,
    /// Write a page with charts and pictures here.
    #[arg(long, value_name = "FILE", help_heading = "Output")]
    pub(super) html: Option<PathBuf>,
    /// Write every prediction here, as METHOD/seedN/FRAME.npy.
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    pub(super) save: Option<PathBuf>,
    #[command(flatten)]
    pub(super) model: Model,
}

impl Eval {
    /// The folder of the outputs: a part has one of its own in it, so that all parts may be given
    /// the same.
    pub(super) fn folder(&self) -> Option<PathBuf> {
        let folder = self.output.clone()?;
        Some(match self.shard {
            Shard::WHOLE => folder,
            part => folder.join(part.to_string()),
        })
    }

    /// Lays the flags over the configuration.
    pub(super) fn apply(&self, eval: &mut EvalConfig) {
        eval.preset = self.protocol.clone().or(eval.preset.take());
        eval.points = self.points.clone().or(eval.points.take());
        eval.noise = self.noise.or(eval.noise);
        eval.seed = self.seed.unwrap_or(eval.seed);
        eval.seeds = self.seeds.unwrap_or(eval.seeds);
        eval.limit = self.limit.or(eval.limit);
        if !self.method.is_empty() {
            eval.methods.clone_from(&self.method);
        }
    }
}

#[derive(Debug, Subcommand)]
pub(super) enum ReportCommand {
    /// Join the reports of shards, exactly, and print the whole.
    Merge(Merge),
    /// Show the error against the number of points, from one report for each number.
    Curve(Curves),
    /// Show how training went, of one run or several side by side.
    Training(Runs),
}

#[derive(Debug, ClapArgs)]
pub(super) struct Runs {
    /// Run folders.
    #[arg(required = true)]
    pub(super) folders: Vec<PathBuf>,
    /// Write a page with the curves here [default: only print the table].
    #[arg(long, value_name = "FILE")]
    pub(super) html: Option<PathBuf>,
    /// Replace an existing page.
    #[arg(long)]
    pub(super) force: bool,
}

#[derive(Debug, ClapArgs)]
pub(super) struct Curves {
    /// Reports of `lsdc eval --json` with different --points.
    #[arg(required = true)]
    pub(super) files: Vec<PathBuf>,
    /// Write a page with the curves here [default: only print the table].
    #[arg(long, value_name = "FILE")]
    pub(super) html: Option<PathBuf>,
    /// Replace an existing page.
    #[arg(long)]
    pub(super) force: bool,
}

#[derive(Debug, ClapArgs)]
pub(super) struct Merge {
    /// Reports of `lsdc eval --json` on different frames: the parts of --shard.
    #[arg(required = true)]
    pub(super) files: Vec<PathBuf>,
    /// Folder for the joined report in every form [default: only print it].
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: Option<PathBuf>,
    /// Replace existing files.
    #[arg(long)]
    pub(super) force: bool,
}

#[derive(Debug, Subcommand)]
pub(super) enum WeightsCommand {
    /// List the weights that come with the program.
    List,
    /// Describe weights: network, input, fit, how they were trained, and how well.
    Info {
        /// Weights file, or a name that `list` shows [default: the weights in the program].
        file: Option<PathBuf>,
        /// Print one JSON object.
        #[arg(long)]
        json: bool,
    },
    /// Write weights in another precision.
    Convert(Convert),
}

#[derive(Debug, ClapArgs)]
pub(super) struct Convert {
    /// Weights file, or a name that `list` shows.
    pub(super) input: PathBuf,
    /// Weights file to write.
    pub(super) output: PathBuf,
    /// Of the network's numbers: f16 or f32.
    #[arg(long, value_enum, default_value = "f16", value_name = "TYPE")]
    pub(super) precision: Precision,
    /// Replace the file if it exists.
    #[arg(long)]
    pub(super) force: bool,
}

#[derive(Debug, ClapArgs)]
pub(super) struct Calibrate {
    /// The frames that the weights were trained on.
    #[command(flatten)]
    pub(super) source: Source,
    /// For another fit than the weights say: lse, wls, joint.
    #[arg(long = "fit", value_enum, value_name = "METHOD")]
    pub(super) fit_method: Option<FitMethod>,
    /// Weights file to write.
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: PathBuf,
    /// Replace it if it exists.
    #[arg(long)]
    pub(super) force: bool,
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
    /// What becomes of the given depths: none (the fit need not meet them), exact (at their
    /// pixels), blend (and their neighbourhood follows).
    #[arg(long, value_enum, default_value = "none", value_name = "HOW")]
    pub(super) preserve_input: Preserve,
    /// The standard deviation of each sparse depth in metres, an npy array as large as the image.
    #[arg(long, value_name = "FILE")]
    pub(super) sigma: Option<PathBuf>,
    /// Write the standard deviation of every pixel of the result, in metres.
    #[arg(long)]
    pub(super) uncertainty: bool,
    /// Write a list of the points that do not agree with the others.
    #[arg(long)]
    pub(super) outliers: bool,
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
    /// Published protocol [default: that of the dataset].
    #[arg(long, value_name = "NAME")]
    pub(super) protocol: Option<String>,
    /// Only this frame, counted from 0 [default: all].
    #[arg(long, conflicts_with = "limit")]
    pub(super) index: Option<usize>,
    /// Only the first frames.
    #[arg(long, value_name = "N")]
    pub(super) limit: Option<usize>,
    /// Sparse points, as for `eval` [default: those of the protocol].
    #[arg(long, value_parser = typed::<Pattern>, value_name = "POINTS")]
    pub(super) points: Option<Pattern>,
    /// Spoil points, as for `eval`.
    #[arg(long, value_parser = typed::<Noise>, value_name = "NOISE")]
    pub(super) noise: Option<Noise>,
    /// Names the draw.
    #[arg(long, default_value_t = 0)]
    pub(super) seed: u64,
    /// Folder for rgb/FRAME.png, sparse/FRAME.npy and gt/FRAME.npy.
    #[arg(short, long, value_name = "DIR")]
    pub(super) output: PathBuf,
    /// Replace existing files.
    #[arg(long)]
    pub(super) force: bool,
}

/// Reads a value; what is wrong comes with the hint.
fn typed<T: FromStr<Err = Error>>(text: &str) -> std::result::Result<T, String> {
    text.parse().map_err(|error: Error| match error.advice() {
        Some(hint) => format!("{error}; {hint}"),
        None => error.to_string(),
    })
}

/// `NAME=DIR`, or `DIR`, named by its last part.
fn named_folder(text: &str) -> Result<(String, PathBuf)> {
    let (name, folder) = if let Some((name, folder)) = text.split_once('=') {
        (name.to_owned(), PathBuf::from(folder))
    } else {
        let folder = PathBuf::from(text);
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        (name.into_owned(), folder)
    };
    if name.is_empty() {
        return Err(Error::config(format!("`{text}` has no name")).hint("as in mine=results/depth"));
    }
    Ok((name, folder))
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
    ($kind:ty, $variants:expr) => {
        impl ValueEnum for $kind {
            fn value_variants<'a>() -> &'a [Self] {
                &$variants
            }

            fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
                Some(clap::builder::PossibleValue::new(self.name()))
            }
        }
    };
}

/// A robust loss, or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Robustness(Option<Loss>);

impl Robustness {
    /// The settings that are meant.
    pub(super) fn settings(self) -> Option<Robust> {
        self.0.map(Robust::new)
    }

    fn name(self) -> &'static str {
        self.0.map_or("none", Loss::name)
    }
}

by_name!(
    Robustness,
    [
        Self(None),
        Self(Some(Loss::Irls)),
        Self(Some(Loss::Huber)),
        Self(Some(Loss::Cauchy)),
        Self(Some(Loss::Gm)),
        Self(Some(Loss::Tukey)),
    ]
);
by_name!(FitMethod, Self::ALL);
by_name!(PriorKind, Self::ALL);
by_name!(Space, Self::ALL);
by_name!(Precision, [Self::Half, Self::Single]);
by_name!(Preserve, Self::ALL);
by_name!(Split, [Self::Train, Self::Val]);
by_name!(DatasetKind, Self::ALL);

impl ValueEnum for Interpolation {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
        let value = clap::builder::PossibleValue::new(self.name());
        Some(match self {
            Self::PilBilinear => value.alias("bilinear"),
            Self::CvNearest => value.alias("nearest"),
            Self::PilNearest | Self::CvBilinear => value,
        })
    }
}
