//! The inverse of R, and the solution if R is well conditioned.

use super::UNITS;
use burn_cubecl::cubecl::{self, prelude::*};

/// Computes rows `first..last` of the inverse of the upper triangle of `r [batch, k, k + 1]`; the rows below are already
/// computed. Rows with a diagonal of 0 stay 0. Each unit processes its own columns.
#[cube(launch)]
pub(super) fn invert(r: &[f32], inverse: &mut [f32], k: u32, first: u32, last: u32) {
    let k = k as usize;
    let base = CUBE_POS_X as usize * k * (k + 1);
    let out = CUBE_POS_X as usize * k * k;
    let first = first as usize;
    let last = last as usize;
    for step in first..last {
        let i = last - 1 - (step - first);
        let diagonal = r[base + i * (k + 1) + i];
        let mut c = UNIT_POS_X as usize;
        while c < k {
            let mut value = 0.0f32;
            if c >= i && diagonal != 0.0f32 {
                if c == i {
                    value = 1.0f32;
                }
                let end = c + 1;
                for l in i + 1..end {
                    value -= r[base + i * (k + 1) + l] * inverse[out + l * k + c];
                }
                value /= diagonal;
            }
            inverse[out + i * k + c] = value;
            c += UNITS;
        }
    }
}

/// Writes `x = R^-1 c` to `x [batch, k]` and 1 to `done [batch]` if the Frobenius norms of R and its inverse, which bound its
/// condition number, show it to be below `limit`; otherwise writes 0 to `done`.
#[cube(launch)]
pub(super) fn substitute(
    r: &[f32],
    inverse: &[f32],
    x: &mut [f32],
    done: &mut [f32],
    k: u32,
    limit: f32,
) {
    let k = k as usize;
    let batch = CUBE_POS_X as usize;
    let base = batch * k * (k + 1);
    let out = batch * k * k;
    let unit = UNIT_POS_X as usize;
    let mut shared = Shared::<[f32]>::new_slice(3 * UNITS);
    let mut forward = 0.0f32;
    let mut backward = 0.0f32;
    let mut zeros = 0.0f32;
    let mut c = unit;
    while c < k {
        let end = c + 1;
        for i in 0..end {
            let a = r[base + i * (k + 1) + c];
            let b = inverse[out + i * k + c];
            forward += a * a;
            backward += b * b;
        }
        if r[base + c * (k + 1) + c] == 0.0f32 {
            zeros += 1.0f32;
        }
        c += UNITS;
    }
    shared[unit] = forward;
    shared[unit + UNITS] = backward;
    shared[unit + 2 * UNITS] = zeros;
    sync_cube();
    let mut stride = CUBE_DIM_X as usize / 2;
    while stride > 0 {
        if unit < stride {
            let forward = shared[unit + stride];
            shared[unit] += forward;
            let backward = shared[unit + UNITS + stride];
            shared[unit + UNITS] += backward;
            let zeros = shared[unit + 2 * UNITS + stride];
            shared[unit + 2 * UNITS] += zeros;
        }
        sync_cube();
        stride /= 2;
    }
    let condition = shared[0].sqrt() * shared[UNITS].sqrt();
    let mut flag = 0.0f32;
    if condition < limit && shared[2 * UNITS] == 0.0f32 {
        flag = 1.0f32;
        let mut i = unit;
        while i < k {
            let mut sum = 0.0f32;
            for c in i..k {
                sum += inverse[out + i * k + c] * r[base + c * (k + 1) + k];
            }
            x[batch * k + i] = sum;
            i += UNITS;
        }
    }
    if unit == 0 {
        done[batch] = flag;
    }
}
