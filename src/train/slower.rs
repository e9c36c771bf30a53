//! Parameters that others trained move less than those that begin at random.

use burn::optim::{LearningRate, Optimizer};
use burn::tensor::{Device, Tensor};

/// An optimiser at a share of the learning rate.
#[derive(Clone)]
pub(super) struct Slower<O> {
    pub(super) inner: O,
    pub(super) share: f64,
}

impl<O: Optimizer> Optimizer for Slower<O> {
    type State<const D: usize> = O::State<D>;

    fn step<const D: usize>(
        &self,
        rate: LearningRate,
        tensor: Tensor<D>,
        gradient: Tensor<D>,
        state: Option<Self::State<D>>,
    ) -> (Tensor<D>, Option<Self::State<D>>) {
        self.inner.step(rate * self.share, tensor, gradient, state)
    }

    fn to_device<const D: usize>(state: Self::State<D>, device: &Device) -> Self::State<D> {
        O::to_device(state, device)
    }
}
