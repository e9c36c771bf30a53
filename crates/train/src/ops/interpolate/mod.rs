//! Interpolation of features between pixel centres, as a burn extension operation: fast paths for flex and GPUs, burn's own
//! operations for other backends.

mod autodiff;
#[cfg(feature = "wgpu")]
mod cube;
mod flex;
mod pixels;
#[cfg(test)]
mod tests;

use burn::backend::tensor::{FloatTensor, IntTensor};
use burn::backend::{Backend, Dispatch, TensorMetadata as _, backend_extension};
use burn::tensor::{IndexingUpdateOp, IntDType, Shape, Tensor, TensorData};
pub use lsdc_kernels::gather::BilinearCell;
pub use pixels::{Between, PixelReads, cell};
use std::sync::Arc;

/// Cells of each image of a batch, the same number for each.
pub type BatchCells = Arc<Vec<Vec<BilinearCell>>>;

/// Backends with interpolation; the defaults are the plain reference.
#[backend_extension(
    Autodiff,
    Flex,
    NdArray: cfg(feature = "ndarray"),
    Cube: cfg(feature = "wgpu"),
)]
pub trait InterpolateBackend: Backend {
    /// Returns the weighted sum of four rows of `table [images, rows, channels]` for each cell: `[images * cells, channels]`.
    fn read_between(table: FloatTensor<Self>, cells: BatchCells) -> FloatTensor<Self> {
        reference::<Self>(table, &cells)
    }

    /// Returns the same for pixels: `[images * pixels, channels]`.
    fn read_pixels(table: FloatTensor<Self>, reads: Arc<PixelReads>) -> FloatTensor<Self> {
        Self::read_between(table, reads.cells())
    }
}

/// Gradient of [`InterpolateBackend::read_between`]; the default is the plain reference.
pub trait InterpolateGradients: InterpolateBackend {
    /// Computes the gradient of a table of `shape` (images, rows, channels) from that of the result.
    fn read_between_backward(
        grad: FloatTensor<Self>,
        shape: [usize; 3],
        cells: BatchCells,
    ) -> FloatTensor<Self> {
        reference_backward::<Self>(grad, shape, &cells)
    }

    /// Computes the gradient of a table of `shape` (images, rows, channels) from that of [`InterpolateBackend::read_pixels`].
    fn read_pixels_backward(
        grad: FloatTensor<Self>,
        shape: [usize; 3],
        reads: Arc<PixelReads>,
    ) -> FloatTensor<Self> {
        Self::read_between_backward(grad, shape, reads.cells())
    }
}

/// Computes the forward pass with burn's own operations.
fn reference<B: Backend>(table: FloatTensor<B>, cells: &BatchCells) -> FloatTensor<B> {
    let shape = table.shape();
    let (rows, channels) = (shape[1], shape[2]);
    let table = B::float_reshape(table, Shape::new([shape[0] * rows, channels]));
    let parts = (0..4).map(|k| {
        let (index, share) = corner::<B>(&table, rows, cells, k);
        B::float_mul(B::float_select(table.clone(), 0, index), share)
    });
    parts.reduce(B::float_add).expect("four parts")
}

/// Computes the backward pass with burn's own operations.
fn reference_backward<B: Backend>(
    grad: FloatTensor<B>,
    [images, rows, channels]: [usize; 3],
    cells: &BatchCells,
) -> FloatTensor<B> {
    let shape = Shape::new([images * rows, channels]);
    let zeros = B::float_zeros(shape, &grad.device(), grad.dtype().into());
    let sum = (0..4).fold(zeros, |sum, k| {
        let (index, share) = corner::<B>(&grad, rows, cells, k);
        B::float_select_assign(
            sum,
            0,
            index,
            B::float_mul(grad.clone(), share),
            IndexingUpdateOp::Add,
        )
    });
    B::float_reshape(sum, Shape::new([images, rows, channels]))
}

/// Returns the `k`-th row of each cell, counted over the whole batch, and its share `[cells, 1]`, on the device of `like`.
fn corner<B: Backend>(
    like: &FloatTensor<B>,
    rows: usize,
    cells: &BatchCells,
    k: usize,
) -> (IntTensor<B>, FloatTensor<B>) {
    let device = like.device();
    let of = |image: usize, cell: &BilinearCell| (image * rows + cell.rows[k] as usize) as i32;
    let index: Vec<i32> = cells
        .iter()
        .enumerate()
        .flat_map(|(image, cells)| cells.iter().map(move |cell| of(image, cell)))
        .collect();
    let share: Vec<f32> = cells.iter().flatten().map(|cell| cell.shares[k]).collect();
    let count = index.len();
    let index = B::int_from_data(TensorData::new(index, [count]), &device);
    let share = B::float_from_data(TensorData::new(share, [count, 1]), &device);
    (
        B::int_cast(index, IntDType::I32),
        B::float_cast(share, like.dtype().into()),
    )
}

/// Returns the weighted sum of four rows of `table [images, rows, channels]` for each cell of each image, image by image:
/// `[images * cells, channels]`. Differentiable in `table`.
pub fn interpolate(table: Tensor<3>, cells: Vec<Vec<BilinearCell>>) -> Tensor<2> {
    Tensor::from_dispatch(Dispatch::read_between(
        table.into_dispatch(),
        Arc::new(cells),
    ))
}

/// Returns the values of `maps [images, height, width, channels]` that pixels read, image by image: `[images * pixels,
/// channels]`. Differentiable in `maps`.
pub fn interpolate_pixels(maps: Tensor<4>, reads: PixelReads) -> Tensor<2> {
    let [images, height, width, channels] = maps.dims();
    debug_assert_eq!((images, [height, width]), (reads.images, reads.map));
    let table = maps.reshape([images, height * width, channels]);
    let read = Dispatch::read_pixels(table.into_dispatch(), Arc::new(reads));
    Tensor::from_dispatch(read)
}
