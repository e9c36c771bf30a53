//! A fit over views: the measured points of neighbouring images with known poses join those of an image.
//!
//! Every carried point is compared with the completion by the image's own points and its standard deviations. For every view, a
//! relative standard deviation is estimated that stands for the error of its pose, and views that contradict the image are
//! left out. A point that the completion contradicts stays if points of other views support it. Points behind the surface
//! that all others span are occluded. At the end the leave-one-out errors of the image's own points decide whether the carried
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

/// A camera at its place in the world, whatever its model.
///
/// [`Camera`] implements it; others do if their images are stored turned, for example.
pub trait Projection: Send + Sync {
    /// The pixel (column, row) and depth of a point of the world; `None` where the camera does not see.
    fn project(&self, point: [f64; 3]) -> Option<([f64; 2], f64)>;

    /// The point of the world at a pixel (column, row) and depth; `None` outside the field of view. At depth 0 it is the
    /// centre of the camera.
    fn unproject(&self, pixel: [f64; 2], depth: f64) -> Option<[f64; 3]>;

    /// Checks the numbers of the camera and its pose.
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

/// The measured points of one image of a sequence, and the camera at its place. Poses and depths have the same unit.
///
/// Cheap to clone.
#[derive(Clone)]
pub struct PosedView {
    camera: Arc<dyn Projection>,
    width: usize,
    height: usize,
    /// The direction of the optical axis, of length 1.
    axis: Option<[f64; 3]>,
    points: Arc<Points>,
}

#[derive(Debug, Default)]
struct Points {
    observations: Observations,
    ids: Option<Vec<u64>>,
}

impl std::fmt::Debug for PosedView {
    /// Without the numbers, of which there are thousands.
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
    /// An implausible size, or a camera with [numbers that cannot be](Camera::check).
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

    /// The same with an identity for every observation: those of several views with the same one are measurements of the
    /// same point, as in a model of structure from motion, and are counted once.
    ///
    /// # Errors
    /// Another number of identities than of observations.
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

    /// Its measured points.
    pub fn observations(&self) -> &Observations {
        &self.points.observations
    }

    /// The points within the image that have a depth.
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

/// Which views are neighbours, and how many points are carried over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewSettings {
    /// The most neighbours of an image.
    pub count: usize,
    /// Whether only earlier views are neighbours, as online.
    pub only_past: bool,
    /// The most points that are carried over from all neighbours.
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

/// The carried points join only if the image's own points are predicted better with them by so many standard errors. Chosen on
/// procedural rooms: with 0, wrong poses and 50 points raised the RMSE by 3 %.
const BETTER: f64 = 2.0;

impl Scene {
    /// Fits the basis functions of the image to its own observations together with the points of other views, at most
    /// `max_points` of them. `others` are best [`neighbours`], the closest first. Also returns which of the others were used,
    /// and what became of their points.
    ///
    /// A carried point keeps its own standard deviation, if it is known. Only measured points are carried, each once, never
    /// completed depths: nothing is counted twice. There are two fits, to the own points and to all, or three; without others, the
    /// result is that of [`Self::complete`].
    ///
    /// # Errors
    /// A view of another size than the image, and as for [`Self::complete`].
    ///
    /// ```
    /// # #[cfg(feature = "weights")]
    /// # fn main() -> lsdc_core::Result<()> {
    /// # use lsdc_core::{Camera, Channels, Completer, Image, Observations, PosedView, ViewSettings, Weights};
    /// # let completer = Completer::new(&Weights::builtin_small())?;
    /// # let grey = vec![128_u8; 3 * 64 * 48];
    /// # let scene = completer.scene(&Image::new(64, 48, Channels::Rgb, &grey)?)?;
    /// // Two cameras side by side in front of a wall at 2 m.
    /// let camera = Camera::pinhole([60.0, 60.0], [31.5, 23.5]);
    /// let aside = camera.clone().with_pose([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], [-0.2, 0.0, 0.0]);
    /// let wall = |first: usize| -> Observations {
    ///     let places = (first..3072).step_by(61).map(|i| ((i % 64) as f64, (i / 64) as f64));
    ///     places.map(|(u, v)| lsdc_core::Observation { u, v, depth: 2.0, sigma: None }).collect()
    /// };
    /// let own = PosedView::new(camera, 64, 48, wall(0))?;
    /// let other = PosedView::new(aside, 64, 48, wall(30))?;
    /// let (completion, report) = scene.complete_with_views(&own, &[&other], &ViewSettings::default())?;
    /// assert!(report.carried() > 30);
    /// assert!((completion.depth()?.at(30, 20) - 2.0).abs() < 0.01);
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
        // Where something moved that no own point shows, what the image contradicts is not seen there.
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

    /// How well the other points predict the image's own points with the carried ones and without.
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

/// How the leave-one-out errors of the image's own points change with the carried points.
struct Judgement {
    /// Means, relative to the depths, without and with them; none without enough points.
    errors: Option<[f64; 2]>,
    /// The gain over its standard error.
    standard_errors: f64,
    /// Whether the root mean square rises: a few points behind something that is not there.
    are_large_ones_larger: bool,
}

impl Judgement {
    fn is_better(&self) -> bool {
        self.standard_errors >= BETTER && !self.are_large_ones_larger
    }
}

/// What points say, unless there are too few of them.
fn known<T>(found: Result<T>) -> Result<Option<T>> {
    match found {
        Ok(found) => Ok(Some(found)),
        Err(Error::Fit(FitError::TooFewPoints(_))) => Ok(None),
        Err(other) => Err(other),
    }
}

/// The observations of the image, then the carried ones.
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
