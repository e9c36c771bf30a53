//! What is observed of a field.

use crate::bilinear::InterpolationWeights;

/// The observations of a field.
#[derive(Clone, Copy, Debug)]
pub struct Observations<'a> {
    /// The pixels that each observation is interpolated from.
    pub taps: &'a [InterpolationWeights],
    /// The weight of each observation, above 0.
    pub weights: &'a [f64],
    /// The columns whose combinations are the targets, `[observations, columns]`, row by row.
    pub columns: &'a [f64],
    /// The number of columns.
    pub count: usize,
}

impl Observations<'_> {
    pub(super) fn check(&self) {
        assert_eq!(self.weights.len(), self.taps.len(), "weights");
        assert_eq!(self.columns.len(), self.taps.len() * self.count, "columns");
    }
}
