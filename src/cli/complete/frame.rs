//! One frame: an image and its points to depth, and what belongs to it.

use super::Complete;
use super::outputs::Format;
use crate::data::{DepthMap, Sparse};
use crate::device::device;
use crate::error::{Error, Result};
use crate::fit::{Fit, FitMethod};
use crate::predict::{Classic, Completer, Method, check_sizes, complete_classic};
use image::RgbImage;
use std::time::{Duration, Instant};

/// The score above which a point is listed (Iglewicz and Hoaglin 1993).
const OUTLYING: f64 = 3.5;

/// What completes one frame after the other.
pub(super) struct Engine<'a> {
    args: &'a Complete,
    way: Way,
    /// Whether anybody hears how well the points agree.
    explains: bool,
}

enum Way {
    Trained(Box<Completer>),
    Untrained(Classic),
}

/// A completed frame.
pub(super) struct Completed {
    pub(super) depth: DepthMap,
    pub(super) fitted: Option<Fitted>,
}

impl<'a> Engine<'a> {
    /// Ready to work; `told` says whether what is said of each frame is printed.
    pub(super) fn new(args: &'a Complete, told: bool) -> Result<Self> {
        let way = match args.method {
            Method::Classic(_) if args.needs_fit() => {
                return Err(Error::config(
                    "`--size`, `--sigma`, `--uncertainty`, `--max-sigma`, `--outliers` and `--temporal` \
                     need method `lsdc`",
                ));
            }
            Method::Classic(method) => Way::Untrained(method),
            Method::Lsdc => {
                let device = device(&args.model.device)?;
                let completer = Completer::open(args.model.weights.as_deref(), &device)?;
                let mut settings = *completer.fit_config();
                args.fit.apply(&mut settings);
                Way::Trained(Box::new(completer.with_fit(settings)))
            }
        };
        let in_files = args
            .formats
            .iter()
            .flatten()
            .any(|format| *format == Format::Json);
        Ok(Self {
            args,
            way,
            explains: told || in_files || args.outliers,
        })
    }

    /// Completes a frame, near the weights of the one before, if they are given.
    pub(super) fn complete(
        &self,
        rgb: &RgbImage,
        points: &Sparse,
        before: Option<&[f64]>,
    ) -> Result<Completed> {
        let sparse = &points.depth;
        check_sizes(rgb, sparse)?;
        let (depth, fitted) = match &self.way {
            Way::Trained(completer) => {
                let next = before.map(|weights| completer.after(weights)).transpose()?;
                let completer = next.as_ref().unwrap_or(completer);
                let (depth, fitted) = self.fitted(completer, rgb, points)?;
                (depth, Some(fitted))
            }
            Way::Untrained(method) => (complete_classic(*method, rgb, sparse)?, None),
        };
        Ok(Completed {
            depth: self.args.preserve_input.apply(&depth, sparse)?,
            fitted,
        })
    }

    fn fitted(
        &self,
        completer: &Completer,
        rgb: &RgbImage,
        points: &Sparse,
    ) -> Result<(DepthMap, Fitted)> {
        let sparse = &points.depth;
        let whole;
        let completer = if self.args.full {
            let input = [sparse.height(), sparse.width()];
            whole = completer.clone().with_input(input);
            &whole
        } else {
            completer
        };
        let started = Instant::now();
        let bases = completer.bases(rgb)?;
        let network = started.elapsed();
        let started = Instant::now();
        let fit = completer.fit(&bases, sparse, points.sigma.as_ref())?;
        let fitting = started.elapsed();
        let started = Instant::now();
        let depth = completer.dense(&bases, &fit, sparse, self.args.size)?;
        let dense = started.elapsed();
        let wanted = self.args.uncertainty || self.args.max_sigma.is_some();
        let deviations = wanted.then(|| completer.deviation(&bases, sparse, &fit, &depth));
        let fitted = Fitted {
            method: completer.fit_config().method,
            leverages: self
                .explains
                .then(|| completer.leverages(&bases, sparse, &fit)),
            deviations: deviations.transpose()?,
            fit,
            network,
            fitting,
            dense,
        };
        Ok((depth, fitted))
    }
}

impl Complete {
    /// Whether something is asked for that only a fit has.
    fn needs_fit(&self) -> bool {
        self.size.is_some()
            || self.sigma.is_some()
            || self.uncertainty
            || self.max_sigma.is_some()
            || self.outliers
            || self.temporal
    }
}

/// A fit with what is said and written of it.
pub(super) struct Fitted {
    pub(super) method: FitMethod,
    pub(super) fit: Fit,
    leverages: Option<Vec<f64>>,
    pub(super) deviations: Option<DepthMap>,
    pub(super) network: Duration,
    pub(super) fitting: Duration,
    pub(super) dense: Duration,
}

impl Fitted {
    /// What is left of each depth if the others alone are asked.
    pub(super) fn left_out(&self) -> Option<Vec<f64>> {
        Some(self.fit.left_out(self.leverages.as_ref()?))
    }

    /// The numbers and scores of the points that do not agree with the others.
    pub(super) fn outlying(&self) -> Option<Vec<(usize, f64)>> {
        let scores = self.fit.scores(self.leverages.as_ref()?);
        let scores = scores.into_iter().enumerate();
        Some(scores.filter(|(_, score)| score.abs() > OUTLYING).collect())
    }

    /// These points as CSV, the worst first.
    pub(super) fn outliers(&self, sparse: &DepthMap) -> String {
        let left_out = self.left_out().unwrap_or_default();
        let points: Vec<_> = sparse.points().collect();
        let mut outlying = self.outlying().unwrap_or_default();
        outlying.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        let lines = outlying.into_iter().map(|(i, score)| {
            let others = f64::from(points[i].depth) - left_out[i];
            let (x, y, depth) = (points[i].x, points[i].y, points[i].depth);
            let weight = self.fit.point_weights[i];
            format!("{x},{y},{depth},{others:.4},{score:.2},{weight:.4}\n")
        });
        let header = "x,y,depth,depth_by_the_others,score,weight\n";
        lines.fold(header.to_owned(), |text, line| text + &line)
    }
}
