//! Flex tensors in, flex tensors out: f32 goes to the kernels, other types to burn.

use super::gemm::{self, Shape};
use super::{ConvBackend, ConvSpec};
use burn::backend::ops::ModuleOps as _;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Flex, TensorMetadata as _};
use burn::tensor::{DType, TensorData};
use burn_flex::FlexTensor;

impl ConvBackend for Flex {
    fn conv(x: FloatTensor<Self>, weight: FloatTensor<Self>, spec: ConvSpec) -> FloatTensor<Self> {
        let (x, weight) = (x.to_contiguous(), weight.to_contiguous());
        let shape = Shape::new(&dims(&x), &dims(&weight), spec);
        match (x.as_slice::<f32>(), weight.as_slice::<f32>()) {
            (Some(xs), Some(ws)) if is_f32(&x) && is_f32(&weight) => {
                tensor(gemm::forward(xs, ws, shape), shape.output())
            }
            _ => Self::conv2d(x, weight, None, spec.options()),
        }
    }

    fn conv_backward_input(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvSpec,
    ) -> FloatTensor<Self> {
        let (weight, grad) = (weight.to_contiguous(), grad.to_contiguous());
        let shape = Shape::new(&dims(&x), &dims(&weight), spec);
        match (weight.as_slice::<f32>(), grad.as_slice::<f32>()) {
            (Some(ws), Some(gs)) if is_f32(&weight) && is_f32(&grad) => {
                tensor(gemm::backward_input(ws, gs, shape), shape.input())
            }
            _ => Self::conv2d_x_backward(x, weight, grad, spec.options()),
        }
    }

    fn conv_backward_weight(
        x: FloatTensor<Self>,
        weight: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        spec: ConvSpec,
    ) -> FloatTensor<Self> {
        let (x, grad) = (x.to_contiguous(), grad.to_contiguous());
        let shape = Shape::new(&dims(&x), &dims(&weight), spec);
        match (x.as_slice::<f32>(), grad.as_slice::<f32>()) {
            (Some(xs), Some(gs)) if is_f32(&x) && is_f32(&grad) => {
                tensor(gemm::backward_weight(xs, gs, shape), shape.weight())
            }
            _ => Self::conv2d_weight_backward(x, weight, grad, spec.options()),
        }
    }
}

fn is_f32(tensor: &FlexTensor) -> bool {
    tensor.dtype() == DType::F32
}

fn dims(tensor: &FlexTensor) -> [usize; 4] {
    let shape = tensor.shape();
    std::array::from_fn(|i| shape[i])
}

fn tensor(values: Vec<f32>, shape: [usize; 4]) -> FlexTensor {
    FlexTensor::from_data(TensorData::new(values, shape))
}
