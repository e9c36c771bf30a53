//! The op on flex: one pass over memory forward, two backward, with all threads.

use super::layout::{Layout, Line};
use super::{NormBackend, NormSpec, reference_backward, reference_moments};
use burn::backend::ops::{ActivationOps as _, ModuleOps as _};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Flex, TensorMetadata as _};
use burn::tensor::{DType, TensorData};
use burn_flex::FlexTensor;

impl NormBackend for Flex {
    fn moments(x: FloatTensor<Self>) -> (FloatTensor<Self>, FloatTensor<Self>) {
        if x.dtype() != DType::F32 {
            return reference_moments::<Self>(x);
        }
        let x = x.to_contiguous();
        let (mean, variance) = Layout::of(&x.shape()).moments(x.storage::<f32>());
        let channels = vec![mean.len()];
        (tensor(mean, channels.clone()), tensor(variance, channels))
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
            let output = Self::batch_norm(x, gain, shift, mean, variance, spec.epsilon);
            return if spec.relu {
                Self::relu(output)
            } else {
                output
            };
        }
        let [x, gain, shift, mean, variance] =
            [x, gain, shift, mean, variance].map(|t| t.to_contiguous());
        let lines = Line::of(
            gain.storage(),
            shift.storage(),
            mean.storage(),
            variance.storage(),
            spec.epsilon,
        );
        let floor = floor(spec);
        let values = x.storage::<f32>();
        let output =
            Layout::of(&x.shape()).map(values, values, |c, x, _| lines[c].at(x).max(floor));
        tensor(output, x.shape().to_vec())
    }

    fn normalise_backward(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: NormSpec,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        if x.dtype() != DType::F32 {
            return reference_backward::<Self>(x, gain, shift, mean, variance, grad, spec);
        }
        let [x, gain, shift, mean, variance, grad] =
            [x, gain, shift, mean, variance, grad].map(|t| t.to_contiguous());
        let layout = Layout::of(&x.shape());
        let (values, grads) = (x.storage::<f32>(), grad.storage::<f32>());
        let (mean, variance) = (mean.storage::<f32>(), variance.storage::<f32>());
        let lines = Line::of(
            gain.storage(),
            shift.storage(),
            mean,
            variance,
            spec.epsilon,
        );
        let ones = vec![1.0; mean.len()];
        let zeros = vec![0.0; mean.len()];
        let standard = Line::of(&ones, &zeros, mean, variance, spec.epsilon);
        let floor = floor(spec);
        let passed = |c: usize, x: f32, g: f32| if lines[c].at(x) > floor { g } else { 0.0 };
        let (shift_grad, gain_grad) = layout.sums(values, grads, |c, x, g| {
            let g = passed(c, x, g);
            (g, g * standard[c].at(x))
        });
        let input_grad = if spec.own {
            let count = layout.count() as f32;
            layout.map(values, grads, |c, x, g| {
                let common = shift_grad[c] + standard[c].at(x) * gain_grad[c];
                lines[c].slope * (passed(c, x, g) - common / count)
            })
        } else {
            layout.map(values, grads, |c, x, g| lines[c].slope * passed(c, x, g))
        };
        let channels = vec![mean.len()];
        (
            tensor(input_grad, x.shape().to_vec()),
            tensor(gain_grad, channels.clone()),
            tensor(shift_grad, channels),
        )
    }
}

/// Outputs are at least this.
fn floor(spec: NormSpec) -> f32 {
    if spec.relu { 0.0 } else { f32::NEG_INFINITY }
}

fn tensor(values: Vec<f32>, shape: Vec<usize>) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}
