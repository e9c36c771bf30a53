//! Command-line arguments.

mod completion;
mod encoder;
mod evaluation;
#[cfg(feature = "train")]
mod experiment;
mod fit;
mod fuse;
mod inspect;
#[cfg(feature = "node")]
mod node;
mod recorded;
mod reports;
#[cfg(feature = "serve")]
mod serve;
#[cfg(feature = "train")]
mod training;
mod values;
mod weights;

pub(super) use completion::{Bench, Complete};
#[cfg(feature = "serve")]
pub(super) use encoder::PretrainedEncoder;
pub(super) use evaluation::{Eval, Export};
#[cfg(feature = "train")]
pub(super) use experiment::{Chosen, Experiments};
use fit::FitFlags;
pub(super) use fuse::Fuse;
pub(super) use inspect::{Completions, Inspect, Manual};
#[cfg(feature = "node")]
pub(super) use node::NodeArgs;
pub(super) use recorded::Recorded;
#[cfg(feature = "node")]
pub(super) use recorded::Units;
pub(super) use reports::{Curves, Merge, ReportCommand, Runs};
#[cfg(feature = "serve")]
pub(super) use serve::{Serve, View};
#[cfg(feature = "train")]
pub(super) use training::{Calibrate, Train};
pub(super) use values::{Format, PoseSource};
use values::{dataset, split};
#[cfg(feature = "download")]
pub(super) use weights::Get;
pub(super) use weights::{Add, Convert, ExportNetwork, WeightsCommand};

use clap::{Args as ClapArgs, Parser, Subcommand};
use lsdc_eval::data::{DatasetKind, Split};
use lsdc_eval::evaluation::EvalConfig;
use std::path::PathBuf;

/// Depth completion: an RGB image and a few sparse depths in, dense depth in metres out.
#[derive(Debug, Parser)]
#[command(name = "lsdc", version, max_term_width = 100)]
pub(super) struct Args {
    /// Print more messages (-v: progress of each stage, -vv: everything); RUST_LOG overrides this.
    #[arg(short, long, global = true, action = clap::ArgAction::Count, help_heading = "Messages", hide_short_help = true)]
    pub(super) verbose: u8,
    /// Print only requested output, warnings and errors.
    #[arg(
        short,
        long,
        global = true,
        conflicts_with = "verbose",
        help_heading = "Messages",
        hide_short_help = true
    )]
    pub(super) quiet: bool,
    #[command(subcommand)]
    pub(super) command: Command,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Complete sparse depths to dense depth maps.
    Complete(Box<Complete>),
    /// Fuse completed frames with camera poses into one surface.
    Fuse(Box<Fuse>),
    /// Show what is in a file: type, size, units, coverage, range.
    Inspect(Inspect),
    /// Complete the topics of a running robot (ROS 2).
    #[cfg(feature = "node")]
    Node(Box<NodeArgs>),
    /// Complete depth over HTTP, for other programs.
    #[cfg(feature = "serve")]
    Serve(Box<Serve>),
    /// Look at images, points and depth in a page on this machine.
    #[cfg(feature = "serve")]
    View(Box<View>),
    /// Evaluate methods on a dataset.
    Eval(Box<Eval>),
    /// Repeat the paper's experiments: tables, figures, and one page with all results.
    #[cfg(feature = "train")]
    Experiment(Box<Experiments>),
    /// Merge and show reports.
    #[command(subcommand)]
    Report(ReportCommand),
    /// Train a network.
    #[cfg(feature = "train")]
    Train(Train),
    /// List, install, describe, convert and export weights.
    #[command(subcommand)]
    Weights(WeightsCommand),
    /// Learn the prior over the weights of the basis functions and calibrate the standard deviations, as
    /// training does after its last step, for an existing weights file.
    #[cfg(feature = "train")]
    Calibrate(Calibrate),
    /// Write frames of a dataset to files, at the protocol's size and with the points of `eval`.
    Export(Export),
    /// Measure how fast this machine completes depth.
    Bench(Bench),
    /// Print every setting with its value.
    Config(Settings),
    /// Print a shell completion script, for the shell to source.
    Completions(Completions),
    /// Write man pages.
    Man(Manual),
}

