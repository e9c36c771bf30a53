//! Losses of a training step.

use super::Losses;
use crate::traffic::count_readback;
use burn::tensor::Tensor;

/// Losses of a batch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepLosses {
    /// Weighted sum of the losses.
    pub loss: f64,
    /// Mean absolute error in metres.
    pub l1: f64,
    /// Mean squared error in square metres.
    pub l2: f64,
}

impl StepLosses {
    pub(super) fn of(losses: &Losses) -> Self {
        let value = |t: &Tensor<1>| {
            count_readback();
            t.clone().into_scalar::<f32>().into()
        };
        Self {
            loss: value(&losses.total),
            l1: value(&losses.l1),
            l2: value(&losses.l2),
        }
    }

    /// Adds the losses of a part of the batch.
    pub(super) fn add(&mut self, other: &Self, part: f64) {
        self.loss += other.loss * part;
        self.l1 += other.l1 * part;
        self.l2 += other.l2 * part;
    }
}
