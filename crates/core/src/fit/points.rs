//! The points to be fitted.

use super::lstsq::dot;
use super::medians::median;
use super::space::Scale;
use super::{Scene, Space};
use crate::error::FitError;
use std::borrow::Cow;
use std::fmt::Debug;

/// Basis functions of an image that can be evaluated anywhere.
pub trait Functions: Debug + Sync {
    /// The number of functions, including the constant and cosines.
    fn count(&self) -> usize;

    /// Their values `[places, count]`, row by row.
    fn at(&self, places: &[[f64; 2]]) -> Vec<f32>;

    /// Functions x weights at each place.
    fn combine(&self, places: &[[f64; 2]], weights: &[f64]) -> Vec<f64>;

    /// Functions x weights at every pixel of a grid (height, width) over the image.
    fn map(&self, grid: (usize, usize), weights: &[f64]) -> Vec<f32>;
}

/// The basis functions at some points.
#[derive(Clone, Copy, Debug)]
pub enum Bases<'a> {
    /// Their values `[n, N + 1]`, row by row.
    Rows(&'a [f32]),
    /// Of so many points that fits with a field evaluate them at some of these only.
    Functions(&'a dyn Functions),
    /// Both.
    Held(&'a [f32], &'a dyn Functions),
}

/// Sparse depths with the basis functions at their positions.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a> {
    /// Basis functions.
    pub bases: Bases<'a>,
    /// How many of them, the last ones before cosines, are those of a [guide](crate::DepthGuide).
    pub guides: usize,
    /// Depths in metres, above 0.
    pub depths: &'a [f32],
    /// The standard deviation of each depth in metres, above 0, where it is known: that of the measurement, in
    /// addition to what the model of depth leaves unexplained.
    pub deviations: Option<&'a [Option<f32>]>,
    /// The position (u, v) of each point, which fits with a field need, and which robust fits use to find
    /// neighbours.
    pub places: Option<&'a [[f64; 2]]>,
    /// The image that the points lie in, which fits with a field need.
    pub scene: Option<Scene<'a>>,
}

/// Points in the space of the fit.
pub(super) struct Rows<'a> {
    bases: Bases<'a>,
    pub(super) values: Vec<f64>,
    pub(super) weights: Vec<f64>,
    /// The variance of each measurement, 0 where it is unknown.
    pub(super) variances: Vec<f64>,
    pub(super) places: Option<&'a [[f64; 2]]>,
    pub(super) scale: Scale,
}

impl<'a> Points<'a> {
    /// Points of equal weight at unknown positions.
    pub fn new(bases: &'a [f32], depths: &'a [f32]) -> Self {
        Self {
            bases: Bases::Rows(bases),
            guides: 0,
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
        let (values, finite) = match self.bases {
            Bases::Rows(rows) | Bases::Held(rows, _) => (rows.len(), all_finite(rows)),
            Bases::Functions(functions) => (functions.count() * count, true),
        };
        if !values.is_multiple_of(count) || lengths != [count; 2] {
            return Err(FitError::Shape(format!(
                "{values} values of basis functions, {} deviations and {} places for {count} points",
                lengths[0], lengths[1]
            )));
        }
        if !finite || !all_finite(self.depths) {
            return Err(FitError::NotFinite);
        }
        let scale = Scale::of_points(space, self.depths);
        let values: Vec<f64> = self
            .depths
            .iter()
            .map(|&d| scale.of(f64::from(d)))
            .collect();
        if !values.iter().all(|v| v.is_finite()) {
            return Err(FitError::NotFinite);
        }
        let variances = match self.deviations {
            None => vec![0.0; count],
            Some(deviations) => variances(self.depths, deviations, scale)?,
        };
        Ok(Rows {
            bases: self.bases,
            values,
            weights: vec![1.0; count],
            variances,
            places: self.places,
            scale,
        })
    }
}

/// Variances in the space of the fit, 0 where the deviation is unknown.
fn variances(
    depths: &[f32],
    deviations: &[Option<f32>],
    scale: Scale,
) -> Result<Vec<f64>, FitError> {
    let variance = |(&depth, &deviation): (&f32, &Option<f32>)| {
        let Some(deviation) = deviation else {
            return Ok(0.0);
        };
        let variance = (f64::from(deviation) / scale.slope(f64::from(depth))).powi(2);
        if deviation > 0.0 && variance > 0.0 && variance.is_finite() {
            Ok(variance)
        } else {
            Err(FitError::StandardDeviation)
        }
    };
    depths.iter().zip(deviations).map(variance).collect()
}

impl Rows<'_> {
    pub(super) fn columns(&self) -> usize {
        match self.bases {
            Bases::Rows(rows) | Bases::Held(rows, _) => rows.len() / self.values.len().max(1),
            Bases::Functions(functions) => functions.count(),
        }
    }

