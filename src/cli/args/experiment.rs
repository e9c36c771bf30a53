//! What is typed to repeat the paper's experiments.

use super::values::{Chosen, named_folder};
use super::{Draws, Model, Settings, Source};
use clap::Args as ClapArgs;
use std::path::PathBuf;

#[derive(Debug, ClapArgs)]
#[command(
    after_help = "`lsdc experiment --help` shows every option.",
    after_long_help = "docs/experiments.md says more."
)]
pub(in crate::cli) struct Experiments {
    /// Which: benchmark (table 1), ablation (N and E, trains), points, scale, noise, kernels,
    /// resolution (table 3), diode (table 4), cost (table 5), or all.
    #[arg(required = true, value_enum, hide_possible_values = true)]
    pub(in crate::cli) names: Vec<Chosen>,
    /// Folder for tables, pictures and one page, and for what has been measured: begun again,
    /// experiments go on where they stopped.
    #[arg(short, long, value_name = "DIR", help_heading = "Output")]
    pub(in crate::cli) output: PathBuf,
    /// Forget what has been measured there, and begin anew.
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) force: bool,
    #[command(flatten)]
    pub(in crate::cli) settings: Settings,
    #[command(flatten)]
    pub(in crate::cli) source: Source,
    #[command(flatten)]
    pub(in crate::cli) draws: Draws,
    /// Folder of DIODE, for experiment `diode`.
    #[arg(
        long,
        value_name = "DIR",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) diode: Option<PathBuf>,
    /// Depth maps of another program for the benchmark, as for `eval`; may be repeated.
    #[arg(long, value_parser = named_folder, value_name = "[NAME=]DIR", help_heading = "Input", hide_short_help = true)]
    pub(in crate::cli) predictions: Vec<(String, PathBuf)>,
    /// Steps of each training of the ablation; everything else is said by --config [default recipe:
    /// nyu-half.toml].
    #[arg(
        long,
        value_name = "N",
        default_value_t = 240,
        help_heading = "Settings",
        hide_short_help = true
    )]
    pub(in crate::cli) steps: usize,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
}
