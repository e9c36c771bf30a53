//! One-sided Jacobi method on the rows of R: singular values, right singular vectors, and the truncated solution (Hestenes
//! 1958; round-robin order of Brent and Luk 1985).

use super::UNITS;
use burn_cubecl::cubecl::{self, prelude::*};

/// Runs steps `first..last` of a sweep over `r [batch, k, k + 1]`: rotates pairs of rows, including the last column, until they
/// are orthogonal. Batches that are `done` are skipped. `lanes` units work on a pair.
#[cube(launch)]
pub(super) fn rotate(r: &mut [f32], done: &[f32], k: u32, lanes: u32, first: u32, last: u32) {
    let k = k as usize;
    let lanes = lanes as usize;
    let first = first as usize;
    let last = last as usize;
    let width = k + 1;
    let batch = CUBE_POS_X as usize;
    let base = batch * k * width;
    let unit = UNIT_POS_X as usize;
    let slots = UNITS / lanes;
    let slot = unit / lanes;
    let lane = unit % lanes;
    // An even number of players of the round robin, one of which may be a bye.
    let players = k + k % 2;
    let rounds = (players / 2).div_ceil(slots);
    let mut shared = Shared::<[f32]>::new_slice(3 * UNITS);
    if done[batch] == 0.0f32 {
        for step in first..last {
            for round in 0..rounds {
                let pair = round * slots + slot;
                let mut p = (step + pair) % (players - 1);
                let mut q = (step + players - 1 - pair % (players - 1)) % (players - 1);
                if pair == 0 {
                    p = step;
                    q = players - 1;
                }
                let live = slot < slots && pair < players / 2 && p < k && q < k;
                let mut a = 0.0f32;
                let mut b = 0.0f32;
                let mut g = 0.0f32;
                if live {
                    let mut c = lane;
                    while c < k {
                        let x = r[base + p * width + c];
                        let y = r[base + q * width + c];
                        a += x * x;
                        b += y * y;
                        g += x * y;
                        c += lanes;
                    }
                }
                shared[unit] = a;
                shared[unit + UNITS] = b;
                shared[unit + 2 * UNITS] = g;
                sync_cube();
                if live {
                    let mut a = 0.0f32;
                    let mut b = 0.0f32;
                    let mut g = 0.0f32;
                    for l in 0..lanes {
                        a += shared[slot * lanes + l];
                        b += shared[slot * lanes + l + UNITS];
                        g += shared[slot * lanes + l + 2 * UNITS];
                    }
                    if g.abs() > 1.0e-8f32 * (a.sqrt() * b.sqrt()) {
                        let zeta = (b - a) / (2.0f32 * g);
                        let size = zeta.abs();
                        let mut tangent = 0.5f32 / size;
                        if size < 1.0e8f32 {
                            tangent = 1.0f32 / (size + (1.0f32 + size * size).sqrt());
                        }
                        if zeta < 0.0f32 {
                            tangent = -tangent;
                        }
                        let cosine = 1.0f32 / (1.0f32 + tangent * tangent).sqrt();
                        let sine = cosine * tangent;
                        let mut c = lane;
                        while c < width {
                            let x = r[base + p * width + c];
                            let y = r[base + q * width + c];
                            r[base + p * width + c] = cosine * x - sine * y;
                            r[base + q * width + c] = sine * x + cosine * y;
                            c += lanes;
                        }
                    }
                }
                sync_storage();
            }
        }
    }
}

/// Computes, from orthogonal rows `s_i v_i` with `u_i . d` as their last column, the truncated solution `x [batch, k]` and the
/// columns `v_i / s_i` of `factor [batch, k, k]`, 0 where `s_i` is at most `rcond` times the largest. Batches that are `done`
/// are skipped.
#[cube(launch)]
pub(super) fn truncate(
    r: &[f32],
    done: &[f32],
    x: &mut [f32],
    factor: &mut [f32],
    k: u32,
    rcond: f32,
) {
    let k = k as usize;
    let width = k + 1;
    let batch = CUBE_POS_X as usize;
    let base = batch * k * width;
    let out = batch * k * k;
    let unit = UNIT_POS_X as usize;
    let mut shared = Shared::<[f32]>::new_slice(UNITS);
    if done[batch] == 0.0f32 {
        let mut largest = 0.0f32;
        let mut i = unit;
        while i < k {
            let mut square = 0.0f32;
            for c in 0..k {
                let v = r[base + i * width + c];
                square += v * v;
            }
            if square > largest {
                largest = square;
            }
            i += UNITS;
        }
        shared[unit] = largest;
        sync_cube();
        let mut stride = CUBE_DIM_X as usize / 2;
        while stride > 0 {
            if unit < stride {
                let other = shared[unit + stride];
                if other > shared[unit] {
                    shared[unit] = other;
                }
            }
            sync_cube();
            stride /= 2;
        }
        let limit = rcond * shared[0].sqrt();
        let mut i = unit;
        while i < k {
            let mut square = 0.0f32;
            for c in 0..k {
                let v = r[base + i * width + c];
                square += v * v;
            }
            let mut over = 0.0f32;
            if square > 0.0f32 && square.sqrt() > limit {
                over = 1.0f32 / square;
            }
            for c in 0..k {
                factor[out + c * k + i] = r[base + i * width + c] * over;
            }
            i += UNITS;
        }
        sync_storage();
        let mut c = unit;
        while c < k {
            let mut sum = 0.0f32;
            for i in 0..k {
                sum += factor[out + c * k + i] * r[base + i * width + k];
            }
            x[batch * k + c] = sum;
            c += UNITS;
        }
    }
}
