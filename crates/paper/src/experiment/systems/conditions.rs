//! The conditions under which all are measured.

use super::entrants::Field;
use super::narrow::Narrow;
use super::side::Side;
use crate::experiment::resolution;
use crate::experiment::scale::Scaled;
use lsdc_eval::metrics::Metric;
use lsdc_eval::sampling::{Noise, Pattern, Preset};
use lsdc_files::error::Result;
use std::rc::Rc;
use std::sync::Arc;

/// Numbers of points beside those that the systems are trained with.
pub(super) const COUNTS: [usize; 5] = [5, 50, 200, 1000, 5000];
/// The place among them of the one that is shown.
const SHOWN: usize = 1;
/// Points that are not at random.
const PATTERNS: [Pattern; 4] = [
    Pattern::Grid(12),
    Pattern::Lines(16),
    Pattern::Corners(500),
    Pattern::Half(500),
];
const FACTORS: [f32; 2] = [0.1, 10.0];
/// What is wrong with points, in words.
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

/// Conditions that differ in one thing.
pub(super) struct Group<'a> {
    pub(super) title: &'static str,
    /// What the thing is.
    pub(super) rows_are: &'static str,
    /// What is shown of them.
    pub(super) metrics: &'static [Metric],
    pub(super) sides: Vec<Side<'a>>,
}

pub(super) struct Conditions<'a> {
    /// That of the training.
    pub(super) trained: Side<'a>,
    pub(super) counts: Group<'a>,
    pub(super) others: [Group<'a>; 4],
    /// Depth at three times the resolution of the image.
    pub(super) sharp: Side<'a>,
}

impl<'a> Conditions<'a> {
    pub(super) fn new(field: &Rc<Field<'a>>) -> Result<Self> {
        Ok(Self {
            trained: Side::new(field, "500", "as trained", |trial| trial),
            counts: counts(field),
            others: [
                patterns(field),
                scales(field),
                noises(field),
                cameras(field)?,
            ],
            sharp: sharp(field),
        })
    }

    /// All of them, in the order in which they are measured.
    pub(super) fn sides(&self) -> impl Iterator<Item = &Side<'a>> {
        let groups = std::iter::once(&self.counts).chain(&self.others);
        std::iter::once(&self.trained)
            .chain(groups.flat_map(|group| &group.sides))
            .chain(std::iter::once(&self.sharp))
    }

    /// Few points.
    pub(super) fn few(&self) -> &Side<'a> {
        &self.counts.sides[SHOWN]
    }
}

fn counts<'a>(field: &Rc<Field<'a>>) -> Group<'a> {
    let side = |count: usize| {
        let name = count.to_string();
        Side::new(field, &name, &name, move |trial| {
            trial.points(Pattern::Exactly(count))
        })
    };
    Group {
        title: "Other numbers of points",
        rows_are: "points",
        metrics: &[Metric::Rmse, Metric::Rel],
        sides: COUNTS.map(side).into(),
    }
}

fn patterns<'a>(field: &Rc<Field<'a>>) -> Group<'a> {
    let side = |pattern: Pattern| {
        let name = String::from(pattern.clone()).replace(':', "-");
        Side::new(field, &name, pattern.to_string(), move |trial| {
            trial.points(pattern.clone())
        })
    };
    Group {
        title: "Other patterns",
        rows_are: "points",
        metrics: &[Metric::Rmse],
        sides: PATTERNS.map(side).into(),
    }
}

fn scales<'a>(field: &Rc<Field<'a>>) -> Group<'a> {
    let context = field.context;
    let side = |factor: f32| {
        let name = format!("x{factor}");
        Side::new(field, &name, factor.to_string(), move |trial| {
            let frames = Scaled {
                frames: context.frames.clone(),
                factor,
            };
            trial.on(format!("{} x {factor}", context.dataset), Arc::new(frames))
        })
    };
    Group {
        title: "Scaled depths",
        rows_are: "factor",
        metrics: &[Metric::Rel],
        sides: FACTORS.map(side).into(),
    }
}

fn noises<'a>(field: &Rc<Field<'a>>) -> Group<'a> {
    let side = |(label, name, noise): (&str, &str, Noise)| {
        Side::new(field, name, label, move |trial| trial.noise(Some(noise)))
    };
    Group {
        title: "Wrong points",
        rows_are: "what is wrong",
        metrics: &[Metric::Rmse],
        sides: NOISES.map(side).into(),
    }
}

fn cameras<'a>(field: &Rc<Field<'a>>) -> Result<Group<'a>> {
    let context = field.context;
    let mut sides = vec![Side::new(field, "narrow", "half the view", move |trial| {
        let frames = Narrow(context.frames.clone());
        trial.on(format!("{}, the middle", context.dataset), Arc::new(frames))
    })];
    if let Some(diode) = &context.diode {
        let preset = Preset::named("diode-masked")?;
        sides.push(Side::new(field, "diode", "DIODE", move |trial| {
            trial
                .on("diode val".into(), diode.clone())
                .protocol(&preset)
        }));
    }
    Ok(Group {
        title: "Other cameras",
        rows_are: "camera",
        metrics: &[Metric::Rel],
        sides,
    })
}

fn sharp<'a>(field: &Rc<Field<'a>>) -> Side<'a> {
    let context = field.context;
    let side = Side::new(field, "sharp", "", move |trial| {
        trial
            .resized(resolution::protocol(context), "of the experiment")
            .points(Pattern::Exactly(resolution::POINTS))
    });
    side.sharp()
}
