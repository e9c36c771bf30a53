//! The op on flex: two passes over memory forward, two backward, with all threads.

use super::NormBackend;
use super::layout::{Layout, Line};
use burn::backend::ops::{ActivationOps as _, ModuleOps as _};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Flex, TensorMetadata as _};
use burn::tensor::{DType, TensorData};
use burn_flex::FlexTensor;

impl NormBackend for Flex {
    fn batch_norm_relu(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        epsilon: f64,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        if x.dtype() != DType::F32 {
            let result = Self::batch_norm_train(x, gain, shift, epsilon);
            let output = if relu { Self::relu(result.output) } else { result.output };
            return (output, result.mean, result.variance);
        }
        let (x, gain, shift) = (x.to_contiguous(), gain.to_contiguous(), shift.to_contiguous());
        let layout = Layout::of(&x.shape());
        let values = x.storage::<f32>();
        let (mean, variance) = layout.moments(values);
        let lines = Line::of(gain.storage(), shift.storage(), &mean, &variance, epsilon);
        let floor = if relu { 0.0 } else { f32::NEG_INFINITY };
        let output = layout.map(values, values, |c, x, _| lines[c].at(x).max(floor));
        let channels = vec![mean.len()];
        (
            tensor(output, x.shape().to_vec()),
            tensor(mean, channels.clone()),
            tensor(variance, channels),
        )
    }

    fn batch_norm_relu_backward(
        x: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        epsilon: f64,
        relu: bool,
    ) -> (FloatTensor<Self>, FloatTensor<Self>, FloatTensor<Self>) {
        if x.dtype() != DType::F32 {
            let grad = if relu {
                let output = Self::batch_norm_train(x.clone(), gain.clone(), shift, epsilon).output;
                Self::relu_backward(Self::relu(output), grad)
            } else {
                grad
            };
            let back = Self::batch_norm_train_backward(x, gain, mean, variance, epsilon, grad);
            return (back.x_grad, back.gamma_grad, back.beta_grad);
        }
        let [x, gain, shift, mean, variance, grad] =
            [x, gain, shift, mean, variance, grad].map(|t| t.to_contiguous());
        let layout = Layout::of(&x.shape());
        let (values, grads) = (x.storage::<f32>(), grad.storage::<f32>());
        let (mean, variance) = (mean.storage::<f32>(), variance.storage::<f32>());
        let lines = Line::of(gain.storage(), shift.storage(), mean, variance, epsilon);
        let ones = vec![1.0; mean.len()];
        let zeros = vec![0.0; mean.len()];
        let standard = Line::of(&ones, &zeros, mean, variance, epsilon);
        let floor = if relu { 0.0 } else { f32::NEG_INFINITY };
        let passed = |c: usize, x: f32, g: f32| if lines[c].at(x) > floor { g } else { 0.0 };
        let (shift_grad, gain_grad) = layout.sums(values, grads, |c, x, g| {
            let g = passed(c, x, g);
            (g, g * standard[c].at(x))
        });
        let count = layout.count() as f32;
        let input_grad = layout.map(values, grads, |c, x, g| {
            let common = shift_grad[c] + standard[c].at(x) * gain_grad[c];
            lines[c].slope * (passed(c, x, g) - common / count)
        });
        let channels = vec![mean.len()];
        (
            tensor(input_grad, x.shape().to_vec()),
            tensor(gain_grad, channels.clone()),
            tensor(shift_grad, channels),
        )
    }
}

fn tensor(values: Vec<f32>, shape: Vec<usize>) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}
