//! The operation on tensors of any backend: reads, solves in f64, and writes back.

use super::problems::{Inner, Problems};
use crate::ops::host::{read, write};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata as _};
use burn::tensor::DType;
use lsdc_core::field::{FieldPrior, Grid};
use lsdc_core::fit::Adjoint;
use rayon::prelude::*;

pub(super) fn forward<B: Backend>(
    bases: FloatTensor<B>,
    depths: FloatTensor<B>,
    draws: FloatTensor<B>,
    affinities: FloatTensor<B>,
    problems: &Problems,
) -> FloatTensor<B> {
    let of = Shapes::<B>::of(&bases, &affinities);
    let values = [bases, depths, draws, affinities].map(read::<B>);
    solve::<B>(values, of, problems)
}

/// Shapes, type and device of the tensors of a batch.
pub(super) struct Shapes<B: Backend> {
    bases: [usize; 3],
    affinities: [usize; 4],
    dtype: DType,
    device: B::Device,
}

impl<B: Backend> Shapes<B> {
    pub(super) fn of(bases: &FloatTensor<B>, affinities: &FloatTensor<B>) -> Self {
        Self {
            bases: bases.shape().dims(),
            affinities: affinities.shape().dims(),
            dtype: bases.dtype(),
            device: bases.device(),
        }
    }
}

/// Solves problems whose values were read, and writes the result to their device.
pub(super) fn solve<B: Backend>(
    [bases, depths, draws, affinities]: [Vec<f64>; 4],
    of: Shapes<B>,
    problems: &Problems,
) -> FloatTensor<B> {
    let Inner {
        pixels,
        config,
        free,
        ..
    } = &*problems.0;
    let [count, points, k] = of.bases;
    let [images, height, width, _] = of.affinities;
    let joins: Vec<[Vec<f64>; 2]> = affinities
        .chunks_exact((2 * height * width).max(1))
        .map(|pairs| [0, 1].map(|way| pairs.iter().skip(way).step_by(2).copied().collect()))
        .collect();
    let grids: Vec<Grid<'_>> = joins
        .iter()
        .map(|[right, down]| Grid {
            height,
            width,
            right,
            down,
            diagonal_regularisation: config.diagonal_regularisation,
        })
        .collect();
    let priors: Vec<Option<FieldPrior>> = grids.par_iter().map(FieldPrior::new).collect();
    let solve = |problem: usize| {
        let image = problem % images;
        let first = problem * points;
        let rows: Vec<usize> = (0..points).filter(|i| draws[first + i] > 0.0).collect();
        let at = &pixels[image];
        let pixels = rows.iter().map(|&i| at[i]).collect();
        let mut values = Vec::with_capacity(rows.len() * (k + 1));
        for i in &rows {
            values.extend_from_slice(&bases[(first + i) * k..][..k]);
            values.push(depths[first + i]);
        }
        let field = (grids[image], priors[image].as_ref());
        Adjoint::solve(field, (rows, points), pixels, values, *config, *free)
    };
    let solved: Vec<Option<Adjoint>> = (0..count).into_par_iter().map(solve).collect();
    let length = k + height * width;
    let mut result = Vec::with_capacity(count * length);
    for solution in &solved {
        match solution {
            Some(solution) => result.extend(solution.solution()),
            None => result.resize(result.len() + length, f64::NAN),
        }
    }
    if let Ok(mut place) = problems.0.solved.lock() {
        *place = solved;
    }
    write::<B>(result, vec![count, length], of.dtype, &of.device)
}

pub(super) fn backward<B: Backend>(
    grad: FloatTensor<B>,
    affinities: FloatTensor<B>,
    problems: &Problems,
) -> [FloatTensor<B>; 2] {
    let (device, dtype) = (affinities.device(), affinities.dtype());
    let [images, height, width, _] = affinities.shape().dims();
    let [count, length] = grad.shape().dims();
    let k = length - height * width;
    let grad = read::<B>(grad);
    let solved = match problems.0.solved.lock() {
        Ok(mut solved) => std::mem::take(&mut *solved),
        Err(_) => Vec::new(),
    };
    let points = problems.0.pixels.first().map_or(0, Vec::len);
    let gradients: Vec<_> = solved
        .par_iter()
        .zip(grad.par_chunks_exact(length))
        .map(|(solution, grad)| Some(solution.as_ref()?.backward(grad, width)))
        .collect();
    let mut bases = vec![0.0; count * points * k];
    let mut joins = vec![0.0; images * height * width * 2];
    let per_image = (2 * height * width).max(1);
    let mut sums: Vec<&mut [f64]> = joins.chunks_exact_mut(per_image).collect();
    for (problem, (solution, found)) in solved.iter().zip(&gradients).enumerate() {
        let rows = &mut bases[problem * points * k..][..points * k];
        let sum = &mut sums[problem % images];
        let (Some(solution), Some(found)) = (solution, found) else {
            rows.fill(f64::NAN);
            continue;
        };
        debug_assert_eq!(solution.candidates, points);
        for (&row, values) in solution.rows.iter().zip(found.bases.chunks_exact(k)) {
            rows[row * k..][..k].copy_from_slice(values);
        }
        sum.iter_mut()
            .zip(&found.affinities)
            .for_each(|(sum, value)| *sum += value);
    }
    [
        write::<B>(bases, vec![count, points, k], dtype, &device),
        write::<B>(joins, vec![images, height, width, 2], dtype, &device),
    ]
}
