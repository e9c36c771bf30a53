//! The conditions of the comparison.

use super::compared::ComparedSystems;
use super::condition::Condition;
use crate::experiment::frames::{narrowed, scaled};
use crate::experiment::resolution;
use lsdc_eval::metrics::Metric;
use lsdc_eval::sampling::{Noise, Pattern, ProtocolPreset};
use lsdc_files::error::Result;
use std::rc::Rc;

/// Numbers of points, in addition to that of the training.
pub(super) const COUNTS: [usize; 5] = [5, 50, 200, 1000, 5000];
/// Index of the number of points shown in pictures.
const SHOWN: usize = 1;
/// Patterns that are not random.
const PATTERNS: [Pattern; 4] = [
    Pattern::Grid(12),
    Pattern::Lines(16),
    Pattern::Corners(500),
    Pattern::Half(500),
];
const FACTORS: [f32; 2] = [0.1, 10.0];
/// Kinds of noise: label, name in files, noise.
const NOISES: [(&str, &str, Noise); 3] = [
    (
        "up to 1 m added to 30 %",
        "added",
        Noise::Added {
            share: 0.3,
            most: 1.0,
        },
    ),
    ("10 % anywhere", "outliers", Noise::Outliers { share: 0.1 }),
    (
        "as of stereo, 1 % of the square",
        "stereo",
        Noise::Stereo { factor: 0.01 },
    ),
];

/// Conditions that differ in one setting.
pub(super) struct ConditionGroup<'a> {
    pub(super) title: &'static str,
    /// Name of the setting.
    pub(super) row_header: &'static str,
    /// Metrics shown.
    pub(super) metrics: &'static [Metric],
    pub(super) conditions: Vec<Condition<'a>>,
}

pub(super) struct Conditions<'a> {
    /// The condition of the training.
    pub(super) trained: Condition<'a>,
    pub(super) counts: ConditionGroup<'a>,
    pub(super) others: [ConditionGroup<'a>; 4],
    /// Depth at three times the resolution of the image.
    pub(super) sharp: Condition<'a>,
}

impl<'a> Conditions<'a> {
    pub(super) fn new(compared: &Rc<ComparedSystems<'a>>) -> Result<Self> {
        Ok(Self {
            trained: Condition::new(compared, "500", "as trained", |trial| trial),
            counts: counts(compared),
            others: [
                patterns(compared),
                scales(compared),
                noises(compared),
                cameras(compared)?,
            ],
            sharp: sharp(compared),
        })
    }

    /// Returns all conditions, in the order of evaluation.
    pub(super) fn all(&self) -> impl Iterator<Item = &Condition<'a>> {
        let groups = std::iter::once(&self.counts).chain(&self.others);
        std::iter::once(&self.trained)
            .chain(groups.flat_map(|group| &group.conditions))
            .chain(std::iter::once(&self.sharp))
    }

    /// Returns the condition with few points.
    pub(super) fn few(&self) -> &Condition<'a> {
        &self.counts.conditions[SHOWN]
    }
}

fn counts<'a>(compared: &Rc<ComparedSystems<'a>>) -> ConditionGroup<'a> {
    let condition = |count: usize| {
        let name = count.to_string();
        Condition::new(compared, &name, &name, move |trial| {
            trial.points(Pattern::Exactly(count))
        })
    };
    ConditionGroup {
        title: "Other numbers of points",
        row_header: "points",
        metrics: &[Metric::Rmse, Metric::Rel],
        conditions: COUNTS.map(condition).into(),
    }
}

fn patterns<'a>(compared: &Rc<ComparedSystems<'a>>) -> ConditionGroup<'a> {
    let condition = |pattern: Pattern| {
        let name = String::from(pattern.clone()).replace(':', "-");
        Condition::new(compared, &name, pattern.to_string(), move |trial| {
            trial.points(pattern.clone())
        })
    };
    ConditionGroup {
        title: "Other patterns",
        row_header: "points",
        metrics: &[Metric::Rmse],
        conditions: PATTERNS.map(condition).into(),
    }
}

fn scales<'a>(compared: &Rc<ComparedSystems<'a>>) -> ConditionGroup<'a> {
    let context = compared.context;
    let condition = |factor: f32| {
        let name = format!("x{factor}");
        Condition::new(compared, &name, factor.to_string(), move |trial| {
            let frames = scaled(context.frames.clone(), factor);
            trial.on_frames(format!("{} x {factor}", context.dataset), frames)
        })
    };
    ConditionGroup {
        title: "Scaled depths",
        row_header: "factor",
        metrics: &[Metric::Rel],
        conditions: FACTORS.map(condition).into(),
    }
}

fn noises<'a>(compared: &Rc<ComparedSystems<'a>>) -> ConditionGroup<'a> {
    let condition = |(label, name, noise): (&str, &str, Noise)| {
        Condition::new(compared, name, label, move |trial| trial.noise(Some(noise)))
    };
    ConditionGroup {
        title: "Wrong points",
        row_header: "what is wrong",
        metrics: &[Metric::Rmse],
        conditions: NOISES.map(condition).into(),
    }
}

fn cameras<'a>(compared: &Rc<ComparedSystems<'a>>) -> Result<ConditionGroup<'a>> {
    let context = compared.context;
    let mut conditions = vec![Condition::new(
        compared,
        "narrow",
        "half the view",
        move |trial| {
            let frames = narrowed(context.frames.clone());
            trial.on_frames(format!("{}, the middle", context.dataset), frames)
        },
    )];
    if let Some(diode) = &context.diode {
        let preset = ProtocolPreset::named("diode-masked")?;
        conditions.push(Condition::new(compared, "diode", "DIODE", move |trial| {
            trial
                .on_frames("diode val".into(), diode.clone())
                .protocol(&preset)
        }));
    }
    Ok(ConditionGroup {
        title: "Other cameras",
        row_header: "camera",
        metrics: &[Metric::Rel],
        conditions,
    })
}

fn sharp<'a>(compared: &Rc<ComparedSystems<'a>>) -> Condition<'a> {
    let context = compared.context;
    let condition = Condition::new(compared, "sharp", "", move |trial| {
        trial
            .resized(resolution::protocol(context), "of the experiment")
            .points(Pattern::Exactly(resolution::POINTS))
    });
    condition.sharp()
}
