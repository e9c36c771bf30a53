//! Multi-view fits: measured points of neighbouring images with known poses are added to those of an image.
//!
//! Every carried point is compared with the completion by the image's own points, using its standard deviations. For every
//! view, a relative standard deviation is estimated that represents the error of its pose, and views that contradict the image
//! are rejected. A point that contradicts the completion is kept if points of other views support it. Points behind the surface
//! spanned by all others are occluded. Finally, the leave-one-out errors of the image's own points decide whether the carried
//! points help.

mod agreement;
mod carry;
mod neighbours;
mod occlusion;
mod report;
mod support;
mod thin;

use crate::camera::Camera;
use crate::cloud::pixel;
use crate::comparison::{Comparison, tiles};
use crate::completion::Completion;
use crate::error::{Error, FitError, Result, SettingsError};
use crate::image::check_size;
use crate::observations::{Observation, Observations};
use crate::scene::Scene;
use carry::Carried;
pub use neighbours::neighbours;
pub use report::{ViewOutcome, ViewReport, ViewsOutcome, ViewsReport};
use std::sync::Arc;

/// A camera with its pose in the world, for any camera model.
///
/// Implemented by [`Camera`]; implement it for other cameras, for example if images are stored rotated.
pub trait Projection: Send + Sync {
    /// The pixel (column, row) and depth of a point of the world; `None` outside the field of view.
    fn project(&self, point: [f64; 3]) -> Option<([f64; 2], f64)>;

    /// The point of the world at a pixel (column, row) and depth; `None` outside the field of view. At depth 0, it is the
    /// centre of the camera.
    fn unproject(&self, pixel: [f64; 2], depth: f64) -> Option<[f64; 3]>;

    /// Checks the parameters of the camera and its pose.
    ///
    /// # Errors
    /// As for [`Camera::check`].
    fn check(&self) -> Result<(), SettingsError>;
}

impl Projection for Camera {
    fn project(&self, point: [f64; 3]) -> Option<([f64; 2], f64)> {
        Self::project(self, point)
    }

    fn unproject(&self, pixel: [f64; 2], depth: f64) -> Option<[f64; 3]> {
        Self::unproject(self, pixel, depth)
    }

    fn check(&self) -> Result<(), SettingsError> {
        Self::check(self)
    }
}

/// The measured points of one image of a sequence, and its camera with pose. Poses and depths have the same unit.
///
/// Cheap to clone.
#[derive(Clone)]
pub struct PosedView {
    camera: Arc<dyn Projection>,
    width: usize,
    height: usize,
    /// The direction of the optical axis, a unit vector.
    axis: Option<[f64; 3]>,
    points: Arc<Points>,
}

#[derive(Debug, Default)]
struct Points {
    observations: Observations,
    ids: Option<Vec<u64>>,
}

impl std::fmt::Debug for PosedView {
    /// Omits the values, of which there are thousands.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PosedView")
            .field("width", &self.width)
            .field("height", &self.height)
            .field("points", &self.points.observations.len())
            .finish_non_exhaustive()
    }
}

impl PosedView {
    /// A view of an image of `width` x `height` pixels.
    ///
    /// # Errors
    /// An implausible size, or a camera with [invalid parameters](Camera::check).
    pub fn new(
        camera: impl Projection + 'static,
        width: usize,
        height: usize,
        observations: Observations,
    ) -> Result<Self> {
        check_size(width, height)?;
        camera.check()?;
        Ok(Self {
            axis: neighbours::axis(&camera, (width, height)),
            camera: Arc::new(camera),
            width,
            height,
            points: Arc::new(Points {
                observations,
                ids: None,
            }),
        })
    }

    /// The same view with an identifier for every observation: observations of several views with the same identifier are
    /// measurements of the same point, as in a structure-from-motion model, and are counted once.
    ///
    /// # Errors
    /// The number of identifiers does not match the observations.
    pub fn with_ids(self, ids: Vec<u64>) -> Result<Self> {
        let observations = self.points.observations.clone();
        if ids.len() != observations.len() {
            let what = format!("{} ids of {} observations", ids.len(), observations.len());
            return Err(FitError::Shape(what).into());
        }
        let ids = Some(ids);
        Ok(Self {
            points: Arc::new(Points { observations, ids }),
            ..self
        })
    }

