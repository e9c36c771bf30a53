//! Muon (Jordan et al. 2024) for the weights of convolutions and linear layers: steps along the nearest orthogonal matrix, as
//! large as those of Adam (Liu et al. 2025, arXiv 2502.16982). Weights of any rank are matrices with the first axis as rows;
//! matrices of one shape are multiplied together.

use crate::ops::pack::Layout;
use crate::ops::weighted_sum::weighted_sum;
use burn::tensor::Tensor;
use std::ops::Range;

/// Share of the earlier gradients in the momentum.
const MOMENTUM: f64 = 0.95;
/// Coefficients of the polynomial that is iterated, and the number of iterations (Jordan et al. 2024).
const POLYNOMIAL: [f64; 3] = [3.4445, -4.775, 2.0315];
const ITERATIONS: usize = 5;
/// Least norm of a gradient to divide by.
const LEAST: f64 = 1e-7;

/// Returns rows and columns of weights as a matrix.
pub(super) fn matrix(shape: &[usize]) -> [usize; 2] {
    let rows = shape.first().copied().unwrap_or(1);
    [rows, shape.iter().skip(1).product()]
}

/// Returns runs of weights with equal matrices.
pub(super) fn stacks(shapes: &[Vec<usize>]) -> impl Iterator<Item = Range<usize>> {
    let runs = shapes.chunk_by(|a, b| matrix(a) == matrix(b));
    runs.scan(0, |start, run| {
        let first = *start;
        *start += run.len();
        Some(first..*start)
    })
}

/// Returns the step of all weights; those of one shape are next to each other.
pub(super) fn step(
    moments: &mut [Tensor<1>],
    gradient: Tensor<1>,
    layout: &Layout,
    shapes: &[Vec<usize>],
    rate: f64,
) -> Tensor<1> {
    let [velocity] = moments else {
        return gradient.zeros_like();
    };
    *velocity = weighted_sum(velocity.clone(), MOMENTUM, gradient.clone(), 1.0);
    let ahead = weighted_sum(velocity.clone(), MOMENTUM, gradient, 1.0);
    let mut whole = Layout::default();
    let mut steps = Vec::new();
    for stack in stacks(shapes) {
        let [rows, columns] = matrix(&shapes[stack.start]);
        let (start, _) = layout.places()[stack.start];
        let length = stack.len() * rows * columns;
        let stacked = ahead.clone().slice(start..start + length);
        let direction = orthogonal(stacked.reshape([stack.len(), rows, columns]));
        let rate = rate * 0.2 * (rows.max(columns) as f64).sqrt();
        steps.push((direction * rate).reshape([length]));
        whole.push(1, length);
    }
    whole.pack(&steps)
}

/// Returns nearly orthogonal matrices near `x [count, rows, columns]`: singular vectors stay, and singular values come near 1.
fn orthogonal(x: Tensor<3>) -> Tensor<3> {
    let [_, rows, columns] = x.dims();
    if rows > columns {
        return orthogonal(x.transpose()).transpose();
    }
    let norm = x.clone().square().sum_dim(2).sum_dim(1).sqrt();
    let mut x = x / norm.clamp_min(LEAST);
    let [a, b, c] = POLYNOMIAL;
    for _ in 0..ITERATIONS {
        let square = x.clone().matmul(x.clone().transpose());
        let fourth = square.clone().matmul(square.clone());
        let factor = weighted_sum(square, b, fourth, c);
        x = weighted_sum(x.clone(), a, factor.matmul(x), 1.0);
    }
    x
}
