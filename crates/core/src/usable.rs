//! Selection of the usable observations, and counts of the others.

use crate::ensemble::mirrored_place;
use crate::error::{FitError, Result};
use crate::observations::{Observation, Observations};
use crate::smoothing::Smoothed;

/// The accepted range of depths and standard deviations, in any unit; outside it, squares overflow or underflow `f32`.
const LEAST: f32 = 1e-15;
const MOST: f32 = 1e15;

/// The observations that a fit can use, in the given order.
#[derive(Clone, Debug)]
pub(crate) struct UsableObservations {
    /// Number of observations given.
    pub(crate) given: usize,
    /// The indices of the usable observations.
    pub(crate) indices: Vec<usize>,
    pub(crate) places: Vec<[f64; 2]>,
    pub(crate) depths: Vec<f32>,
    /// Standard deviations; `None` if all are unknown.
    pub(crate) deviations: Option<Vec<Option<f32>>>,
    /// Smoothed depths and deviations, if dense observations were smoothed.
    pub(crate) smoothed: Option<Smoothed>,
    /// Number of observations with an unusable depth or position.
    pub(crate) invalid: usize,
    pub(crate) outside: usize,
    /// Number of observations without a standard deviation, if others have one.
    pub(crate) without_deviation: usize,
}

impl UsableObservations {
    /// The usable observations for an image of `size` (height, width).
    pub(crate) fn new(observations: &Observations, size: (usize, usize)) -> Result<Self, FitError> {
        let mut usable = Self::as_given(observations, size)?;
        if let Some(deviations) = &usable.deviations {
            usable.smoothed = Smoothed::new(&usable.places, &usable.depths, deviations, size);
        }
        Ok(usable)
    }

    /// Like [`Self::new`], without smoothing.
    fn as_given(
        observations: &Observations,
        (height, width): (usize, usize),
    ) -> Result<Self, FitError> {
        let given = observations.len();
        let mut usable = Self {
            given,
            indices: Vec::with_capacity(given),
            places: Vec::with_capacity(given),
            depths: Vec::with_capacity(given),
            deviations: None,
            smoothed: None,
            invalid: 0,
            outside: 0,
            without_deviation: 0,
        };
        let is_usable = |v: f32| (LEAST..=MOST).contains(&v);
        // A standard deviation that is 0, negative or not finite is unknown.
        let known = |point: &Observation| point.sigma.filter(|&sigma| is_usable(sigma));
        let any = observations.iter().any(|point| known(point).is_some());
        let mut deviations = Vec::with_capacity(if any { given } else { 0 });
        for (i, point) in observations.iter().enumerate() {
            let &Observation { u, v, depth, .. } = point;
            let inside = |place: f64, length: usize| (-0.5..length as f64 - 0.5).contains(&place);
            if !(is_usable(depth) && u.is_finite() && v.is_finite()) {
                usable.invalid += 1;
            } else if inside(u, width) && inside(v, height) {
                usable.indices.push(i);
                usable.places.push([u, v]);
                usable.depths.push(depth);
                if any {
                    deviations.push(known(point));
                }
            } else {
                usable.outside += 1;
            }
        }
        if usable.indices.is_empty() {
            return Err(usable.no_observations());
        }
        let without_deviation = deviations.iter().filter(|sigma| sigma.is_none()).count();
        if without_deviation < deviations.len() {
            usable.without_deviation = without_deviation;
            usable.deviations = Some(deviations);
        }
        Ok(usable)
    }

    /// Returns the same observations in the mirror image of an image of `size` (height, width).
    pub(crate) fn mirrored(&self, size: (usize, usize)) -> Self {
        let places = self.places.iter();
        let places: Vec<[f64; 2]> = places.map(|&place| mirrored_place(place, size.1)).collect();
        let deviations = self.deviations.as_ref();
        let smoothed = deviations
            .and_then(|deviations| Smoothed::new(&places, &self.depths, deviations, size));
        Self {
            places,
            smoothed,
            ..self.clone()
        }
    }

    /// Returns the depths used in the fit.
    pub(crate) fn fitted(&self) -> &[f32] {
        self.smoothed
            .as_ref()
            .map_or(&self.depths, |smoothed| &smoothed.depths)
    }

    /// Returns the standard deviations of the fitted depths; `None` if all are unknown.
    pub(crate) fn fitted_deviations(&self) -> Option<&[Option<f32>]> {
        let smoothed = self.smoothed.as_ref().map(|smoothed| &smoothed.deviations);
        smoothed.or(self.deviations.as_ref()).map(Vec::as_slice)
    }

    /// Returns the error for observations of which none is usable.
    pub(crate) fn no_observations(&self) -> FitError {
        FitError::NoObservations {
            given: self.given,
            invalid: self.invalid,
            outside: self.outside,
        }
    }

    /// Expands values of the usable observations to all given ones, with NaN for the others.
    pub(crate) fn scatter(&self, values: &[f64]) -> Vec<f64> {
        let mut all = vec![f64::NAN; self.given];
        for (&i, &value) in self.indices.iter().zip(values) {
            all[i] = value;
        }
        all
    }

    /// The smallest and the largest depth.
    pub(crate) fn range(&self) -> (f32, f32) {
        let depths = self.depths.iter();
        depths.fold((f32::INFINITY, 0.0), |(low, high), &d| {
            (low.min(d), high.max(d))
        })
    }
}

impl Observations {
    /// Checks that a fit to an image of `width` x `height` pixels can use some of them, before the network is run.
    ///
    /// # Errors
    /// No observation is usable: the error counts observations outside the image, and those with an unusable depth.
    ///
    /// ```
    /// let mut points = lsdc_core::Observations::new();
    /// points.add(-5.0, 3.0, 2.0);
    /// assert!(points.check(640, 480).is_err());
    /// points.add(5.0, 3.0, 2.0);
    /// assert!(points.check(640, 480).is_ok());
    /// ```
    pub fn check(&self, width: usize, height: usize) -> Result<()> {
        UsableObservations::as_given(self, (height, width))?;
        Ok(())
    }
}
