//! The operation on GPUs, in f32 on the device: tall-skinny QR (Demmel et al. 2012), then triangular inversion if the condition
//! number allows it, otherwise one-sided Jacobi.

mod jacobi;
mod qr;
mod triangular;

use super::composed;
use super::{LstsqBackend, LstsqGradients, host};
use crate::ops::gpu::{UNITS, cube};
use burn::backend::TensorMetadata as _;
use burn::backend::ops::FloatTensorOps;
use burn::backend::tensor::FloatTensor;
use burn::tensor::{DType, Shape};
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::prelude::CubeCount;
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::ops::numeric::zeros_client;
use burn_cubecl::tensor::CubeTensor;
use lsdc_core::fit::Solver;

/// Columns that the QR processes at once.
const COLUMNS: usize = UNITS / 2;
/// Smallest number of rows of a QR block; more rows are divided among cubes, and the resulting R factors are factored again.
const ROWS: usize = 512;
/// Limit of loop iterations of a unit in one launch: software drivers terminate longer loops early without an error, and
/// watchdogs of hardware drivers may abort them.
const ITERATIONS: usize = 40_000;
/// Number of Jacobi sweeps: 8 suffice for 129 columns, 6 do not.
const SWEEPS: usize = 10;

type Floats = FloatTensor<CubeBackend>;

impl LstsqBackend for CubeBackend {
    fn lstsq_factor(
        bases: Floats,
        depths: Floats,
        weights: Floats,
        solver: Solver,
    ) -> (Floats, Floats) {
        let shape = bases.shape();
        if bases.dtype() != DType::F32 || shape.num_elements() == 0 {
            return host::forward::<Self>(bases, depths, weights, solver);
        }
        solve(
            composed::rows::<Self>(bases, depths, weights, solver),
            solver,
        )
    }
}

impl LstsqGradients for CubeBackend {
    fn lstsq_backward(
        bases: Floats,
        depths: Floats,
        weights: Floats,
        solution: Floats,
        factor: Floats,
        grad: Floats,
        solver: Solver,
    ) -> [Floats; 2] {
        if bases.dtype() != DType::F32 || bases.shape().num_elements() == 0 {
            return host::backward::<Self>(bases, depths, weights, grad, solver);
        }
        composed::backward::<Self>(bases, depths, weights, (solution, factor), grad, solver)
    }
}

/// Returns the solution and factor of `rows [batch, n, k + 1]`: scaled basis functions and depth.
fn solve(rows: Floats, solver: Solver) -> (Floats, Floats) {
    let r = triangle(rows);
    let shape = r.shape();
    let (batch, k) = (shape[0], shape[1]);
    let new = |shape: &[usize]| zeros(&r, shape);
    let (x, factor, done) = (new(&[batch, k]), new(&[batch, k, k]), new(&[batch]));
    let count = CubeCount::Static(batch as u32, 1, 1);
    let units = cube();

    let per_row = k.div_ceil(UNITS) * k;
    let panel = (ITERATIONS / per_row).clamp(1, k);
    for last in (1..=k).rev().step_by(panel) {
        triangular::invert::launch(
            &r.client,
            count.clone(),
            units,
            r.clone().into_buffer_arg(),
            factor.clone().into_buffer_arg(),
            k as u32,
            last.saturating_sub(panel) as u32,
            last as u32,
        );
    }
    let limit = match solver {
        Solver::Ridge(_) => f32::MAX,
        Solver::Truncated(rcond) => 1.0 / rcond as f32,
    };
    triangular::substitute::launch(
        &r.client,
        count.clone(),
        units,
        r.clone().into_buffer_arg(),
        factor.clone().into_buffer_arg(),
        x.clone().into_buffer_arg(),
        done.clone().into_buffer_arg(),
        k as u32,
        limit,
    );
    if let Solver::Truncated(rcond) = solver {
        let players = k + k % 2;
        let lanes = (UNITS / (players / 2)).max(1);
        let rounds = (players / 2).div_ceil(UNITS / lanes);
        let per_step = rounds * (2 * (k + 1).div_ceil(lanes) + lanes);
        let panel = (ITERATIONS / per_step).max(1);
        for _ in 0..SWEEPS {
            for first in (0..players - 1).step_by(panel) {
                jacobi::rotate::launch(
                    &r.client,
                    count.clone(),
                    units,
                    r.clone().into_buffer_arg(),
                    done.clone().into_buffer_arg(),
                    k as u32,
                    lanes as u32,
                    first as u32,
                    (first + panel).min(players - 1) as u32,
                );
            }
        }
        jacobi::truncate::launch(
            &r.client,
            count,
            units,
            r.clone().into_buffer_arg(),
            done.into_buffer_arg(),
            x.clone().into_buffer_arg(),
            factor.clone().into_buffer_arg(),
            k as u32,
            rcond as f32,
        );
    }
    (x, factor)
}

/// Returns R and `Q^T d` `[batch, k, k + 1]` of `rows [batch, n, k + 1]`: factors blocks of rows first, then the R factors of
/// the blocks.
fn triangle(mut rows: Floats) -> Floats {
    loop {
        let shape = rows.shape();
        let (batch, n, width) = (shape[0], shape[1], shape[2]);
        let k = width - 1;
        let blocks = n.div_ceil(ROWS.max(2 * k));
        let height = n.div_ceil(blocks);
        let missing = blocks * height - n;
        if missing > 0 {
            let padding = zeros(&rows, &[batch, missing, width]);
            rows = CubeBackend::float_cat(vec![rows, padding], 1);
        }
        let work = into_contiguous(rows);
        let r = zeros(&work, &[batch, blocks * k, width]);
        let steps = height.min(k);
        let per_column = height.div_ceil(UNITS) + width.div_ceil(COLUMNS) * height;
        let panel = (ITERATIONS / per_column).max(1);
        for first in (0..steps).step_by(panel) {
            qr::qr::launch(
                &work.client,
                CubeCount::Static((batch * blocks) as u32, 1, 1),
                cube(),
                work.clone().into_buffer_arg(),
                r.clone().into_buffer_arg(),
                height as u32,
                k as u32,
                first as u32,
                (first + panel).min(steps) as u32,
            );
        }
        if blocks == 1 {
            return r;
        }
        rows = r;
    }
}

fn zeros(like: &CubeTensor, shape: &[usize]) -> CubeTensor {
    let shape = Shape::from(shape.to_vec());
    zeros_client(like.client.clone(), like.device.clone(), shape, DType::F32)
}
