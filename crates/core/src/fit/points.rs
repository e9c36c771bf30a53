//! The points to be fitted.

use super::robust::median;
use super::{Scene, Space, lstsq};
use crate::error::FitError;

/// Sparse depths with the basis functions at their positions.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a> {
    /// Basis functions `[n, N + 1]`, row by row.
    pub bases: &'a [f32],
    /// Depths in metres, above 0.
    pub depths: &'a [f32],
    /// The standard deviation of each depth in metres, above 0; only their ratios matter. If absent, all
    /// points have the same weight.
    pub deviations: Option<&'a [f32]>,
    /// The position (u, v) of each point, which fits with a field need, and which robust fits use to find
    /// neighbours.
    pub places: Option<&'a [[f64; 2]]>,
    /// The image that the points lie in, which fits with a field need.
    pub scene: Option<Scene<'a>>,
}

/// Points in the space of the fit.
pub(super) struct Rows<'a> {
    pub(super) bases: &'a [f32],
    pub(super) values: Vec<f64>,
    /// By the deviations; the median is 1.
    pub(super) weights: Vec<f64>,
    pub(super) places: Option<&'a [[f64; 2]]>,
    space: Space,
}

impl<'a> Points<'a> {
    /// Points of equal weight at unknown positions.
    pub fn new(bases: &'a [f32], depths: &'a [f32]) -> Self {
        Self {
            bases,
            depths,
            deviations: None,
            places: None,
            scene: None,
        }
    }

    pub(super) fn rows(&self, space: Space) -> Result<Rows<'a>, FitError> {
        let count = self.depths.len();
        if count == 0 {
            return Err(FitError::NoObservations {
                given: 0,
                invalid: 0,
                outside: 0,
            });
        }
        let lengths = [
            self.deviations.map_or(count, <[_]>::len),
            self.places.map_or(count, <[_]>::len),
        ];
        if !self.bases.len().is_multiple_of(count) || lengths != [count; 2] {
            return Err(FitError::Shape(format!(
                "{} values of basis functions, {} deviations and {} places for {count} points",
                self.bases.len(),
                lengths[0],
                lengths[1]
            )));
        }
        if !all_finite(self.bases) || !all_finite(self.depths) {
            return Err(FitError::NotFinite);
        }
        let values: Vec<f64> = self
            .depths
            .iter()
            .map(|&d| space.of(f64::from(d)))
            .collect();
        if !values.iter().all(|v| v.is_finite()) {
            return Err(FitError::NotFinite);
        }
        let weights = match self.deviations {
            None => vec![1.0; count],
            Some(deviations) => precisions(self.depths, deviations, space)?,
        };
        Ok(Rows {
            bases: self.bases,
            values,
            weights,
            places: self.places,
            space,
        })
    }
}

/// Inverse variances in the space of the fit, divided by their median, so that a few very precise points do
/// not change the balance between the other points and the prior.
fn precisions(depths: &[f32], deviations: &[f32], space: Space) -> Result<Vec<f64>, FitError> {
    let precision = |(&depth, &deviation): (&f32, &f32)| {
        (f64::from(deviation) / space.slope(f64::from(depth))).powi(-2)
    };
    let all: Vec<f64> = depths.iter().zip(deviations).map(precision).collect();
    if !all.iter().all(|w| *w > 0.0 && w.is_finite()) {
        return Err(FitError::StandardDeviation);
    }
    let middle = median(all.iter().copied());
    Ok(all.into_iter().map(|w| w / middle).collect())
}

impl Rows<'_> {
    pub(super) fn columns(&self) -> usize {
        self.bases.len() / self.values.len().max(1)
    }

    /// What a relative residual is relative to. Differences of logarithms are relative already.
    pub(super) fn unit(&self) -> f64 {
        match self.space {
            Space::Log => 1.0,
            Space::Depth | Space::Inverse => median(self.values.iter().copied()),
        }
    }

    /// Whether what is wrong by a factor is off by more the larger the value is.
    pub(super) fn is_proportional(&self) -> bool {
        self.space != Space::Log
    }

    pub(super) fn residuals(&self, weights: &[f64]) -> Vec<f64> {
        lstsq::residuals(self.bases, &self.values, weights)
    }
}

fn all_finite(values: &[f32]) -> bool {
    // Whole chunks at once, which vector units can do.
    let finite = |chunk: &[f32]| chunk.iter().fold(true, |all, v| all & v.is_finite());
    values.chunks(256).all(finite)
}
