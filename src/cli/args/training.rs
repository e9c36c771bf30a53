//! What is typed to train, and to handle weights.

use super::values::{NamedFit, typed};
use super::{Model, Settings, Source};
use crate::model::Precision;
use clap::{Args as ClapArgs, Subcommand};
use std::path::PathBuf;

#[derive(Debug, ClapArgs)]
#[command(
    after_help = "`lsdc train --help` shows every option.",
    after_long_help = "docs/training.md says more."
)]
pub(in crate::cli) struct Train {
    #[command(flatten)]
    pub(in crate::cli) settings: Settings,
    #[command(flatten)]
    pub(in crate::cli) source: Source,
    /// Run folder [default: runs/ and the name of the configuration].
    #[arg(
        short,
        long,
        value_name = "DIR",
        conflicts_with = "resume",
        help_heading = "Output"
    )]
    pub(in crate::cli) output: Option<PathBuf>,
    /// Go on with the run in this folder, with its own settings.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["config", "set", "dataset"], help_heading = "Output")]
    pub(in crate::cli) resume: Option<PathBuf>,
    /// Seed of weights, order, augmentation and points.
    #[arg(long, help_heading = "Settings", hide_short_help = true)]
    pub(in crate::cli) seed: Option<u64>,
    /// Where to compute; several, as in wgpu:0,wgpu:1, divide every batch among them.
    #[arg(
        long,
        value_name = "DEVICE,...",
        default_value = "cpu",
        env = "LSDC_DEVICE",
        help_heading = "Hardware",
        hide_short_help = true
    )]
    pub(in crate::cli) device: String,
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Calibrate {
    /// The frames that the weights were trained on.
    #[command(flatten)]
    pub(in crate::cli) source: Source,
    /// For another fit than the weights say: lse, field, joint.
    #[arg(long = "fit", value_parser = typed::<NamedFit>, value_name = "METHOD")]
    pub(in crate::cli) fit_method: Option<NamedFit>,
    /// Highest frequency of the cosine basis beside the functions of the network, for the joint fit; 0
    /// for none [default: as the weights say].
    #[arg(long, alias = "waves", value_name = "F")]
    pub(in crate::cli) cosines: Option<f64>,
    /// Weights file to write.
    #[arg(short, long, value_name = "FILE")]
    pub(in crate::cli) output: PathBuf,
    /// Replace it if it exists.
    #[arg(long)]
    pub(in crate::cli) force: bool,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
}

#[derive(Debug, Subcommand)]
pub(in crate::cli) enum WeightsCommand {
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
pub(in crate::cli) struct Convert {
    /// Weights file, or a name that `list` shows.
    pub(in crate::cli) input: PathBuf,
    /// Weights file to write.
    pub(in crate::cli) output: PathBuf,
    /// Of the network's numbers: f16 or f32.
    #[arg(long, value_enum, default_value = "f16", value_name = "TYPE")]
    pub(in crate::cli) precision: Precision,
    /// Replace the file if it exists.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}
