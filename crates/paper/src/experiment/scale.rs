//! Errors against the scale of the depths.

use super::points::{axis, compare};
use super::trial::{Measured, Trial};
use super::{ExperimentContext, Study};
use lsdc_eval::data::{Dataset, DepthMap, Frame, FrameId};
use lsdc_eval::metrics::Metric;
use lsdc_eval::predict::{Classic, Method};
use lsdc_eval::report::{Chart, Scales, Section};
use lsdc_files::error::Result;
use std::path::PathBuf;
use std::sync::Arc;

const FACTORS: [f32; 7] = [0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 10.0];

const METHODS: [Method; 3] = [
    Method::Lsdc,
    Method::Classic(Classic::Linear),
    Method::Classic(Classic::Smooth),
];

pub(super) struct Scale<'a> {
    context: &'a ExperimentContext,
    trials: Vec<Measured<'a>>,
}

impl<'a> Scale<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Self {
        let trial = |factor: f32| {
            let frames = Arc::new(Scaled {
                frames: context.frames.clone(),
                factor,
            });
            Measured::new(context, format!("scale-{factor}"))
                .methods(&METHODS)
                .on(format!("{} x {factor}", context.dataset), frames)
        };
        Self {
            context,
            trials: FACTORS.map(trial).into(),
        }
    }
}

impl Study for Scale<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        self.trials
            .iter()
            .map(|trial| trial as &dyn Trial)
            .collect()
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("scale", "Errors against the scale of the depths");
        section.about.push(format!(
            "{} Sparse and true depths are multiplied by the factor; the image stays.",
            self.context.about()
        ));
        let labels = FACTORS.map(|factor| (factor.to_string(), f64::from(factor)));
        let (table, lines) = compare(Metric::Rel, &labels, "factor", &self.trials)?;
        section.findings.extend(table.verdict("lsdc"));
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
            across: "factor",
            up: &axis(Metric::Rel),
            scales: Scales::LogarithmicAcross,
            lines,
        };
        section.show(
            "rel",
            "A level line is a method without a scale of its own.",
            drawing.draw(),
        );
        Ok(section)
    }
}

/// Frames whose depths are multiplied.
pub(super) struct Scaled {
    pub(super) frames: Arc<dyn Dataset>,
    pub(super) factor: f32,
}

impl Dataset for Scaled {
    fn about(&self) -> String {
        format!("{}, depths x {}", self.frames.about(), self.factor)
    }

    fn protocol(&self) -> &'static str {
        self.frames.protocol()
    }

    fn len(&self) -> usize {
        self.frames.len()
    }

    fn id(&self, index: usize) -> FrameId {
        self.frames.id(index)
    }

    fn files(&self, index: usize) -> Vec<PathBuf> {
        self.frames.files(index)
    }

    fn load(&self, index: usize) -> Result<Frame> {
        let frame = self.frames.load(index)?;
        let scaled = |map: &DepthMap| {
            let values = map.values().iter().map(|d| d * self.factor).collect();
            DepthMap::new(map.width(), map.height(), values)
        };
        Ok(Frame {
            depth: scaled(&frame.depth)?,
            sparse: frame.sparse.as_ref().map(scaled).transpose()?,
            ..frame
        })
    }
}
