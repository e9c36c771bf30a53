//! The losses of training steps.

use super::Losses;
use crate::traffic::count_readback;
use burn::tensor::Tensor;
use lsdc_files::error::{Cause, Error, Result};

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

/// Losses of a batch on the device that computes them: reading them waits until it has.
#[derive(Debug)]
pub struct UnreadLosses(Tensor<1>);

impl UnreadLosses {
    /// Takes losses on an autodiff device.
    pub(super) fn of(losses: &Losses) -> Self {
        let all = [&losses.total, &losses.l1, &losses.l2];
        let all = all.map(|loss| loss.clone().inner());
        Self(Tensor::cat(all.into(), 0))
    }

    /// Returns the weighted sum over parts of a batch, on the device of the first part.
    pub(super) fn of_parts(parts: impl IntoIterator<Item = (Self, f64)>) -> Option<Self> {
        let mut parts = parts.into_iter();
        let (Self(first), share) = parts.next()?;
        let device = first.device();
        // The only part is the whole batch.
        let first = if share == 1.0 { first } else { first * share };
        let sum = parts.fold(first, |sum, (Self(part), share)| {
            sum + part.to_device(&device) * share
        });
        Some(Self(sum))
    }

    /// Reads the losses of several steps at once.
    ///
    /// # Errors
    /// A loss is not finite.
    pub fn read(steps: Vec<Self>) -> Result<Vec<StepLosses>> {
        if steps.is_empty() {
            return Ok(Vec::new());
        }
        count_readback();
        let all = Tensor::cat(steps.into_iter().map(|Self(losses)| losses).collect(), 0);
        let values: Vec<f64> = all.into_data().iter().collect();
        if values.iter().any(|value| !value.is_finite()) {
            return Err(Error::new(Cause::Fit, "the loss is no longer finite").hint(
                "lower `train.learning_rate`, set `train.clip`, or give the fit a `ridge`; \
                 training goes on from the last checkpoint",
            ));
        }
        let steps = values.chunks_exact(3);
        Ok(steps
            .map(|losses| StepLosses {
                loss: losses[0],
                l1: losses[1],
                l2: losses[2],
            })
            .collect())
    }
}
