//! How a vector of parameters follows from its gradient.

use super::ALIGNMENT;
use crate::ops::pack::Layout;
use crate::ops::weighted_sum::weighted_sum;
use burn::tensor::{IndexingUpdateOp, Int, Tensor};

/// The rule of a group of parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rule {
    /// Adam (Kingma and Ba 2015).
    Adam,
    /// Gradient descent with momentum.
    Sgd,
    /// [`muon`](super::muon).
    Muon,
}

impl Rule {
    /// Returns the names of the vectors of the state.
    pub(super) fn moments(self) -> &'static [&'static str] {
        match self {
            Self::Adam => &["first", "second"],
            Self::Sgd | Self::Muon => &["momentum"],
        }
    }

    /// Sorts parameters as the rule needs them.
    pub(super) fn order<T>(self, found: &mut [T], shape: impl Fn(&T) -> &[usize]) {
        if self == Self::Muon {
            found.sort_by_key(|found| super::muon::matrix(shape(found)));
        }
    }

    /// Returns where the parameters are in a vector.
    pub(super) fn layout(self, shapes: &[Vec<usize>]) -> Layout {
        let mut layout = Layout::default();
        match self {
            Self::Adam | Self::Sgd => {
                for shape in shapes {
                    layout.push(1, shape.iter().product());
                }
            }
            Self::Muon => {
                for stack in super::muon::stacks(shapes) {
                    layout.push(stack.len(), shapes[stack.start].iter().product());
                }
            }
        }
        layout
    }
}

/// Scales the gradient of each part that has a norm above `limit`. `rows` is the part of each row of [`ALIGNMENT`] values.
pub(super) fn clipped(
    gradient: Tensor<1>,
    rows: &Tensor<1, Int>,
    parts: usize,
    limit: f32,
) -> Tensor<1> {
    let (size, count) = (gradient.dims()[0], rows.dims()[0]);
    let gradient = gradient.reshape([count, ALIGNMENT]);
    let squares = gradient.clone().square().sum_dim(1).reshape([count]);
    let norms = Tensor::zeros([parts], &gradient.device())
        .select_assign(0, rows.clone(), squares, IndexingUpdateOp::Add)
        .sqrt();
    let factors = ((norms + f32::MIN_POSITIVE).recip() * limit).clamp_max(1.0);
    let factors = factors.select(0, rows.clone()).reshape([count, 1]);
    (gradient * factors).reshape([size])
}

/// Returns the step of Adam, with the usual constants.
pub(super) fn adam(
    moments: &mut [Tensor<1>],
    gradient: Tensor<1>,
    steps: usize,
    rate: f64,
) -> Tensor<1> {
    const FIRST: f64 = 0.9;
    const SECOND: f64 = 0.999;
    const EPSILON: f64 = 1e-8;
    let [first, second] = moments else {
        return gradient.zeros_like();
    };
    *first = weighted_sum(first.clone(), FIRST, gradient.clone(), 1.0 - FIRST);
    *second = weighted_sum(second.clone(), SECOND, gradient.square(), 1.0 - SECOND);
    // Moments start at 0; these factors make up for it.
    let steps = steps as i32;
    let root = (1.0 - SECOND.powi(steps)).sqrt();
    let factor = rate * root / (1.0 - FIRST.powi(steps));
    first.clone() * factor / (second.clone().sqrt() + EPSILON * root)
}

/// Returns the step of gradient descent with momentum.
pub(super) fn sgd(moments: &mut [Tensor<1>], gradient: Tensor<1>, rate: f64) -> Tensor<1> {
    const MOMENTUM: f64 = 0.9;
    let [velocity] = moments else {
        return gradient.zeros_like();
    };
    *velocity = weighted_sum(velocity.clone(), MOMENTUM, gradient, 1.0);
    velocity.clone() * rate
}
