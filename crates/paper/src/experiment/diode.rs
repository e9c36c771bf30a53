//! The same weights on DIODE (Fang et al., table 4).

use super::benchmark::all;
use super::trial::{Measured, Trial};
use super::{ExperimentContext, Study, published};
use lsdc_eval::data::Place;
use lsdc_eval::metrics::Metric;
use lsdc_eval::report::{Column, Contest, Row, Section, Table};
use lsdc_eval::sampling::Preset;
use lsdc_files::error::Result;

const PRESETS: [&str; 3] = ["diode-paper", "diode-masked", "diode-robustdc"];
const METRICS: [Metric; 4] = [Metric::Rmse, Metric::Rel, Metric::Delta1, Metric::Mae];

pub(super) struct Diode<'a> {
    cells: Vec<(Preset, Measured<'a>)>,
    lab: &'a ExperimentContext,
}

impl<'a> Diode<'a> {
    pub(super) fn new(lab: &'a ExperimentContext) -> Result<Self> {
        let mut cells = Vec::new();
        for name in PRESETS {
            let (preset, Some(frames)) = (Preset::named(name)?, &lab.diode) else {
                continue;
            };
            let cell = Measured::new(lab, name)
                .methods(&all())
                .on("diode val".into(), frames.clone())
                .protocol(&preset);
            cells.push((preset, cell));
        }
        Ok(Self { cells, lab })
    }
}

impl Study for Diode<'_> {
    fn cells(&self) -> Vec<&dyn Trial> {
        self.cells
            .iter()
            .map(|(_, cell)| cell as &dyn Trial)
            .collect()
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("diode", "The same weights on DIODE (table 4)");
        match &self.lab.diode {
            None => section
                .about
                .push("Not measured: give the folder of DIODE with --diode.".into()),
            Some(frames) => section.about.push(format!(
                "{}; {}. Nothing was trained on DIODE.",
                frames.about(),
                self.lab.weights
            )),
        }
        for (preset, cell) in &self.cells {
            let report = cell.report()?;
            for place in report.places() {
                let (word, number) = match place {
                    Place::Indoor => ("indoor", 0),
                    Place::Outdoor => ("outdoor", 1),
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
                let table = Table {
                    title: format!("{}, {word}, {frames} frames", preset.name),
                    rows_are: "method".into(),
                    contest: Contest::Rows,
                    columns: METRICS.iter().map(|&m| Column::of(m)).collect(),
                    rows,
                };
                section.judge(table, "lsdc");
            }
        }
        section.notes = published::notes(&published::TABLE_4_NOTES);
        // With the mask: what lies beyond is not known.
        if let Some((_, cell)) = self.cells.get(1) {
            let caption = "The frame on which lsdc is neither good nor bad, with the mask.";
            cell.show(&mut section, caption)?;
        }
        Ok(section)
    }
}
