//! The fast f32 path against burn's own operations in f64, and gradients against differences.

use super::{NEIGHBOURS, propagate};
use burn::tensor::{DType, Device, Tensor, TensorData};
use lsdc_rng::Rng;

fn random(count: usize, name: &str) -> Vec<f64> {
    let mut rng = Rng::stream(0, &["propagate", name]);
    (0..count).map(|_| f64::from(rng.normal())).collect()
}

/// Returns weights, some of them negative, with sums of absolute values below 1; a start; some known pixels.
fn problem(pixels: usize) -> [Vec<f64>; 3] {
    let mut weights = random(NEIGHBOURS * pixels, "weights");
    for of_pixel in weights.chunks_exact_mut(NEIGHBOURS) {
        let sum: f64 = of_pixel.iter().map(|w| w.abs()).sum();
        for weight in of_pixel {
            *weight /= sum;
        }
    }
    let start = random(pixels, "start").iter().map(|d| 3.0 + d).collect();
    let known = random(pixels, "known");
    let known = known.iter().map(|d| if *d > 0.8 { 2.0 + d } else { 0.0 });
    [weights, start, known.collect()]
}

/// Returns the result, and the gradients of its product with a random direction.
fn run(
    [n, height, width]: [usize; 3],
    [weights, start, known]: &[Vec<f64>; 3],
    steps: usize,
    dtype: DType,
) -> [Vec<f64>; 3] {
    let device = Device::flex().autodiff();
    let map = |values: &[f64]| {
        let data = TensorData::new(values.to_vec(), [n, height, width]);
        Tensor::<3>::from_data(data, (&device, dtype))
    };
    let weights = TensorData::new(weights.clone(), [n, height, width, NEIGHBOURS]);
    let weights = Tensor::<4>::from_data(weights, (&device, dtype)).require_grad();
    let start = map(start).require_grad();
    let output = propagate(weights.clone(), start.clone(), map(known), steps);
    let direction = map(&random(n * height * width, "direction"));
    let gradients = (output.clone() * direction).sum().backward();
    let [of_weights, of_start] = [
        weights.grad(&gradients).expect("a gradient").into_data(),
        start.grad(&gradients).expect("a gradient").into_data(),
    ];
    [output.into_data(), of_weights, of_start].map(|data| data.iter::<f64>().collect())
}

#[test]
fn maps_agree_with_burns_own_operations() {
    for (shape, steps) in [
        ([1, 1, 1], 3),
        ([2, 5, 7], 1),
        ([1, 9, 4], 24),
        ([3, 12, 16], 24),
        ([1, 3, 40], 0),
    ] {
        let problem = problem(shape.iter().product());
        let fast = run(shape, &problem, steps, DType::F32);
        let reference = run(shape, &problem, steps, DType::F64);
        for (fast, reference) in fast.iter().zip(&reference) {
            assert_eq!(fast.len(), reference.len());
            for (a, b) in fast.iter().zip(reference) {
                assert!((a - b).abs() < 1e-4 * (1.0 + b.abs()), "{shape:?}: {a} {b}");
            }
        }
    }
}

#[test]
fn gradients_agree_with_central_differences() {
    const STEP: f64 = 1e-5;
    let shape = [1, 6, 5];
    let problem = problem(30);
    let direction = random(30, "direction");
    let value = |problem: &[Vec<f64>; 3]| -> f64 {
        let [output, ..] = run(shape, problem, 7, DType::F64);
        output.iter().zip(&direction).map(|(o, d)| o * d).sum()
    };
    let [_, of_weights, of_start] = run(shape, &problem, 7, DType::F64);
    for (which, gradient) in [(0, &of_weights), (1, &of_start)] {
        for i in (0..gradient.len()).step_by(7) {
            let moved = |by: f64| {
                let mut moved = problem.clone();
                moved[which][i] += by;
                value(&moved)
            };
            let difference = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
            let apart = (difference - gradient[i]).abs();
            assert!(apart < 1e-6 * (1.0 + difference.abs()), "{which} {i}");
        }
    }
}
