//! Evaluation of the same weights on DIODE (Fang et al., table 4).

use super::benchmark::all;
use super::trial::{Measured, Trial};
use super::{ExperimentContext, Study, published, tables};
use lsdc_eval::data::Environment;
use lsdc_eval::metrics::Metric;
use lsdc_eval::report::{Row, Section};
use lsdc_eval::sampling::ProtocolPreset;
use lsdc_files::error::Result;

const PRESETS: [&str; 3] = ["diode-paper", "diode-masked", "diode-robustdc"];
const METRICS: [Metric; 4] = [Metric::Rmse, Metric::Rel, Metric::Delta1, Metric::Mae];

pub(super) struct Diode<'a> {
    trials: Vec<(ProtocolPreset, Measured<'a>)>,
    context: &'a ExperimentContext,
}

impl<'a> Diode<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Result<Self> {
        let mut trials = Vec::new();
        for name in PRESETS {
            let (preset, Some(frames)) = (ProtocolPreset::named(name)?, &context.diode) else {
                continue;
            };
            let trial = Measured::new(context, name)
                .methods(&all())
                .on_frames("diode val".into(), frames.clone())
                .protocol(&preset);
            trials.push((preset, trial));
        }
        Ok(Self { trials, context })
    }
}

impl Study for Diode<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        self.trials
            .iter()
            .map(|(_, trial)| trial as &dyn Trial)
            .collect()
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("diode", "The same weights on DIODE (table 4)");
        match &self.context.diode {
            None => section
                .about
                .push("Not measured: give the folder of DIODE with --diode.".into()),
            Some(frames) => section.about.push(format!(
                "{}; {}. Nothing was trained on DIODE.",
                frames.description(),
                self.context.weights
            )),
        }
        for (preset, trial) in &self.trials {
            let report = trial.report()?;
            for place in report.places() {
                let (word, number) = match place {
                    Environment::Indoor => ("indoor", 0),
                    Environment::Outdoor => ("outdoor", 1),
                };
                let means = report.means(Some(place));
                let mut rows: Vec<Row> = means
                    .iter()
                    .map(|mean| Row::of(mean.method, &mean.mean, &METRICS))
                    .collect();
                if preset.name == PRESETS[0] {
                    for (name, indoor, outdoor) in published::TABLE_4 {
                        let errors = [indoor, outdoor][number];
                        let mut values = errors.map(Some).to_vec();
                        values.push(None);
                        rows.push(published::row(name, values));
                    }
                }
                let frames = report
                    .frames()
                    .values()
                    .filter(|f| f.place == place)
                    .count();
                let title = format!("{}, {word}, {frames} frames", preset.name);
                section.add_ranked_table(tables::of_methods(title, &METRICS, rows), "lsdc");
            }
        }
        section.notes = published::notes(&published::TABLE_4_NOTES);
        // With the mask, because depths outside it are unknown.
        if let Some((_, trial)) = self.trials.get(1) {
            let caption = "The frame on which lsdc is neither good nor bad, with the mask.";
            trial.show(&mut section, caption)?;
        }
        Ok(section)
    }
}
