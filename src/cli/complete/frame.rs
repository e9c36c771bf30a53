//! One frame: an image and its points to depth, and what belongs to it.

use super::loaded::Loaded as Frame;
use crate::cli::args::{Complete, Format, Model};
use crate::cli::network::{open_completer, open_system};
use image::RgbImage;
use lsdc_core::fit::{FitConfig, FitMethod, PriorKind};
use lsdc_core::{Completer, Completion, Outlier, Scene};
use lsdc_eval::data::{self, DepthMap, Sparse, Unit};
use lsdc_eval::predict::{Classic, Completes, Method, complete_classic, guided_scene};
use lsdc_files::error::{Error, Result};
use serde::Serialize;
use std::fmt::Write as _;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What completes one frame after the other.
pub(super) struct Engine<'a> {
    args: &'a Complete,
    method: Loaded,
    /// Whether diagnostics are reported.
    explains: bool,
    counts_outliers: bool,
}

enum Loaded {
    Trained(Box<Completer>),
    Whole(Whole),
}

/// What looks at image and points together.
#[derive(Clone)]
pub(super) enum Whole {
    /// A method without training.
    Untrained(Classic),
    /// A system that the paper compares itself with.
    System(Arc<dyn Completes>),
}

impl Whole {
    fn complete(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
        match self {
            Self::Untrained(method) => complete_classic(*method, rgb, sparse),
            Self::System(system) => system.depth(rgb, sparse),
        }
    }
}

/// A frame whose image the network has seen.
pub(super) enum Prepared {
    Trained(Scene),
    Whole(Whole),
}

/// A frame that is fitted to its points.
pub(super) enum Fitted {
    Trained(Completion),
    Whole(Whole),
}

/// A completed frame.
pub(super) struct Completed {
    pub(super) depth: DepthMap,
    /// How many of its pixels are clamped to ten times the range of the points.
    pub(super) clamped: usize,
    /// With `--max-sigma`.
    pub(super) left_empty: Option<LeftEmpty>,
    /// The map before, if pixels were left empty.
    filled: Option<DepthMap>,
    pub(super) diagnostics: Option<Diagnostics>,
}

impl Completed {
    /// The map with the pixels that are left empty. Flying pixels are looked for in it, as an empty pixel is no edge.
    pub(super) fn filled(&self) -> &DepthMap {
        self.filled.as_ref().unwrap_or(&self.depth)
    }
}

/// Pixels without a depth, as their standard deviation is too large.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct LeftEmpty {
    /// How many.
    pub(super) pixels: usize,
    /// The largest standard deviation of a depth.
    pub(super) max_sigma: f32,
}

/// What a fit says of itself.
pub(super) struct Diagnostics {
    pub(super) completion: Completion,
    /// Root mean square of the leave-one-out errors.
    pub(super) leave_one_out: Option<f64>,
    /// The points that do not agree with the others, the worst first.
    pub(super) outliers: Option<Vec<Outlier>>,
    pub(super) deviations: Option<DepthMap>,
    /// Whether the fit limits the influence of outliers.
    pub(super) robust: bool,
    /// The time of reading out the dense depth.
    pub(super) dense: Duration,
}

impl<'a> Engine<'a> {
    /// Ready to work; `told` says whether diagnostics are printed.
    pub(super) fn new(args: &'a Complete, told: bool) -> Result<Self> {
        let alien = args.options_of_the_fit();
        let method = match args.method {
            Method::Classic(_) | Method::System(_) if !alien.is_empty() => {
                let options = alien.join(", ");
                return Err(Error::config(format!(
                    "{options}: options that need method `lsdc`"
                )));
            }
            Method::Classic(method) => Loaded::Whole(Whole::Untrained(method)),
            Method::System(kind) => {
                let Model { weights, device } = &args.model;
                let system = open_system(kind, weights.as_deref(), device)?;
                Loaded::Whole(Whole::System(Arc::new(system)))
            }
            Method::Lsdc => {
                let Model { weights, device } = &args.model;
                let completer = open_completer(weights.as_deref(), device)?;
                let mut settings = *completer.fit_config();
                args.fit.apply(&mut settings);
                if args.temporal {
                    check_temporal(&settings)?;
                }
                if args.guide.is_some() && settings.method == FitMethod::Field {
                    return Err(Error::config(
                        "`--guide` would change nothing: a field alone has no basis functions",
                    )
                    .hint("leave it out, or fit with `--fit joint` or `--fit lse`"));
                }
                Loaded::Trained(Box::new(completer.with_fit(settings)))
            }
        };
        let in_files = args
            .formats
            .iter()
            .flatten()
            .any(|format| *format == Format::Json);
        Ok(Self {
            args,
            method,
            explains: told || in_files || args.outliers,
            counts_outliers: in_files || args.json,
        })
    }