    /// The basis functions at all points.
    pub(super) fn bases(&self) -> Cow<'_, [f32]> {
        match self.bases {
            Bases::Rows(rows) | Bases::Held(rows, _) => Cow::Borrowed(rows),
            Bases::Functions(functions) => {
                Cow::Owned(functions.at(self.places.unwrap_or_default()))
            }
        }
    }

    /// The basis functions at some points.
    ///
    /// # Errors
    /// Values that are not finite.
    pub(super) fn bases_of(&self, points: &[usize]) -> Result<Vec<f32>, FitError> {
        let rows: Vec<f32> = match self.bases {
            Bases::Rows(rows) | Bases::Held(rows, _) => {
                let columns = self.columns();
                let row = |&i: &usize| &rows[i * columns..][..columns];
                points.iter().map(row).collect::<Vec<_>>().concat()
            }
            Bases::Functions(functions) => {
                let places = self.places.unwrap_or_default();
                functions.at(&points.iter().map(|&i| places[i]).collect::<Vec<_>>())
            }
        };
        if all_finite(&rows) {
            Ok(rows)
        } else {
            Err(FitError::NotFinite)
        }
    }

    /// What a relative residual is relative to. Differences of logarithms are relative already.
    pub(super) fn unit(&self) -> f64 {
        match self.scale.space() {
            Space::Log => 1.0,
            Space::Depth | Space::Inverse => median(self.values.iter().copied()),
        }
    }

    /// Whether what is wrong by a factor is off by more the larger the value is.
    pub(super) fn is_proportional(&self) -> bool {
        self.scale.space() != Space::Log
    }

    /// Some points, of which `values` are others than theirs, and no basis functions but one that is 0. `places` are
    /// those of these points.
    pub(super) fn alone<'b>(
        &self,
        points: &[usize],
        places: &'b [[f64; 2]],
        values: &[f64],
        zeros: &'b [f32],
    ) -> Rows<'b> {
        Rows {
            bases: Bases::Rows(zeros),
            values: points.iter().map(|&i| values[i]).collect(),
            weights: points.iter().map(|&i| self.weights[i]).collect(),
            variances: points.iter().map(|&i| self.variances[i]).collect(),
            places: Some(places),
            scale: self.scale,
        }
    }

    /// Basis functions x weights anywhere, unless they are known at the points only.
    pub(super) fn combine(&self, places: &[[f64; 2]], weights: &[f64]) -> Option<Vec<f64>> {
        match self.bases {
            Bases::Rows(_) => None,
            Bases::Functions(functions) | Bases::Held(_, functions) => {
                Some(functions.combine(places, weights))
            }
        }
    }

    /// Whether basis functions are known everywhere, and not at the points only.
    pub(super) fn are_everywhere(&self) -> bool {
        !matches!(self.bases, Bases::Rows(_))
    }

    /// Basis functions x weights at every pixel of a grid (height, width), unless they are known at the points only.
    pub(super) fn map(&self, grid: (usize, usize), weights: &[f64]) -> Option<Vec<f32>> {
        match self.bases {
            Bases::Rows(_) => None,
            Bases::Functions(functions) | Bases::Held(_, functions) => {
                Some(functions.map(grid, weights))
            }
        }
    }

    pub(super) fn residuals(&self, weights: &[f64]) -> Vec<f64> {
        let model = match self.bases {
            Bases::Rows(rows) | Bases::Held(rows, _) => {
                let rows = rows.chunks_exact(weights.len().max(1));
                rows.map(|row| dot(row, weights)).collect()
            }
            Bases::Functions(functions) => {
                functions.combine(self.places.unwrap_or_default(), weights)
            }
        };
        let pairs = self.values.iter().zip(model);
        pairs.map(|(value, model)| value - model).collect()
    }
}

fn all_finite(values: &[f32]) -> bool {
    // Whole chunks at once, which vector units can do.
    let finite = |chunk: &[f32]| chunk.iter().fold(true, |all, v| all & v.is_finite());
    values.chunks(256).all(finite)
}
