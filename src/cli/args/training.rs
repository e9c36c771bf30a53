//! Arguments of `train`, `calibrate` and `weights`.

use super::values::{fit_method, trainable};
use super::{Model, Settings, Source};
use clap::Args as ClapArgs;
use lsdc_core::fit::FitMethod;
use lsdc_eval::data::Shard;
use lsdc_eval::predict::Method;
use std::path::PathBuf;

#[derive(Debug, ClapArgs)]
#[command(
    after_help = "`lsdc train --help` shows every option.",
    after_long_help = "See docs/training.md for details."
)]
pub(in crate::cli) struct Train {
    #[command(flatten)]
    pub(in crate::cli) settings: Settings,
    #[command(flatten)]
    pub(in crate::cli) source: Source,
    /// What to train: lsdc, or a system that its paper compares itself with, by the configuration of that name unless
    /// another is given: s2d (Ma and Karaman, Sparse-to-Dense, ICRA 2018), cspn (Cheng, Wang and Yang, ECCV 2018), lsk
    /// (Liu et al., Learning Steering Kernels, TIP 2021).
    #[arg(long, value_parser = trainable, value_name = "NAME", conflicts_with = "resume", help_heading = "Settings")]
    pub(in crate::cli) method: Option<Method>,
    /// Run folder [default: runs/NAME, with the name of the configuration].
    #[arg(
        short,
        long,
        value_name = "DIR",
        conflicts_with = "resume",
        help_heading = "Output"
    )]
    pub(in crate::cli) output: Option<PathBuf>,
    /// Resume the run in this folder, with its own settings.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["config", "set", "dataset"], help_heading = "Output")]
    pub(in crate::cli) resume: Option<PathBuf>,
    /// Do not train: only compute what the run keeps in files, the answers of its teacher and what its encoder says
    /// of the views of frames.
    #[arg(long, conflicts_with_all = ["resume", "output"], help_heading = "Settings", hide_short_help = true)]
    pub(in crate::cli) prepare: bool,
    /// With --prepare: only part I of N of the frames (I from 0), so that several processes can share the work.
    #[arg(
        long,
        value_name = "I/N",
        requires = "prepare",
        help_heading = "Settings",
        hide_short_help = true
    )]
    pub(in crate::cli) shard: Option<Shard>,
    /// Random seed of initial weights, frame order, augmentation and points.
    #[arg(long, help_heading = "Settings", hide_short_help = true)]
    pub(in crate::cli) seed: Option<u64>,
    /// Compute device; several devices, as in wgpu:0,wgpu:1, share every batch.
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
#[command(
    after_long_help = "Give the frames that the weights were trained on; with --only-errors, or with fewer frames than \
                       basis functions, frames that they were not. With fewer frames than basis functions, the prior stays \
                       as it is.\n\nOf a configuration, only the dataset is read. See docs/own-data.md for details."
)]
pub(in crate::cli) struct Calibrate {
    #[command(flatten)]
    pub(in crate::cli) settings: Settings,
    #[command(flatten)]
    pub(in crate::cli) source: Source,
    /// Keep the prior and the fit, and learn only how errors are distributed, from frames of any cameras that
    /// the weights have not seen.
    #[arg(long, conflicts_with_all = ["fit_method", "cosines"])]
    pub(in crate::cli) only_errors: bool,
    /// Calibrate for this fit instead of the one stored with the weights: lse, field, joint.
    #[arg(long = "fit", value_parser = fit_method(), hide_possible_values = true, value_name = "METHOD")]
    pub(in crate::cli) fit_method: Option<FitMethod>,
    /// Highest frequency of the cosine basis of the joint fit; 0 for none [default: as stored with the
    /// weights].
    #[arg(long, alias = "waves", value_name = "F")]
    pub(in crate::cli) cosines: Option<f64>,
    /// The scene of every frame, as a file of lines FRAME,SCENE: errors are measured on other scenes than they were
    /// learned from [default: the first folder in which the names of frames differ; without one, other frames].
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) scenes: Option<PathBuf>,
    /// Weights file to write.
    #[arg(short, long, value_name = "FILE")]
    pub(in crate::cli) output: PathBuf,
    /// Replace the file if it exists.
    #[arg(long)]
    pub(in crate::cli) force: bool,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
}