#[derive(Clone, Debug, ClapArgs)]
pub(super) struct Model {
    /// Weights file, or a name listed by `lsdc weights list` [default: `default`, the most accurate weights that need
    /// nothing installed].
    #[arg(
        long,
        value_name = "FILE",
        help_heading = "Network",
        hide_short_help = true
    )]
    pub(super) weights: Option<PathBuf>,
    #[cfg_attr(
        feature = "train",
        doc = "Compute device: cpu, wgpu, wgpu:N, wgpu:integrated, wgpu:software, ndarray."
    )]
    #[cfg_attr(
        all(feature = "gpu", not(feature = "train")),
        doc = "Compute device: cpu, wgpu, wgpu:N, wgpu:integrated, wgpu:software."
    )]
    #[cfg_attr(
        not(any(feature = "gpu", feature = "train")),
        doc = "Compute device: cpu, the only one of this build."
    )]
    #[arg(
        long,
        default_value = "cpu",
        env = "LSDC_DEVICE",
        help_heading = "Hardware",
        hide_short_help = true
    )]
    pub(super) device: String,
}

/// Settings; later ones take precedence: built-in, file, --set, flags.
#[derive(Debug, ClapArgs)]
pub(super) struct Settings {
    /// Configuration file, or the name of a built-in configuration (nyu.toml, nyu-half.toml, nyu-bases.toml,
    /// nyu-affinities.toml, nyu-joint.toml, nyu-anything.toml, nyu-distill.toml, nyu-map.toml, nyu-lite.toml, own.toml,
    /// s2d.toml, cspn.toml, lsk.toml, lsk-ours.toml, smoke.toml).
    #[arg(long, value_name = "FILE", help_heading = "Settings")]
    pub(super) config: Option<PathBuf>,
    /// Change one setting, as in --set train.steps=100; may be repeated.
    #[arg(
        long,
        value_name = "KEY=VALUE",
        help_heading = "Settings",
        hide_short_help = true
    )]
    pub(super) set: Vec<String>,
}

#[derive(Debug, ClapArgs)]
pub(super) struct Source {
    /// Dataset format.
    #[arg(long, value_parser = dataset(), help_heading = "Input")]
    pub(super) dataset: Option<DatasetKind>,
    /// Folder (or file) of the dataset [default: `data.root` of the configuration, or LSDC_DATA].
    #[arg(long, value_name = "DIR", help_heading = "Input")]
    pub(super) root: Option<PathBuf>,
}

/// Which frames are evaluated, and with which points.
#[derive(Debug, ClapArgs)]
pub(super) struct Draws {
    /// Split of the dataset.
    #[arg(
        long,
        value_parser = split(),
        default_value = "val",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(super) split: Split,
    /// Published protocol: full, nyu, nyu-s2d, nyu-cspn, nyu-conti, diode-paper, diode-masked,
    /// diode-robustdc, kitti, void, marigold, scans, scans-filtered [default: that of the dataset].
    #[arg(
        long,
        value_name = "NAME",
        help_heading = "Protocol",
        hide_short_help = true
    )]
    protocol: Option<String>,
    /// Seed of the first random draw of points, which is the same for every method [default: 0].
    #[arg(long, help_heading = "Protocol", hide_short_help = true)]
    seed: Option<u64>,
    /// Number of random draws of points, with consecutive seeds [default: 1].
    #[arg(
        long,
        value_name = "N",
        help_heading = "Protocol",
        hide_short_help = true
    )]
    seeds: Option<usize>,
    /// Evaluate only the first N frames.
    #[arg(
        long,
        value_name = "N",
        help_heading = "Protocol",
        hide_short_help = true
    )]
    limit: Option<usize>,
}

impl Draws {
    /// Overrides the configuration with the flags.
    pub(super) fn apply(&self, eval: &mut EvalConfig) {
        eval.preset = self.protocol.clone().or(eval.preset.take());
        eval.seed = self.seed.unwrap_or(eval.seed);
        eval.seeds = self.seeds.unwrap_or(eval.seeds);
        eval.limit = self.limit.or(eval.limit);
    }
}
