//! Arguments of `experiment`.

use super::values::{named_file, named_folder, typed};
use super::{Draws, Model, Settings, Source};
use clap::builder::PossibleValue;
use clap::{Args as ClapArgs, ValueEnum};
use lsdc_eval::data::GuideSource;
use lsdc_paper::experiment::Experiment;
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

/// An experiment, or all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::cli) struct Chosen(Option<Experiment>);

impl Chosen {
    /// The selected experiments, each once, in the order of the page.
    pub(in crate::cli) fn experiments(chosen: &[Self]) -> Vec<Experiment> {
        let meant = |e: &Experiment| chosen.iter().any(|c| c.0.is_none_or(|c| c == *e));
        Experiment::ALL.into_iter().filter(meant).collect()
    }
}

impl ValueEnum for Chosen {
    fn value_variants<'a>() -> &'a [Self] {
        /// The experiments, then all of them.
        const ALL: [Chosen; Experiment::ALL.len() + 1] = {
            let mut all = [Chosen(None); Experiment::ALL.len() + 1];
            let mut i = 0;
            while i < Experiment::ALL.len() {
                all[i] = Chosen(Some(Experiment::ALL[i]));
                i += 1;
            }
            all
        };
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let name = self.0.map_or("all", Experiment::name);
        Some(PossibleValue::new(name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn experiments_are_named_one_by_one_or_all_at_once() {
        let chosen = |name: &str| {
            let chosen = <Chosen as ValueEnum>::from_str(name, false).unwrap();
            Chosen::experiments(&[chosen])
        };
        assert_eq!(chosen("all"), Experiment::ALL);
        for experiment in Experiment::ALL {
            assert_eq!(chosen(experiment.name()), [experiment]);
        }
    }
}