    /// Completes a frame that no other follows.
    pub(super) fn complete(self, frame: &Frame) -> Result<Completed> {
        let prepared = self.prepare(frame)?;
        if let Loaded::Trained(completer) = &self.method {
            completer.release();
        }
        let fitted = prepared.fit(&frame.points, None)?;
        self.finish(&frame.rgb, &frame.points, fitted)
    }

    /// The first part of completing a frame, which depends on its image and guide alone.
    pub(super) fn prepare(&self, frame: &Frame) -> Result<Prepared> {
        let completer = match &self.method {
            Loaded::Trained(completer) => completer,
            Loaded::Whole(method) => return Ok(Prepared::Whole(method.clone())),
        };
        let rgb = &frame.rgb;
        let scene = if self.args.full {
            let (width, height) = (rgb.width() as usize, rgb.height() as usize);
            let completer = completer.with_working_size(height, width)?;
            guided_scene(&completer, rgb, frame.guide.as_ref())
        } else {
            guided_scene(completer, rgb, frame.guide.as_ref())
        };
        scene.map(Prepared::Trained)
    }

    /// The last part, for which no other frame waits.
    pub(super) fn finish(
        &self,
        rgb: &RgbImage,
        points: &Sparse,
        fitted: Fitted,
    ) -> Result<Completed> {
        let (depth, clamped, diagnostics) = match fitted {
            Fitted::Trained(completion) => self.read_out(completion)?,
            Fitted::Whole(method) => (method.complete(rgb, &points.map()?)?, 0, None),
        };
        let size = (rgb.width() as usize, rgb.height() as usize);
        let preserve = self.args.preserve_input;
        let mut depth = preserve.apply(depth, &points.points, size)?;
        let (mut left_empty, mut filled) = (None, None);
        let deviations = diagnostics
            .as_ref()
            .and_then(|found| found.deviations.as_ref());
        if let (Some(max_sigma), Some(deviations)) = (self.args.max_sigma, deviations) {
            let (sure, pixels) = data::without_uncertain(depth.clone(), deviations, max_sigma)?;
            if sure.count() == 0 {
                return Err(none_left(deviations, max_sigma, points.unit));
            }
            left_empty = Some(LeftEmpty { pixels, max_sigma });
            filled = Some(std::mem::replace(&mut depth, sure));
        }
        Ok(Completed {
            depth,
            clamped,
            left_empty,
            filled,
            diagnostics,
        })
    }

    /// Whether the fit limits the influence of outliers.
    fn is_robust(&self) -> bool {
        match &self.method {
            Loaded::Trained(completer) => completer.fit_config().robust.is_some(),
            Loaded::Whole(_) => false,
        }
    }

