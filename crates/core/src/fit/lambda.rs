//! The strength of the prior.

use serde::{Deserialize, Serialize};

/// The choice of the strength of the prior, lambda: the ratio of the noise variance to the variance of u.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Lambda {
    /// Maximises the marginal likelihood of the points (empirical Bayes, REML: Patterson and Thompson 1971).
    #[default]
    Evidence,
    /// Minimises the estimated error of predicting points left out (generalised cross-validation: Golub, Heath
    /// and Wahba 1979).
    Gcv,
    /// A fixed value.
    #[serde(untagged)]
    Fixed(f64),
    /// Numbers of points, in ascending order, with a value for each. Values in between are interpolated logarithmically;
    /// outside the range they are constant.
    #[serde(untagged)]
    ByCount([(f64, f64); LAMBDA_COUNTS]),
}

impl Lambda {
    /// Multiplies a given strength by a factor.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        match self {
            Self::Evidence | Self::Gcv => self,
            Self::Fixed(value) => Self::Fixed(value * factor),
            Self::ByCount(values) => {
                Self::ByCount(values.map(|(count, value)| (count, value * factor)))
            }
        }
    }

    /// Returns the strength for a number of points, unless it is estimated from the points.
    pub(super) fn given(self, count: usize) -> Option<f64> {
        match self {
            Self::Evidence | Self::Gcv => None,
            Self::Fixed(lambda) => Some(lambda),
            Self::ByCount(values) => Some(by_count(&values, count)),
        }
    }

    /// Returns the strength for a number of points, for statistics that may be those of fewer points.
    pub(super) fn at(self, count: usize) -> Self {
        match self {
            Self::Evidence | Self::Gcv | Self::Fixed(_) => self,
            Self::ByCount(values) => Self::Fixed(by_count(&values, count)),
        }
    }
}

/// The number of pairs in [`Lambda::ByCount`].
pub const LAMBDA_COUNTS: usize = 3;

/// The value for a number of points.
fn by_count(values: &[(f64, f64); LAMBDA_COUNTS], count: usize) -> f64 {
    let place = (count.max(1) as f64).ln();
    let (first, last) = (values[0], values[LAMBDA_COUNTS - 1]);
    for [(from, low), (to, high)] in values.array_windows() {
        let (start, end) = (from.ln(), to.ln());
        if place >= start && place < end {
            let share = (place - start) / (end - start);
            return (low.ln() * (1.0 - share) + high.ln() * share).exp();
        }
    }
    if place < first.0.ln() {
        first.1
    } else {
        last.1
    }
}
