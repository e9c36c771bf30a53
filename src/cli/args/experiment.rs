//! Arguments of `experiment`.

use super::values::{Chosen, named_file, named_folder, typed};
use super::{Draws, Model, Settings, Source};
use crate::data::GuideSource;
use clap::Args as ClapArgs;
use std::path::PathBuf;

#[derive(Debug, ClapArgs)]
#[command(
    after_help = "`lsdc experiment --help` shows every option.",
    after_long_help = "See docs/experiments.md for details."
)]
pub(in crate::cli) struct Experiments {
    /// Experiments to run: benchmark (table 1), ablation (of N and E, with training), points, scale, noise,
    /// uncertainty, knowledge (the weights that there are), kernels, resolution (table 3), diode (table 4), cost (table 5), systems
    /// (those that the paper compares itself with, trained and measured alike), or all.
    #[arg(required = true, value_enum, hide_possible_values = true)]
    pub(in crate::cli) names: Vec<Chosen>,
    /// Folder for tables, figures and the page, and for the measurements, from which a repeated command
    /// resumes.
    #[arg(short, long, value_name = "DIR", help_heading = "Output")]
    pub(in crate::cli) output: PathBuf,
    /// Discard the measurements in the output folder and start again.
    #[arg(long, help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) force: bool,
    #[command(flatten)]
    pub(in crate::cli) settings: Settings,
    #[command(flatten)]
    pub(in crate::cli) source: Source,
    #[command(flatten)]
    pub(in crate::cli) draws: Draws,
    /// Folder of DIODE, for the experiment `diode`.
    #[arg(
        long,
        value_name = "DIR",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) diode: Option<PathBuf>,
    /// Dense predictions of another program, which the experiment `knowledge` gives to the weights `none` and `default`
    /// as guides, as for `eval`.
    #[arg(long, value_parser = typed::<GuideSource>, value_name = "DIR[:KIND]", help_heading = "Input", hide_short_help = true)]
    pub(in crate::cli) guide: Option<GuideSource>,
    /// Depth maps of another program to include in the benchmark, as for `eval`; may be repeated.
    #[arg(long, value_parser = named_folder, value_name = "[NAME=]DIR", help_heading = "Input", hide_short_help = true)]
    pub(in crate::cli) predictions: Vec<(String, PathBuf)>,
    /// Weights of a system for the experiment `systems`, as for `eval`; may be repeated [default: it trains all of them, on
    /// the budget of --steps].
    #[arg(long, value_parser = named_file, value_name = "[NAME=]FILE", help_heading = "Input", hide_short_help = true)]
    pub(in crate::cli) system: Vec<(Option<String>, PathBuf)>,
    /// Training steps for each variant of the ablation and each of the systems; all other settings come from --config
    /// [default recipe: nyu-half.toml], those that only a system has from s2d.toml, cspn.toml, lsk.toml, lsk-ours.toml.
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
