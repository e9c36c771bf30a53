//! The operation on flex. A normalisation with fixed statistics is a slope s and an offset per output, so the outputs are those
//! of a convolution with weights s W and a bias, and the gradients are those of this convolution.

use super::{ConvNormBackend, ConvNormGradients, ConvNormSpec, reference, reference_backward};
use crate::ops::conv::{self, ConvGradients as _};
use crate::ops::norm::vector;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Flex, TensorMetadata as _};
use burn::tensor::{DType, TensorData};
use burn_flex::FlexTensor;
use lsdc_kernels::norm::{ChannelAffine, relu_gradient, row_sums};

/// Multiplies weights `[outputs, ..]` by the slope of each output.
fn folded(weight: &FlexTensor, slopes: &[f32]) -> FlexTensor {
    let values = weight.storage::<f32>();
    let size = values.len() / slopes.len().max(1);
    let mut folded = Vec::with_capacity(values.len());
    for (row, s) in values.chunks_exact(size.max(1)).zip(slopes) {
        folded.extend(row.iter().map(|v| v * s));
    }
    FlexTensor::from_data(TensorData::new(folded, weight.shape().to_vec()))
}

impl ConvNormBackend for Flex {
    fn conv_norm(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        spec: ConvNormSpec,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        if x.dtype() != DType::F32 {
            return reference::<Self>(x, weight, gain, shift, mean, variance, spec);
        }
        let [x, weight, gain, shift, mean, variance] =
            [x, weight, gain, shift, mean, variance].map(|t| t.to_contiguous());
        let (gain, shift) = (gain.storage(), shift.storage());
        let (mean, variance) = (mean.storage(), variance.storage());
        let affine = ChannelAffine::new(gain, shift, mean, variance, spec.epsilon);
        let weight = folded(&weight, affine.slopes());
        let output = conv::biased(&x, &weight, affine.offsets(), spec.relu, spec.conv);
        (output.clone(), output)
    }
}

impl ConvNormGradients for Flex {
    fn conv_norm_backward(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        shift: FloatTensor<Self>,
        mean: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        output: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvNormSpec,
    ) -> [FloatTensor<Self>; 4] {
        if x.dtype() != DType::F32 {
            return reference_backward::<Self>(
                x, weight, gain, shift, mean, variance, output, grad, spec,
            );
        }
        let [weight, gain, mean, variance, output, grad] =
            [weight, gain, mean, variance, output, grad].map(|t| t.to_contiguous());
        let channels = gain.storage::<f32>().len();
        let (grad, sums) = if spec.relu {
            let (values, sums) = relu_gradient(output.storage(), grad.storage(), channels);
            let values = TensorData::new(values, grad.shape().to_vec());
            (FlexTensor::from_data(values), sums)
        } else {
            let sums = row_sums(grad.storage(), channels);
            (grad, sums)
        };
        // y = s W x + (shift - s mean), s = gain / deviation.
        let of_folded = Self::conv_backward_weight(x, weight.clone(), grad.clone(), spec.conv);
        let means = mean.storage::<f32>();
        let standard = ChannelAffine::standard(means, variance.storage(), spec.epsilon);
        let (weights, products) = (weight.storage::<f32>(), of_folded.storage::<f32>());
        let size = weights.len() / channels.max(1);
        let of_gain = |o: usize| {
            let of = o * size..(o + 1) * size;
            let pairs = weights[of.clone()].iter().zip(&products[of]);
            let product: f64 = pairs.map(|(w, g)| f64::from(*w) * f64::from(*g)).sum();
            let slope = product - f64::from(means[o]) * f64::from(sums[o]);
            (slope * f64::from(standard.slopes()[o])) as f32
        };
        let gains = (0..channels).map(of_gain).collect();
        let pairs = gain.storage::<f32>().iter().zip(standard.slopes());
        let slopes: Vec<f32> = pairs.map(|(gain, inverse)| gain * inverse).collect();
        let weight = folded(&of_folded, &slopes);
        [grad, weight, vector(gains), vector(sums)]
    }

    fn conv_norm_backward_input(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        gain: FloatTensor<Self>,
        variance: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvNormSpec,
    ) -> FloatTensor<Self> {
        if x.dtype() != DType::F32 {
            return Self::conv_backward_input(x, weight, grad, spec.conv);
        }
        let [weight, gain, variance] = [weight, gain, variance].map(|t| t.to_contiguous());
        let (gain, variance) = (gain.storage::<f32>(), variance.storage());
        let zeros = vec![0.0; gain.len()];
        let affine = ChannelAffine::new(gain, &zeros, &zeros, variance, spec.epsilon);
        Self::conv_backward_input(x, folded(&weight, affine.slopes()), grad, spec.conv)
    }
}
