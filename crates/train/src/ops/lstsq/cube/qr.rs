//! Householder QR of one matrix per cube, a panel of columns per launch.

use super::{COLUMNS, UNITS};
use burn_cubecl::cubecl::{self, prelude::*};

/// Factors columns `first..last` of `work [batch, rows, k + 1]` in place: reflectors below the diagonal, and R with `Q^T d` as
/// its last column in `r [batch, k, k + 1]`, whose other rows are unchanged.
///
/// A unit processes every second row of one column at a time: 2 x [`COLUMNS`] units.
#[cube(launch)]
pub(super) fn qr(work: &mut [f32], r: &mut [f32], rows: u32, k: u32, first: u32, last: u32) {
    let rows = rows as usize;
    let k = k as usize;
    let first = first as usize;
    let last = last as usize;
    let width = k + 1;
    let unit = UNIT_POS_X as usize;
    let base = CUBE_POS_X as usize * rows * width;
    let out = CUBE_POS_X as usize * k * width;
    let half = unit / COLUMNS;
    let slot = unit % COLUMNS;
    let mut shared = Shared::<[f32]>::new_slice(UNITS);

    for j in first..last {
        let mut sum = 0.0f32;
        let mut row = j + unit;
        while row < rows {
            let v = work[base + row * width + j];
            sum += v * v;
            row += UNITS;
        }
        shared[unit] = sum;
        sync_cube();
        let mut stride = CUBE_DIM_X as usize / 2;
        while stride > 0 {
            if unit < stride {
                let other = shared[unit + stride];
                shared[unit] += other;
            }
            sync_cube();
            stride /= 2;
        }
        let norm = shared[0].sqrt();
        let head = work[base + j * width + j];
        sync_storage();
        // The reflector is the column minus beta e_j; the sign of beta avoids cancellation.
        let mut beta = norm;
        if head > 0.0f32 {
            beta = -norm;
        }
        let denominator = norm * (norm + head.abs());
        let mut gamma = 0.0f32;
        if denominator > 0.0f32 {
            gamma = 1.0f32 / denominator;
        }
        if unit == 0 {
            work[base + j * width + j] = head - beta;
            r[out + j * width + j] = beta;
        }
        sync_storage();
        let tiles = (width - j - 1).div_ceil(COLUMNS);
        for tile in 0..tiles {
            let c = j + 1 + tile * COLUMNS + slot;
            let mut sum = 0.0f32;
            if c < width {
                let mut row = j + half;
                while row < rows {
                    sum += work[base + row * width + j] * work[base + row * width + c];
                    row += 2;
                }
            }
            shared[unit] = sum;
            sync_cube();
            let along = (shared[slot] + shared[slot + COLUMNS]) * gamma;
            if c < width {
                let mut row = j + half;
                while row < rows {
                    let v = work[base + row * width + j];
                    work[base + row * width + c] -= along * v;
                    row += 2;
                }
                if half == 0 {
                    r[out + j * width + c] = work[base + j * width + c];
                }
            }
            sync_cube();
        }
        sync_storage();
    }
}
