//! Conversion of tensors of any backend to and from f64 on the host.

use crate::traffic::count_readback;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata as _};
use burn::tensor::{DType, TensorData, try_read_sync};

/// Reads the values of a tensor; NaN, which the caller's checks detect, if the device was lost.
pub(super) fn read<B: Backend>(tensor: FloatTensor<B>) -> Vec<f64> {
    count_readback();
    let count = tensor.shape().num_elements();
    match try_read_sync(B::float_into_data(tensor)) {
        Some(Ok(data)) => data.iter::<f64>().collect(),
        _ => vec![f64::NAN; count],
    }
}

/// Creates a tensor from values.
pub(super) fn write<B: Backend>(
    values: Vec<f64>,
    shape: Vec<usize>,
    dtype: DType,
    device: &B::Device,
) -> FloatTensor<B> {
    B::float_from_data(TensorData::new(values, shape).convert_dtype(dtype), device)
}
