//! What the kernels for GPUs share.

use burn::tensor::{DType, Shape};
use burn_cubecl::cubecl::prelude::*;
use burn_cubecl::cubecl::{self, calculate_cube_count_elemwise};
use burn_cubecl::ops::numeric::empty_device_contiguous_dtype;
use burn_cubecl::tensor::CubeTensor;

/// Units of a cube: what every WebGPU device offers.
pub(super) const UNITS: usize = 256;
/// Cubes in one direction of a launch: likewise.
const CUBES: usize = 65_535;

/// A contiguous tensor of f32 that nothing has been written to.
pub(super) fn empty(like: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    let (client, device) = (like.client.clone(), like.device.clone());
    empty_device_contiguous_dtype(client, device, shape.into(), DType::F32)
}

/// Cubes of [`UNITS`] for as many units.
pub(super) fn cubes(like: &CubeTensor, units: usize) -> CubeCount {
    calculate_cube_count_elemwise(&like.client, units, cube())
}

/// Cubes for `tiles`, of which a kernel numbers its own by [`tile`], times `y`.
pub(super) fn tiles(tiles: usize, y: usize) -> CubeCount {
    let across = tiles.clamp(1, CUBES);
    CubeCount::Static(across as u32, y as u32, tiles.div_ceil(across) as u32)
}

/// The tile of a cube among those of [`tiles`], which may be beyond the last.
#[cube]
pub(super) fn tile() -> usize {
    CUBE_POS_Z as usize * CUBE_COUNT_X as usize + CUBE_POS_X as usize
}

/// A cube of [`UNITS`].
pub(super) fn cube() -> CubeDim {
    CubeDim::new_1d(UNITS as u32)
}

/// The sum of `parts [parts, ..shape]` over the first axis.
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
