//! Known depths at some positions of an image.

use crate::cloud::{Viewpoint, pixel, visible};
use crate::map::{DepthMap, Point};

/// One known depth.
///
/// `u` is measured to the right and `v` down, in pixels; (0, 0) is the centre of the first pixel, as in
/// `OpenCV`: the image covers `-0.5..width - 0.5` and `-0.5..height - 0.5`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Horizontal position in pixels.
    pub u: f64,
    /// Vertical position in pixels.
    pub v: f64,
    /// Depth along the optical axis in metres, or in any other unit, which the result then has too.
    pub depth: f32,
    /// Standard deviation of the measurement, in the same unit, if it is known. The deviation of true depths from the model
    /// between the observations is not included: it is estimated from the observations. 0, negative and non-finite values mean
    /// that it is unknown.
    pub sigma: Option<f32>,
}

impl Observation {
    /// A depth at (u, v) with unknown standard deviation.
    pub(crate) fn new(u: f64, v: f64, depth: f32) -> Self {
        let sigma = None;
        Self { u, v, depth, sigma }
    }
}

/// Known depths, in the order in which they were added.
///
/// All values are accepted here: unusable observations are skipped and counted when an image is completed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observations(Vec<Observation>);

impl Observations {
    /// An empty set.
    pub fn new() -> Self {
        Self::default()
    }

    /// The measurements of a map, each at the centre of its pixel.
    pub fn from_map(map: &DepthMap) -> Self {
        let observation =
            |point: Point| Observation::new(point.x as f64, point.y as f64, point.depth);
        let mut all = Vec::with_capacity(map.count());
        all.extend(map.points().map(observation));
        Self(all)
    }

    /// Adds a depth at (u, v) with unknown standard deviation.
    pub fn add(&mut self, u: f64, v: f64, depth: f32) {
        self.push(Observation::new(u, v, depth));
    }

    /// Adds an observation.
    pub fn push(&mut self, observation: Observation) {
        self.0.push(observation);
    }

    /// Removes points that nearer ones hide in an image of `width` x `height` pixels, as in the projected scan of a scanner beside
    /// the camera, and returns their number: points behind a surface in the same pixel and, if some points lie between two sides
    /// of a nearer object, points next to nearer ones. Unusable points stay.
    ///
    /// ```
    /// # use lsdc_core::Observations;
    /// let mut points = Observations::new();
    /// points.add(3.0, 2.0, 4.0);
    /// points.add(3.2, 2.0, 9.0);
    /// assert_eq!((points.remove_hidden(64, 48), points.len()), (1, 1));
    /// ```
    pub fn remove_hidden(&mut self, width: usize, height: usize) -> usize {
        let size = (width, height);
        let is_usable = |point: &Observation| {
            point.depth > 0.0
                && point.depth.is_finite()
                && pixel([point.u, point.v], size).is_some()
        };
        let usable: Vec<Observation> = self.iter().copied().filter(is_usable).collect();
        let mut visible = visible(&usable, size, Viewpoint::Unknown).into_iter();
        let before = self.len();
        self.0
            .retain(|point| !is_usable(point) || visible.next().unwrap_or(true));
        before - self.len()
    }

    /// The number of observations.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there are no observations.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// All observations, in the order in which they were added.
    pub fn as_slice(&self) -> &[Observation] {
        &self.0
    }

    /// All observations, in the order in which they were added.
    pub fn iter(&self) -> std::slice::Iter<'_, Observation> {
        self.0.iter()
    }
}

impl Extend<Observation> for Observations {
    fn extend<I: IntoIterator<Item = Observation>>(&mut self, observations: I) {
        self.0.extend(observations);
    }
}

impl FromIterator<Observation> for Observations {
    fn from_iter<I: IntoIterator<Item = Observation>>(observations: I) -> Self {
        Self(observations.into_iter().collect())
    }
}

impl<'a> IntoIterator for &'a Observations {
    type Item = &'a Observation;
    type IntoIter = std::slice::Iter<'a, Observation>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}
