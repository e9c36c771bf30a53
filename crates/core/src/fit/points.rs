//! The points to be fitted.

use super::FieldGeometry;
use super::lstsq::dot;
use super::medians::median;
use crate::error::FitError;
use std::borrow::Cow;
use std::cmp::Ordering;
use std::fmt::Debug;

/// Basis functions of an image that can be evaluated anywhere.
pub trait EvaluateBasis: Debug + Sync {
    /// The number of functions, including the constant and cosines.
    fn count(&self) -> usize;

    /// The values `[places, count]`, row by row.
    fn at(&self, places: &[[f64; 2]]) -> Vec<f32>;

    /// The weighted sum of the functions at each position.
    fn combine(&self, places: &[[f64; 2]], weights: &[f64]) -> Vec<f64>;

    /// The weighted sum of the functions at every pixel of a grid (height, width) over the image.
    fn map(&self, grid: (usize, usize), weights: &[f64]) -> Vec<f32>;
}

/// The representation of the basis functions.
#[derive(Clone, Copy, Debug)]
pub enum BasisValues<'a> {
    /// Their values at the points, `[n, N + 1]`, row by row.
    AtPoints(&'a [f32]),
    /// A function of position, if there are so many points that fits with a field evaluate only a sample.
    Everywhere(&'a dyn EvaluateBasis),
    /// Both.
    Both(&'a [f32], &'a dyn EvaluateBasis),
}

/// Sparse depths with the basis functions at their positions.
#[derive(Clone, Copy, Debug)]
pub struct FitPoints<'a> {
    /// Basis functions.
    pub bases: BasisValues<'a>,
    /// Number of functions of a [guide](crate::DepthGuide), which are the last ones before the cosines.
    pub guides: usize,
    /// Depths in metres, above 0.
    pub depths: &'a [f32],
    /// The standard deviation of each depth in metres, above 0, where it is known: that of the measurement, without the
    /// deviation that the model of depth leaves unexplained.
    pub deviations: Option<&'a [Option<f32>]>,
    /// The position (u, v) of each point, which fits with a field need, and which robust fits use to find
    /// neighbours.
    pub places: Option<&'a [[f64; 2]]>,
    /// The image that the points lie in, which fits with a field need.
    pub geometry: Option<FieldGeometry<'a>>,
}

/// The rows of a regression.
pub(super) struct FitRows<'a> {
    bases: BasisValues<'a>,
    /// Depths in metres.
    pub(super) values: Vec<f64>,
    pub(super) weights: Vec<f64>,
    /// The variance of each measurement, 0 where it is unknown.
    pub(super) variances: Vec<f64>,
    pub(super) places: Option<&'a [[f64; 2]]>,
}

impl<'a> FitPoints<'a> {
    /// Points of equal weight at unknown positions.
    pub fn new(bases: &'a [f32], depths: &'a [f32]) -> Self {
        Self {
            bases: BasisValues::AtPoints(bases),
            guides: 0,
            depths,
            deviations: None,
            places: None,
            geometry: None,
        }
    }

    pub(super) fn rows(&self) -> Result<FitRows<'a>, FitError> {
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
            BasisValues::AtPoints(rows) | BasisValues::Both(rows, _) => {
                (rows.len(), all_finite(rows))
            }
            BasisValues::Everywhere(functions) => (functions.count() * count, true),
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
        let variances = match self.deviations {
            None => vec![0.0; count],
            Some(deviations) => variances(deviations)?,
        };
        Ok(FitRows {
            bases: self.bases,
            values: self.depths.iter().map(|&depth| f64::from(depth)).collect(),
            weights: vec![1.0; count],
            variances,
            places: self.places,
        })
    }
}

/// Variances, 0 where the deviation is unknown.
fn variances(deviations: &[Option<f32>]) -> Result<Vec<f64>, FitError> {
    let variance = |&deviation: &Option<f32>| {
        let Some(deviation) = deviation else {
            return Ok(0.0);
        };
        let variance = f64::from(deviation).powi(2);
        if deviation > 0.0 && variance > 0.0 && variance.is_finite() {
            Ok(variance)
        } else {
            Err(FitError::StandardDeviation)
        }
    };
    deviations.iter().map(variance).collect()
}

impl FitRows<'_> {
    pub(super) fn columns(&self) -> usize {
        match self.bases {
            BasisValues::AtPoints(rows) | BasisValues::Both(rows, _) => {
                rows.len() / self.values.len().max(1)
            }
            BasisValues::Everywhere(functions) => functions.count(),
        }
    }

    /// The basis functions at all points.
    pub(super) fn bases(&self) -> Cow<'_, [f32]> {
        match self.bases {
            BasisValues::AtPoints(rows) | BasisValues::Both(rows, _) => Cow::Borrowed(rows),
            BasisValues::Everywhere(functions) => {
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
            BasisValues::AtPoints(rows) | BasisValues::Both(rows, _) => {
                let columns = self.columns();
                let row = |&i: &usize| &rows[i * columns..][..columns];
                points.iter().map(row).collect::<Vec<_>>().concat()
            }
            BasisValues::Everywhere(functions) => {
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

    /// The unit of relative residuals.
    pub(super) fn unit(&self) -> f64 {
        median(self.values.iter().copied())
    }

    /// Returns some of the points at their `places`, with other `values` and a basis function that is 0.
    pub(super) fn with_values<'b>(
        &self,
        points: &[usize],
        places: &'b [[f64; 2]],
        values: &[f64],
        zeros: &'b [f32],
    ) -> FitRows<'b> {
        FitRows {
            bases: BasisValues::AtPoints(zeros),
            values: points.iter().map(|&i| values[i]).collect(),
            weights: points.iter().map(|&i| self.weights[i]).collect(),
            variances: points.iter().map(|&i| self.variances[i]).collect(),
            places: Some(places),
        }
    }

    /// The basis functions, unless they are known at the points only.
    pub(super) fn everywhere(&self) -> Option<&dyn EvaluateBasis> {
        match self.bases {
            BasisValues::AtPoints(_) => None,
            BasisValues::Everywhere(functions) | BasisValues::Both(_, functions) => Some(functions),
        }
    }

    pub(super) fn residuals(&self, weights: &[f64]) -> Vec<f64> {
        let model = match self.bases {
            BasisValues::AtPoints(rows) | BasisValues::Both(rows, _) => {
                let rows = rows.chunks_exact(weights.len().max(1));
                rows.map(|row| dot(row, weights)).collect()
            }
            BasisValues::Everywhere(functions) => {
                functions.combine(self.places.unwrap_or_default(), weights)
            }
        };
        let pairs = self.values.iter().zip(model);
        pairs.map(|(value, model)| value - model).collect()
    }
}

/// Compares two lists of numbers by their first difference.
pub(super) fn lexicographic<const N: usize>(a: [f64; N], b: [f64; N]) -> Ordering {
    let mut pairs = a.iter().zip(&b).map(|(a, b)| a.total_cmp(b));
    pairs.find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
}

fn all_finite(values: &[f32]) -> bool {
    // Whole chunks at once, which vector units can do.
    let finite = |chunk: &[f32]| chunk.iter().fold(true, |all, v| all & v.is_finite());
    values.chunks(256).all(finite)
}