    /// The measured points of this view.
    pub fn observations(&self) -> &Observations {
        &self.points.observations
    }

    /// Returns the points with a depth inside the image.
    fn points_inside(&self) -> Vec<Observation> {
        let points = self.observations().iter().copied();
        let inside = |point: &Observation| {
            let place = pixel([point.u, point.v], self.size());
            place.is_some() && point.depth > 0.0 && point.depth.is_finite()
        };
        points.filter(inside).collect()
    }

    fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    fn id(&self, index: usize) -> Option<u64> {
        Some(self.points.ids.as_ref()?[index])
    }
}

/// The choice of neighbours, and the limit of carried points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewSettings {
    /// Largest number of neighbours of an image.
    pub count: usize,
    /// Whether only earlier views are neighbours, as in online use.
    pub only_past: bool,
    /// Largest number of points carried over from all neighbours.
    pub max_points: usize,
}

impl Default for ViewSettings {
    /// 8 neighbours before and after, 2000 points.
    fn default() -> Self {
        Self {
            count: 8,
            only_past: false,
            max_points: 2000,
        }
    }
}

/// Least gain, in standard errors, of the prediction of the image's own points for which carried points are used. Chosen on
/// procedural rooms: with 0, wrong poses and 50 points raised the RMSE by 3 %.
const BETTER: f64 = 2.0;

impl Scene {
    /// Fits the basis functions of the image to its own observations together with the points of other views, at most
    /// `max_points` of them. `others` should be [`neighbours`], the closest first. Also returns a report on the use of each
    /// view and its points.
    ///
    /// A carried point keeps its own standard deviation, if it is known. Only measured points are carried, each once, never
    /// completed depths, so that no measurement counts twice. There are two or three fits: first to the own points, then to
    /// all. Without other views, the result is that of [`Self::complete`].
    ///
    /// # Errors
    /// The size of a view differs from that of the image, and as for [`Self::complete`].
    ///
    /// ```
    /// # #[cfg(feature = "weights")]
    /// # fn main() -> lsdc_core::Result<()> {
    /// # use lsdc_core::{Camera, Channels, Completer, Image, Observations, PosedView, ViewSettings, Weights};
    /// # let completer = Completer::new(&Weights::builtin_small())?;
    /// # let grey = vec![128_u8; 3 * 64 * 48];
    /// # let scene = completer.scene(&Image::new(64, 48, Channels::Rgb, &grey)?)?;
    /// // Two cameras side by side in front of a corrugated wall, z = 2 + 0.2 sin(6 x).
    /// let camera = Camera::pinhole([60.0, 60.0], [31.5, 23.5]);
    /// let aside = camera.clone().with_pose([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [-0.2, 0.0, 0.0]);
    /// let depth = |x: f64, u: f64| (0..50).fold(2.0, |z, _| 2.0 + 0.2 * (6.0 * (x + (u - 31.5) / 60.0 * z)).sin());
    /// let wall = |x: f64, step: usize| -> Observations {
    ///     let places = (0..3072).step_by(step).map(|i| ((i % 64) as f64, (i / 64) as f64));
    ///     places.map(|(u, v)| lsdc_core::Observation { u, v, depth: depth(x, u) as f32, sigma: None }).collect()
    /// };
    /// let own = PosedView::new(camera, 64, 48, wall(0.0, 61))?;
    /// let other = PosedView::new(aside, 64, 48, wall(0.2, 17))?;
    /// let (completion, report) = scene.complete_with_views(&own, &[&other], &ViewSettings::default())?;
    /// assert!(report.carried() > 100);
    /// assert!((f64::from(completion.depth()?.at(30, 20)) - depth(0.0, 30.0)).abs() < 0.05);
    /// # Ok(())
    /// # }
    /// # #[cfg(not(feature = "weights"))]
    /// # fn main() {}
    /// ```
    pub fn complete_with_views(
        &self,
        own: &PosedView,
        others: &[&PosedView],
        settings: &ViewSettings,
    ) -> Result<(Completion, ViewsReport)> {
        let (height, width) = self.size();
        if own.size() != (width, height) {
            let what = format!(
                "a view of {}x{} pixels of an image of {width}x{height}",
                own.width, own.height
            );
            return Err(FitError::Shape(what).into());
        }
        let alone = self.complete(own.observations())?;
        let mut report = ViewsReport::new(others);
        let mut carried = carry::carry(own, others, &mut report.views);
        if carried.is_empty() {
            return Ok((alone, report));
        }
        let Some(deviations) = known(alone.standard_deviation())? else {
            report.outcome = ViewsOutcome::TooFewPoints;
            return Ok((alone, report));
        };
        agreement::check(&alone, &deviations, &mut carried, &mut report.views)?;
        carry::remove_doubled(others, &mut carried, &mut report.views);
        support::check(own, &mut carried, &mut report.views);
        thin::thin(own, settings.max_points, &mut carried, &mut report.views);
        occlusion::remove(self, own, &mut carried, &mut report.views)?;
        if carried.is_empty() {
            return Ok((alone, report));
        }
        let mut together = self.complete(&joined(own, &carried))?;
        let mut judgement = self.judge(own, &alone, &together);
        // No gain indicates motion between the image's own points: remove the points that contradict the completion.
        if carried.iter().any(|point| point.is_doubtful) && !judgement.is_better() {
            support::remove_doubtful(&mut carried, &mut report.views);
            if carried.is_empty() {
                return Ok((alone, report));
            }
            together = self.complete(&joined(own, &carried))?;
            judgement = self.judge(own, &alone, &together);
        }
        for point in &carried {
            report.views[point.view].carried += 1;
        }
        report.errors = judgement.errors;
        if !judgement.is_better() {
            report.outcome = ViewsOutcome::Rejected;
            return Ok((alone, report));
        }
        report.outcome = ViewsOutcome::Used;
        Ok((together, report))
    }

