//! Ablation of the number of basis functions and of the positional encoding: one network for each setting, trained from the
//! same seed on an equal budget.

use super::tables::{axis, column, line};
use super::trial::{EPOCHS, TrainedNetwork, Trial, as_trials};
use super::{ExperimentContext, Study};
use burn::tensor::Device;
use lsdc_core::network::NetworkConfig;
use lsdc_eval::metrics::Metric;
use lsdc_eval::report::{AxisScales, Chart, Column, Ranking, Row, Section, Table, Training};
use lsdc_files::error::Result;
use lsdc_train::model::InitNetwork as _;

const BASES: [usize; 6] = [16, 32, 64, 128, 256, 512];
/// Octaves E of the encoding: 0 = no position, 1 = raw coordinates.
const OCTAVES: [usize; 8] = [0, 1, 3, 4, 5, 6, 7, 8];

/// A family of networks that differ in one setting.
struct Family<'a> {
    title: &'static str,
    name: &'static str,
    variable: &'static str,
    labels: Vec<String>,
    /// Indices of the trials.
    members: Vec<usize>,
    context: &'a ExperimentContext,
}

pub(super) struct Ablation<'a> {
    context: &'a ExperimentContext,
    trials: Vec<TrainedNetwork<'a>>,
    families: Vec<Family<'a>>,
}

impl<'a> Ablation<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Result<Self> {
        let frames = (context.recipe.frames)()?;
        let base = &context.recipe.network;
        let mut trials: Vec<TrainedNetwork<'a>> = Vec::new();
        // The network common to both families is trained once.
        let mut member = |network: NetworkConfig| {
            let there = trials.iter().position(|trial| trial.network == network);
            there.unwrap_or_else(|| {
                let name = format!("bases-{}-octaves-{}", network.bases, network.octaves);
                trials.push(TrainedNetwork::new(context, name, network, frames.clone()));
                trials.len() - 1
            })
        };
        let bases = BASES.map(|bases| {
            let mut hidden = base.hidden.clone();
            // A narrower last layer would make basis functions linearly dependent.
            if let Some(last) = hidden.last_mut() {
                *last = (*last).max(bases);
            }
            let hidden = if bases <= base.bases {
                base.hidden.clone()
            } else {
                hidden
            };
            member(NetworkConfig {
                hidden,
                bases,
                ..base.clone()
            })
        });
        let octaves = OCTAVES.map(|octaves| {
            member(NetworkConfig {
                octaves,
                ..base.clone()
            })
        });
        let called = |octaves: usize| match octaves {
            0 => "no position".to_owned(),
            1 => "raw position".to_owned(),
            e => format!("E = {e}"),
        };
        let families = vec![
            Family {
                title: "Number of basis functions",
                name: "bases",
                variable: "N",
                labels: BASES.map(|n| format!("N = {n}")).into(),
                members: bases.into(),
                context,
            },
            Family {
                title: "Encoding of the position",
                name: "octaves",
                variable: "encoding",
                labels: OCTAVES.map(called).into(),
                members: octaves.into(),
                context,
            },
        ];
        Ok(Self {
            context,
            trials,
            families,
        })
    }
}

impl Study for Ablation<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        as_trials(&self.trials)
    }

    fn section(&self) -> Result<Section> {
        let title = "Number of basis functions, and encoding of the position";
        let mut section = Section::new("ablation", title);
        let train = &self.context.recipe.train;
        section.about.push(format!(
            "Each network is trained from seed {} for {} steps of {} images through the plain fit of the recipe, \
             and measured after each of {EPOCHS} parts of the steps on {} frames kept out of training, \
             at the end on the frames of the other experiments ({}, {}).",
            train.seed,
            train.steps,
            train.batch,
            train.held_out,
            self.context.dataset,
            self.context.preset.points
        ));
        section.notes.push(
            "The paper trains 300,000 steps (100 epochs of 6,000 frames, two at a time) and takes \
             N = 128 and E = 5. On a budget this much smaller, the \
             order of networks tells how fast they learn, not where they end."
                .into(),
        );
        for family in &self.families {
            family.report(&self.trials, &mut section)?;
        }
        Ok(section)
    }
}

impl Family<'_> {
    fn report(&self, trials: &[TrainedNetwork<'_>], section: &mut Section) -> Result<()> {
        let metrics = [Metric::Rmse, Metric::Rel, Metric::Delta1];
        let mut rows = Vec::new();
        for (label, &member) in self.labels.iter().zip(&self.members) {
            let trial = &trials[member];
            let net = trial.network.init(0, &Device::flex())?;
            let mut row = Row::of(label, &trial.measured()?.first_scores()?, &metrics);
            let parameters = lsdc_train::model::parameter_count(&net);
            row.values.insert(0, Some(parameters as f64 / 1e6));
            rows.push(row);
        }
        let mut columns = vec![column("parameters", "M", 3)];
        columns.extend(metrics.map(Column::of));
        section.tables.push(Table {
            title: self.title.into(),
            row_header: self.variable.into(),
            ranking: Ranking::None,
            columns,
            rows,
        });
        let folders: Vec<_> = self.members.iter().map(|&i| trials[i].folder()).collect();
        let curves = Training::read(&folders)?.held_out();
        let epoch = self.context.recipe.train.steps.div_ceil(EPOCHS) as f64;
        for metric in [Metric::Rmse, Metric::Rel] {
            let lines = self.labels.iter().zip(&curves).enumerate();
            let lines = lines.map(|(colour, (label, curve))| {
                let points = curve.iter().map(|&(step, rmse, rel)| {
                    let value = if metric == Metric::Rmse { rmse } else { rel };
                    (step / epoch, value)
                });
                line(label, colour, points.collect())
            });
            let chart = Chart {
                title: &format!("{}: {}", self.title, metric.label()),
                x_label: &format!("epochs of {epoch:.0} steps"),
                y_label: &axis(metric),
                scales: AxisScales::Linear,
                lines: lines.collect(),
            };
            let name = format!("{}-{}", self.name, metric.key());
            let caption = "Frames kept out of training, 500 points.";
            section.add_figure(&name, caption, chart.draw());
        }
        Ok(())
    }
}
