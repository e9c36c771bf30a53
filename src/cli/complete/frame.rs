//! One frame: an image and its points to depth, and what belongs to it.

use crate::cli::args::{Complete, Format};
use crate::data::{DepthMap, Sparse};
use crate::device::device;
use crate::error::{Error, Result};
use crate::fit::{Fit, FitMethod};
use crate::predict::{Classic, Completer, ImageBases, Method, check_sizes, complete_classic};
use image::RgbImage;
use std::borrow::Cow;
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

/// What the network says of an image.
pub(super) struct View<'a> {
    completer: Cow<'a, Completer>,
    bases: ImageBases,
    network: Duration,
}

/// A frame of which the network has seen the image.
pub(super) enum Seen<'a> {
    Trained(Box<View<'a>>),
    /// An untrained method looks at image and points together.
    Untrained(Classic),
}

/// A frame whose weights are found.
pub(super) enum Weighed<'a> {
    Trained {
        view: Box<View<'a>>,
        fit: Box<Fit>,
        fitting: Duration,
    },
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

    /// Completes a frame.
    pub(super) fn complete(&self, rgb: &RgbImage, points: &Sparse) -> Result<Completed> {
        let weighed = self.see(rgb, points)?.weigh(points, None)?;
        self.dense(rgb, points, weighed)
    }

    /// The first part of completing a frame, which depends on its image alone.
    pub(super) fn see(&self, rgb: &RgbImage, points: &Sparse) -> Result<Seen<'_>> {
        check_sizes(rgb, &points.depth)?;
        let mut completer = match &self.way {
            Way::Trained(completer) => Cow::Borrowed(completer.as_ref()),
            Way::Untrained(method) => return Ok(Seen::Untrained(*method)),
        };
        if self.args.full {
            let input = [points.depth.height(), points.depth.width()];
            completer = Cow::Owned(completer.into_owned().with_input(input));
        }
        let started = Instant::now();
        let bases = completer.bases(rgb)?;
        Ok(Seen::Trained(Box::new(View {
            completer,
            bases,
            network: started.elapsed(),
        })))
    }

    /// The last part, for which no other frame waits.
    pub(super) fn dense(
        &self,
        rgb: &RgbImage,
        points: &Sparse,
        weighed: Weighed<'_>,
    ) -> Result<Completed> {
        let sparse = &points.depth;
        let (depth, fitted) = match weighed {
            Weighed::Trained { view, fit, fitting } => {
                let (depth, fitted) = self.fitted(&view, *fit, fitting, sparse)?;
                (depth, Some(fitted))
            }
            Weighed::Untrained(method) => (complete_classic(method, rgb, sparse)?, None),
        };
        Ok(Completed {
            depth: self.args.preserve_input.apply(depth, sparse)?,
            fitted,
        })
    }

    fn fitted(
        &self,
        view: &View<'_>,
        fit: Fit,
        fitting: Duration,
        sparse: &DepthMap,
    ) -> Result<(DepthMap, Fitted)> {
        let View {
            completer,
            bases,
            network,
        } = view;
        let started = Instant::now();
        let depth = completer.dense(bases, &fit, sparse, self.args.size)?;
        let dense = started.elapsed();
        let wanted = self.args.uncertainty || self.args.max_sigma.is_some();
        let deviations = wanted.then(|| completer.deviation(bases, sparse, &fit, &depth));
        let fitted = Fitted {
            method: completer.fit_config().method,
            leverages: self
                .explains
                .then(|| completer.leverages(bases, sparse, &fit)),
            deviations: deviations.transpose()?,
            fit,
            network: *network,
            fitting,
            dense,
        };
        Ok((depth, fitted))
    }
}

impl<'a> Seen<'a> {
    /// The middle part: the weights, near those of the frame before, if they are given.
    pub(super) fn weigh(self, points: &Sparse, before: Option<&[f64]>) -> Result<Weighed<'a>> {
        let mut view = match self {
            Self::Trained(view) => view,
            Self::Untrained(method) => return Ok(Weighed::Untrained(method)),
        };
        if let Some(weights) = before {
            view.completer = Cow::Owned(view.completer.after(weights)?);
        }
        let started = Instant::now();
        let sigma = points.sigma.as_ref();
        let fit = view.completer.fit(&view.bases, &points.depth, sigma)?;
        Ok(Weighed::Trained {
            view,
            fit: Box::new(fit),
            fitting: started.elapsed(),
        })
    }
}

impl Weighed<'_> {
    pub(super) fn weights(&self) -> Option<&[f64]> {
        match self {
            Self::Trained { fit, .. } => Some(&fit.weights),
            Self::Untrained(_) => None,
        }
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
