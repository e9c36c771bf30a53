//! Smaller steps for pretrained parameters than for randomly initialised ones.

use burn::optim::{LearningRate, Optimizer};
use burn::tensor::{Device, Tensor};

/// An optimiser with a fraction of the learning rate.
#[derive(Clone)]
pub(super) struct ScaledRate<O> {
    pub(super) inner: O,
    pub(super) share: f64,
}

impl<O: Optimizer> Optimizer for ScaledRate<O> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use burn::optim::AdamConfig;

    #[test]
    fn a_step_is_a_share_of_that_of_the_optimiser() {
        let device = Device::flex();
        let gradient = Tensor::<2>::from_data([[1.0, -2.0], [0.5, 3.0]], &device);
        let start = Tensor::<2>::zeros([2, 2], &device);
        let adam = || AdamConfig::new().build();
        let slower = ScaledRate {
            inner: adam(),
            share: 0.25,
        };
        let read =
            |(tensor, _): (Tensor<2>, _)| tensor.into_data().iter::<f32>().collect::<Vec<_>>();
        let found = read(slower.step(0.2, start.clone(), gradient.clone(), None));
        // The first step of Adam is the sign of the gradient times the rate.
        for (found, sign) in found.iter().zip([-1.0, 1.0, -1.0, -1.0]) {
            assert!((found - 0.05 * sign).abs() < 1e-4, "{found}");
        }
    }
}
