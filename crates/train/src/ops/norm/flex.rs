//! The operation on flex with all threads: one pass over memory forward, two backward.

use super::{
    NormBackend, NormGradients, NormSpec, reference, reference_backward, reference_moments,
};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Flex, TensorMetadata as _};
use burn::tensor::{DType, TensorData};
use burn_flex::FlexTensor;
use lsdc_kernels::norm::{self as rows, Backward, ChannelAffine};

impl NormBackend for Flex {
    fn moments(x: FloatTensor<Self>) -> (FloatTensor<Self>, FloatTensor<Self>) {
        if x.dtype() != DType::F32 {
            return reference_moments::<Self>(x);
        }
        let x = x.to_contiguous();
        let (mean, variance) = rows::moments(x.storage(), channels(&x));
        (vector(mean), vector(variance))
    }

    fn normalise(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        spec: NormSpec,
    ) -> FloatTensor<Self> {
        if x.dtype() != DType::F32 {
            return reference::<Self>(x, gain, shift, mean, variance, spec);
        }
        let [x, gain, shift, mean, variance] =
            [x, gain, shift, mean, variance].map(|t| t.to_contiguous());
        let (gain, shift) = (gain.storage(), shift.storage());
        let (mean, variance) = (mean.storage(), variance.storage());
        let affine = ChannelAffine::new(gain, shift, mean, variance, spec.epsilon);
        let output = rows::normalise(x.storage(), &affine, spec.relu);
        FlexTensor::from_data(TensorData::new(output, x.shape().to_vec()))
    }
}

impl NormGradients for Flex {
    fn normalise_backward(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: NormSpec,
    ) -> [FloatTensor<Self>; 3] {
        if x.dtype() != DType::F32 {
            return reference_backward::<Self>(x, gain, shift, mean, variance, grad, spec);
        }
        let [x, gain, shift, mean, variance, grad] =
            [x, gain, shift, mean, variance, grad].map(|t| t.to_contiguous());
        let (gain, shift) = (gain.storage(), shift.storage());
        let (mean, variance) = (mean.storage::<f32>(), variance.storage());
        let back = Backward {
            affine: &ChannelAffine::new(gain, shift, mean, variance, spec.epsilon),
            standard: &ChannelAffine::standard(mean, variance, spec.epsilon),
            relu: spec.relu,
        };
        let (values, grads) = (x.storage::<f32>(), grad.storage());
        let (gain_grad, shift_grad) = back.parameter_gradients(values, grads);
        let rows = values.len() / channels(&x).max(1);
        let statistics = Backward::through_statistics(&gain_grad, &shift_grad, rows);
        let statistics = spec.own.then_some(&statistics);
        let input_grad = back.input_gradient(values, grads, statistics);
        let x_grad = FlexTensor::from_data(TensorData::new(input_grad, x.shape().to_vec()));
        [x_grad, vector(gain_grad), vector(shift_grad)]
    }
}

fn channels(x: &FlexTensor) -> usize {
    x.shape().last().copied().unwrap_or(1)
}

pub(in crate::ops) fn vector(values: Vec<f32>) -> FlexTensor {
    let length = values.len();
    FlexTensor::from_data(TensorData::new(values, [length]))
}
