//! The operation on flex tensors: f32 uses the kernels, other types use burn.

use super::{ConvBackend, ConvGradients, ConvSpec, reference, reference_input, reference_weight};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Flex, TensorMetadata as _};
use burn::tensor::{DType, TensorData};
use burn_flex::FlexTensor;
use lsdc_kernels::conv::{self, Layer, Shape};
use lsdc_kernels::simd::{Level, Scratch, Tail};
use std::sync::OnceLock;

/// Returns a shared scratch, because operations cannot keep memory between calls.
fn scratch() -> &'static Scratch {
    static SCRATCH: OnceLock<Scratch> = OnceLock::new();
    SCRATCH.get_or_init(Scratch::new)
}

impl ConvBackend for Flex {
    fn conv(x: FloatTensor<Self>, weight: FloatTensor<Self>, spec: ConvSpec) -> FloatTensor<Self> {
        if x.dtype() != DType::F32 {
            return reference::<Self>(x, weight, spec);
        }
        biased(
            &x.to_contiguous(),
            &weight.to_contiguous(),
            &[],
            false,
            spec,
        )
    }
}

impl ConvGradients for Flex {
    fn conv_backward_input(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvSpec,
    ) -> FloatTensor<Self> {
        if x.dtype() != DType::F32 {
            return reference_input::<Self>(x, weight, grad, spec);
        }
        let (weight, grad) = (weight.to_contiguous(), grad.to_contiguous());
        let shape = shape(&x, &weight, spec);
        let (weights, grads) = (weight.storage(), grad.storage());
        let input = conv::input_gradient(Level::here(), weights, grads, &shape, scratch());
        tensor(
            input,
            [shape.batch, shape.height, shape.width, shape.channels],
        )
    }

    fn conv_backward_weight(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvSpec,
    ) -> FloatTensor<Self> {
        if x.dtype() != DType::F32 {
            return reference_weight::<Self>(x, weight, grad, spec);
        }
        let (x, grad) = (x.to_contiguous(), grad.to_contiguous());
        let shape = shape(&x, &weight, spec);
        let (values, grads) = (x.storage(), grad.storage());
        let weights = conv::weight_gradient(Level::here(), values, grads, &shape, scratch());
        FlexTensor::from_data(TensorData::new(weights, weight.shape().to_vec()))
    }
}

/// Convolves contiguous f32 tensors, with a bias (0 if `None`), and a ReLU if `relu`.
pub(in crate::ops) fn biased(
    x: &FlexTensor,
    weight: &FlexTensor,
    bias: &[f32],
    relu: bool,
    spec: ConvSpec,
) -> FlexTensor {
    let shape = shape(x, weight, spec);
    let sizes = [shape.outputs, weight.shape()[1], shape.taps];
    let layer = Layer::new(Level::here(), weight.storage(), sizes, bias, spec);
    let tail = Tail { skip: None, relu };
    let output = layer.output(x.storage(), shape.size(), tail, scratch());
    let (height, width) = shape.out();
    tensor(output, [shape.batch, height, width, shape.outputs])
}

fn shape(x: &FlexTensor, weight: &FlexTensor, spec: ConvSpec) -> Shape {
    let (x, weight) = (x.shape(), weight.shape());
    Shape {
        batch: x[0],
        height: x[1],
        width: x[2],
        channels: x[3],
        outputs: weight[0],
        taps: weight[2],
        spec,
    }
}

fn tensor(values: Vec<f32>, shape: [usize; 4]) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}
