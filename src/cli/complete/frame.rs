//! One frame: an image and its points to depth, and what belongs to it.

use super::Complete;
use crate::cli::ui;
use crate::data::{DepthMap, Sparse};
use crate::device::device;
use crate::error::{Error, Result};
use crate::fit::{Fit, root_mean_square};
use crate::predict::{Classic, Completer, Method, check_sizes, complete_classic};
use image::RgbImage;
use std::time::{Duration, Instant};

/// The score above which a point is listed (Iglewicz and Hoaglin 1993).
const OUTLYING: f64 = 3.5;

/// What completes one frame after the other.
pub(super) struct Engine<'a> {
    args: &'a Complete,
    way: Way,
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
    pub(super) fn new(args: &'a Complete) -> Result<Self> {
        let way = match args.method {
            Method::Classic(_) if args.needs_fit() => {
                return Err(Error::config(
                    "`--size`, `--sigma`, `--uncertainty` and `--outliers` need method `lsdc`",
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
        Ok(Self { args, way })
    }

    pub(super) fn complete(&self, rgb: &RgbImage, points: &Sparse) -> Result<Completed> {
        let sparse = &points.depth;
        check_sizes(rgb, sparse)?;
        let (depth, fitted) = match &self.way {
            Way::Trained(completer) => {
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
        let deviations = self
            .args
            .uncertainty
            .then(|| completer.deviation(&bases, sparse, &fit, &depth));
        let fitted = Fitted {
            leverages: completer.leverages(&bases, sparse, &fit),
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
        self.size.is_some() || self.sigma.is_some() || self.uncertainty || self.outliers
    }
}

/// A fit with what is printed and written of it.
pub(super) struct Fitted {
    pub(super) fit: Fit,
    leverages: Vec<f64>,
    pub(super) deviations: Option<DepthMap>,
    network: Duration,
    fitting: Duration,
    dense: Duration,
}

impl Fitted {
    pub(super) fn print(&self) {
        let fit = &self.fit;
        ui::print(&format!(
            "residual  {:.4} m rms at the points, {:.4} m at points left out, rank {} of {}",
            fit.rms(),
            root_mean_square(&fit.left_out(&self.leverages)),
            fit.rank,
            fit.weights.len()
        ));
        ui::print(&format!(
            "time      network {}, fit {}, dense {}",
            ui::millis(self.network),
            ui::millis(self.fitting),
            ui::millis(self.dense)
        ));
    }

    /// The points that do not agree with the others, as CSV, the worst first.
    pub(super) fn outliers(&self, sparse: &DepthMap) -> String {
        let (fit, leverages) = (&self.fit, &self.leverages);
        let left_out = fit.left_out(leverages);
        let scores = fit.scores(leverages);
        let mut lines: Vec<(f64, String)> = Vec::new();
        for (i, point) in sparse.points().enumerate() {
            if scores[i].abs() > OUTLYING {
                let others = f64::from(point.depth) - left_out[i];
                let (x, y, depth, score) = (point.x, point.y, point.depth, scores[i]);
                let weight = fit.point_weights[i];
                let line = format!("{x},{y},{depth},{others:.4},{score:.2},{weight:.4}\n");
                lines.push((-score.abs(), line));
            }
        }
        lines.sort_by(|a, b| a.0.total_cmp(&b.0));
        let header = "x,y,depth,depth_by_the_others,score,weight\n";
        lines
            .into_iter()
            .fold(header.to_owned(), |text, (_, line)| text + &line)
    }
}