    /// Compares how well the image's own points are predicted with and without the carried points.
    fn judge(&self, own: &PosedView, alone: &Completion, together: &Completion) -> Judgement {
        let points = own.observations().as_slice();
        let relative = |errors: Vec<f64>| -> Vec<f64> {
            let pairs = errors.into_iter().zip(points);
            pairs
                .map(|(error, point)| (error / f64::from(point.depth)).abs())
                .collect()
        };
        let [before, after] = [alone, together].map(|fit| relative(fit.leave_one_out()));
        let tiles = tiles(points, self.size());
        let sum_of_squares = |errors: &[f64]| errors.iter().map(|error| error * error).sum::<f64>();
        let are_large_ones_larger = sum_of_squares(&after) > sum_of_squares(&before);
        let found = Comparison::new(&tiles, &before, &[after]).best();
        Judgement {
            errors: found.map(|found| [found.error, found.error_there]),
            standard_errors: found.map_or(0.0, |found| found.standard_errors),
            are_large_ones_larger,
        }
    }
}

/// The change of the leave-one-out errors of the image's own points due to the carried points.
struct Judgement {
    /// Means relative to the depths, without and with carried points; `None` without enough points.
    errors: Option<[f64; 2]>,
    /// The gain divided by its standard error.
    standard_errors: f64,
    /// Whether the root mean square increases, as with a few points behind a surface that no longer exists.
    are_large_ones_larger: bool,
}

impl Judgement {
    fn is_better(&self) -> bool {
        self.standard_errors >= BETTER && !self.are_large_ones_larger
    }
}

/// Returns the result of points; `None` if there are too few of them.
fn known<T>(found: Result<T>) -> Result<Option<T>> {
    match found {
        Ok(found) => Ok(Some(found)),
        Err(Error::Fit(FitError::TooFewPoints(_))) => Ok(None),
        Err(other) => Err(other),
    }
}

/// Returns the observations of the image, followed by the carried ones.
///
/// Errors of poses are not added to their standard deviations: with poses off by up to 2 cm and 0.6°, this changed the RMSE by
/// less than 1 %, and doubled the time of the fit.
fn joined(own: &PosedView, carried: &[Carried]) -> Observations {
    let carried = carried.iter().map(|point| point.observation);
    own.observations().iter().copied().chain(carried).collect()
}

#[cfg(test)]
#[cfg(feature = "weights")]
mod tests;
