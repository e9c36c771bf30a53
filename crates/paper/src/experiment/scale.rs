//! Errors against the scale of the depths.

use super::frames::scaled;
use super::points::compare;
use super::tables::axis;
use super::trial::{Measured, Trial, as_trials};
use super::{ExperimentContext, Study};
use lsdc_eval::metrics::Metric;
use lsdc_eval::predict::{Classic, Method};
use lsdc_eval::report::{AxisScales, Chart, Section};
use lsdc_files::error::Result;

const FACTORS: [f32; 7] = [0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 10.0];

const METHODS: [Method; 3] = [
    Method::Lsdc,
    Method::Classic(Classic::Linear),
    Method::Classic(Classic::Smooth),
];

pub(super) struct ScaleStudy<'a> {
    context: &'a ExperimentContext,
    trials: Vec<Measured<'a>>,
}

impl<'a> ScaleStudy<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Self {
        let trial = |factor: f32| {
            let frames = scaled(context.frames.clone(), factor);
            Measured::new(context, format!("scale-{factor}"))
                .methods(&METHODS)
                .on_frames(format!("{} x {factor}", context.dataset), frames)
        };
        Self {
            context,
            trials: FACTORS.map(trial).into(),
        }
    }
}

impl Study for ScaleStudy<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        as_trials(&self.trials)
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("scale", "Errors against the scale of the depths");
        section.about.push(format!(
            "{} Sparse and true depths are multiplied by the factor; the image stays.",
            self.context.about()
        ));
        let labels = FACTORS.map(|factor| (factor.to_string(), f64::from(factor)));
        let (table, lines) = compare(Metric::Rel, &labels, "factor", &self.trials)?;
        section.findings.extend(table.ranking_summary("lsdc"));
        let ours: Vec<f64> = table.rows.iter().filter_map(|row| row.values[0]).collect();
        let most = ours.iter().copied().fold(f64::MIN, f64::max);
        let least = ours.iter().copied().fold(f64::MAX, f64::min);
        section.findings.push(format!(
            "REL of lsdc differs by {:.1e} between all factors: depth is linear in the sparse depths.",
            most - least
        ));
        section.tables.push(table);
        let drawing = Chart {
            title: "REL against the scale of the depths",
            x_label: "factor",
            y_label: &axis(Metric::Rel),
            scales: AxisScales::LogX,
            lines,
        };
        section.add_figure(
            "rel",
            "A level line is a method without a scale of its own.",
            drawing.draw(),
        );
        Ok(section)
    }
}
