//! What is fitted.

use super::robust::median;
use super::{Scene, Space, lstsq};
use crate::error::{Error, Result};

/// Sparse depths with the base functions at them.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a> {
    /// Base functions `[n, N + 1]`, row by row.
    pub bases: &'a [f32],
    /// Depths in metres, above 0.
    pub depths: &'a [f32],
    /// The standard deviation of each depth in metres, above 0; only their ratios matter. All
    /// alike if absent.
    pub deviations: Option<&'a [f32]>,
    /// The pixel (x, y) of each, by which robust fits find neighbours.
    pub places: Option<&'a [[usize; 2]]>,
    /// The image that they lie in, which fits with a field need.
    pub scene: Option<Scene<'a>>,
}

/// Points in the space of the fit.
pub(super) struct Rows<'a> {
    pub(super) bases: &'a [f32],
    pub(super) values: Vec<f64>,
    /// By the deviations; 1 on average.
    pub(super) weights: Vec<f64>,
    pub(super) places: Option<&'a [[usize; 2]]>,
    space: Space,
}

impl<'a> Points<'a> {
    /// Points that count alike, at places unknown.
    pub fn new(bases: &'a [f32], depths: &'a [f32]) -> Self {
        Self {
            bases,
            depths,
            deviations: None,
            places: None,
            scene: None,
        }
    }

    pub(super) fn rows(&self, space: Space) -> Result<Rows<'a>> {
        let count = self.depths.len();
        if count == 0 {
            return Err(Error::fit("there is no sparse depth to fit")
                .hint("give at least one pixel a positive, finite depth"));
        }
        let lengths = [
            self.deviations.map_or(count, <[_]>::len),
            self.places.map_or(count, <[_]>::len),
        ];
        let finite = all_finite(self.bases) && all_finite(self.depths);
        if !finite || !self.bases.len().is_multiple_of(count) || lengths != [count; 2] {
            return Err(Error::fit("base functions or depths are not finite")
                .hint("the weights of the network may be damaged"));
        }
        let values: Vec<f64> = self
            .depths
            .iter()
            .map(|&d| space.of(f64::from(d)))
            .collect();
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

/// Inverse variances in the space of the fit, over their mean.
fn precisions(depths: &[f32], deviations: &[f32], space: Space) -> Result<Vec<f64>> {
    let precision = |(&depth, &deviation): (&f32, &f32)| {
        (f64::from(deviation) / space.slope(f64::from(depth))).powi(-2)
    };
    let all: Vec<f64> = depths.iter().zip(deviations).map(precision).collect();
    if !all.iter().all(|w| *w > 0.0 && w.is_finite()) {
        return Err(
            Error::fit("a standard deviation is not a positive, finite number")
                .hint("give every point that has a depth its deviation in metres"),
        );
    }
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    Ok(all.into_iter().map(|w| w / mean).collect())
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

    pub(super) fn residuals(&self, weights: &[f64]) -> Vec<f64> {
        lstsq::residuals(self.bases, &self.values, weights)
    }
}

fn all_finite(values: &[f32]) -> bool {
    // Whole chunks at once, which vector units can do.
    let finite = |chunk: &[f32]| chunk.iter().fold(true, |all, v| all & v.is_finite());
    values.chunks(256).all(finite)
}
