//! The operation on tensors of any backend: reads, solves in f64, and writes back.

use crate::ops::host::{read, write};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata as _};
use lsdc_core::fit::{Problem, Solver};
use rayon::prelude::*;

/// The data of a batch of problems.
struct Batch {
    points: usize,
    columns: usize,
    bases: Vec<f64>,
    depths: Vec<f64>,
    weights: Vec<f64>,
}

impl Batch {
    fn problems(&self) -> impl IndexedParallelIterator<Item = Problem> + '_ {
        let (points, columns) = (self.points.max(1), self.columns.max(1));
        self.bases
            .par_chunks(points * columns)
            .zip(self.depths.par_chunks(points))
            .zip(self.weights.par_chunks(points))
            .map(|((bases, depths), weights)| Problem::new(bases, depths, weights))
    }
}

pub(super) fn forward<B: Backend>(
    bases: FloatTensor<B>,
    depths: FloatTensor<B>,
    weights: FloatTensor<B>,
    solver: Solver,
) -> (FloatTensor<B>, FloatTensor<B>) {
    let device = bases.device();
    let (dtype, shape) = (bases.dtype(), bases.shape());
    let batch = read_batch::<B>(bases, depths, weights);
    let columns = batch.columns;
    let (solutions, factors): (Vec<_>, Vec<_>) = batch
        .problems()
        .map(|problem| match problem.solve(solver) {
            Ok(solution) => {
                let factor = &solution.factor;
                let square = (0..columns * columns).map(|at| {
                    let (i, j) = (at / columns, at % columns);
                    if j < factor.ncols() {
                        factor[(i, j)]
                    } else {
                        0.0
                    }
                });
                (solution.weights, square.collect())
            }
            Err(_) => (vec![f64::NAN; columns], vec![f64::NAN; columns * columns]),
        })
        .unzip();
    let (images, columns) = (shape[0], shape[2]);
    let factors: Vec<Vec<f64>> = factors;
    (
        write::<B>(solutions.concat(), vec![images, columns], dtype, &device),
        write::<B>(
            factors.concat(),
            vec![images, columns, columns],
            dtype,
            &device,
        ),
    )
}

pub(super) fn backward<B: Backend>(
    bases: FloatTensor<B>,
    depths: FloatTensor<B>,
    weights: FloatTensor<B>,
    grad: FloatTensor<B>,
    solver: Solver,
) -> [FloatTensor<B>; 2] {
    let device = bases.device();
    let (dtype, shape) = (bases.dtype(), bases.shape());
    let batch = read_batch::<B>(bases, depths, weights);
    let grad = read::<B>(grad);
    let (points, columns) = (batch.points, batch.columns);
    let (bases, depths): (Vec<_>, Vec<_>) = batch
        .problems()
        .zip(grad.par_chunks(columns.max(1)))
        .map(
            |(problem, grad)| match problem.backward(grad, solver, points) {
                Ok(gradients) => gradients,
                Err(_) => (vec![f64::NAN; points * columns], vec![f64::NAN; points]),
            },
        )
        .unzip();
    let depth_shape = vec![shape[0], shape[1]];
    [
        write::<B>(bases.concat(), shape.to_vec(), dtype, &device),
        write::<B>(depths.concat(), depth_shape, dtype, &device),
    ]
}

fn read_batch<B: Backend>(
    bases: FloatTensor<B>,
    depths: FloatTensor<B>,
    weights: FloatTensor<B>,
) -> Batch {
    let shape = bases.shape();
    Batch {
        points: shape[1],
        columns: shape[2],
        bases: read::<B>(bases),
        depths: read::<B>(depths),
        weights: read::<B>(weights),
    }
}