    fn read_out(&self, completion: Completion) -> Result<(DepthMap, usize, Option<Diagnostics>)> {
        let started = Instant::now();
        let depth = match self.args.size {
            None => completion.depth()?,
            Some(size) => completion.depth_at(size.width, size.height)?,
        };
        let dense = started.elapsed();
        let (low, high) = completion.limits();
        let clamped = depth
            .values()
            .iter()
            .filter(|&&d| d <= low || d >= high)
            .count();
        let robust = self.is_robust();
        // The error to expect is that of the inliers.
        let judges = self.args.outliers
            || self.explains && robust
            || self.counts_outliers && completion.report().used <= JUDGED_UNASKED;
        let wanted = self.args.uncertainty || self.args.max_sigma.is_some();
        let (width, height) = (depth.width(), depth.height());
        let deviations = wanted.then(|| completion.standard_deviation_at(width, height));
        let diagnostics = Diagnostics {
            leave_one_out: (self.explains.then(|| completion.leave_one_out_error())).flatten(),
            outliers: judges.then(|| completion.outliers()).transpose()?,
            deviations: deviations.transpose()?,
            robust,
            completion,
            dense,
        };
        Ok((depth, clamped, Some(diagnostics)))
    }
}

/// That all depths are too uncertain.
fn none_left(deviations: &DepthMap, max_sigma: f32, unit: Unit) -> Error {
    let (least, _) = deviations.range().unwrap_or_default();
    let m = unit.of_depths();
    Error::config(format!(
        "every pixel has a standard deviation above {max_sigma} {m}: the least is {least} {m}"
    ))
    .hint("give a larger --max-sigma, or leave it out")
}

/// More points than this are judged only for `--outliers`: it takes several fits.
const JUDGED_UNASKED: usize = 10_000;

/// Checks that a fit can be drawn towards the weights of the frame before.
fn check_temporal(fit: &FitConfig) -> Result<()> {
    let (method, prior) = (fit.method, fit.prior);
    if method != FitMethod::Field && prior == PriorKind::Learned {
        return Ok(());
    }
    Err(Error::config(format!(
        "`--temporal` would change nothing: it moves the learned prior over weights of basis functions, \
         but the fit is {} with prior {}",
        method.name(),
        prior.name()
    ))
    .hint("leave it out, or fit as the weights say: without --fit field, --prior and --space"))
}

impl Prepared {
    /// The middle part: the weights, near those of the frame before, if they are given. The scene is not fitted again.
    pub(super) fn fit(self, points: &Sparse, near: Option<&[f64]>) -> Result<Fitted> {
        Ok(match (self, near) {
            (Self::Trained(scene), None) => Fitted::Trained(scene.complete_once(&points.points)?),
            (Self::Trained(scene), Some(weights)) => {
                Fitted::Trained(scene.complete_near(&points.points, weights)?)
            }
            (Self::Whole(method), _) => Fitted::Whole(method),
        })
    }
}

impl Fitted {
    pub(super) fn weights(&self) -> Option<&[f64]> {
        match self {
            Self::Trained(completion) => Some(completion.weights()),
            Self::Whole(_) => None,
        }
    }
}

impl Complete {
    /// The options that were given and that only a fit has.
    fn options_of_the_fit(&self) -> Vec<&'static str> {
        let options = [
            ("`--size`", self.size.is_some()),
            ("`--sigma`", self.sigma.is_some()),
            ("`--noise`", self.noise.is_some()),
            ("`--guide`", self.guide.is_some()),
            ("`--uncertainty`", self.uncertainty),
            ("`--max-sigma`", self.max_sigma.is_some()),
            ("`--outliers`", self.outliers),
            ("`--temporal`", self.temporal),
            ("`--full`", self.full),
        ];
        let given = options.into_iter().filter(|(_, given)| *given);
        given
            .map(|(name, _)| name)
            .chain(self.fit.given())
            .collect()
    }
}

impl Diagnostics {
    /// The outliers as CSV, the worst first.
    pub(super) fn outliers_csv(&self, points: &Sparse) -> String {
        let mut text = "u,v,depth,depth_by_the_others,score,probability,weight\n".to_owned();
        for outlier in self.outliers.iter().flatten() {
            let Some(point) = points.points.as_slice().get(outlier.index) else {
                continue;
            };
            let others = f64::from(point.depth) - outlier.error;
            let (score, probability, weight) = (outlier.score, outlier.probability, outlier.weight);
            // Writing to a string does not fail.
            let _ = writeln!(
                text,
                "{},{},{},{others:.4},{score:.2},{probability:.4},{weight:.4}",
                point.u, point.v, point.depth
            );
        }
        text
    }
}
