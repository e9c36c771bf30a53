//! Helpers shared by the GPU kernels.

use super::host::read;
use super::pack::{Layout, pack_parts};
use burn::backend::ops::FloatTensorOps as _;
use burn::tensor::{DType, Shape};
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::prelude::*;
use burn_cubecl::cubecl::{self, calculate_cube_count_elemwise};
use burn_cubecl::ops::numeric::empty_device_contiguous_dtype;
use burn_cubecl::tensor::CubeTensor;

/// Units per cube: the default limit of WebGPU.
pub(super) const UNITS: usize = 256;
/// Largest number of cubes along an axis of a launch: the default limit of WebGPU.
const CUBES: usize = 65_535;

/// Returns an uninitialised contiguous f32 tensor.
pub(super) fn empty(like: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    let (client, device) = (like.client.clone(), like.device.clone());
    empty_device_contiguous_dtype(client, device, shape.into(), DType::F32)
}

/// Returns the number of cubes of [`UNITS`] for this many units.
pub(super) fn cubes(like: &CubeTensor, units: usize) -> CubeCount {
    calculate_cube_count_elemwise(&like.client, units, cube())
}

/// Returns the cubes for `tiles`, numbered by [`tile`], times `y`.
pub(super) fn tiles(tiles: usize, y: usize) -> CubeCount {
    let across = tiles.clamp(1, CUBES);
    CubeCount::Static(across as u32, y as u32, tiles.div_ceil(across) as u32)
}

/// Returns the tile of a cube, which may be beyond the last one of [`tiles`].
#[cube]
pub(super) fn tile() -> usize {
    CUBE_POS_Z as usize * CUBE_COUNT_X as usize + CUBE_POS_X as usize
}

/// Returns the size of a cube of [`UNITS`].
pub(super) fn cube() -> CubeDim {
    CubeDim::new_1d(UNITS as u32)
}

/// Reads tensors in one transfer.
pub(super) fn read_together<const N: usize>(tensors: [CubeTensor; N]) -> [Vec<f64>; N] {
    let mut layout = Layout::default();
    let parts = tensors.map(|tensor| {
        let count = tensor.meta.num_elements();
        layout.push(1, count);
        CubeBackend::float_reshape(tensor, Shape::new([count]))
    });
    let packed = empty(&parts[0], [layout.size()]);
    let values = read::<CubeBackend>(pack_parts::<CubeBackend>(packed, &parts, layout.places()));
    std::array::from_fn(|i| {
        let (start, length) = layout.places()[i];
        values[start..start + length].to_vec()
    })
}

/// Sums `parts [parts, ..shape]` over the first axis.
pub(super) fn sum_of_parts(parts: CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    let result = empty(&parts, shape);
    let count = result.meta.num_elements();
    sum::launch(
        &parts.client,
        cubes(&parts, count),
        cube(),
        parts.clone().into_buffer_arg(),
        result.clone().into_buffer_arg(),
    );
    result
}

#[cube(launch)]
fn sum(parts: &[f32], result: &mut [f32]) {
    let count = result.len();
    if ABSOLUTE_POS < count {
        let mut total = 0.0f32;
        let mut at = ABSOLUTE_POS;
        while at < parts.len() {
            total += parts[at];
            at += count;
        }
        result[ABSOLUTE_POS] = total;
    }
}
