//! The least-squares kernels against the CPU in f64.

use crate::{gpu, off};
use burn::tensor::{DType, Device, Tensor, TensorData};
use lsdc_core::fit::Solver;
use lsdc_rng::Rng;
use lsdc_train::ops::{Factored, lstsq};

/// A batch of problems with values representable in f32.
struct Batch {
    shape: [usize; 3],
    bases: Vec<f64>,
    depths: Vec<f64>,
    weights: Vec<f64>,
    grad: Vec<f64>,
}

/// The solution, and the gradients of bases and depths.
struct Answer {
    solution: Vec<f64>,
    bases: Vec<f64>,
    depths: Vec<f64>,
    ranks: Vec<usize>,
}

impl Batch {
    /// Creates problems with columns that decrease by `condition` from the first to the last; a fifth of the rows of the second
    /// problem is padding.
    fn new(shape: [usize; 3], condition: f32) -> Self {
        let [b, n, k] = shape;
        let mut rng = Rng::stream(1, &["gpu"]);
        let mut draw =
            |count: usize| -> Vec<f64> { (0..count).map(|_| f64::from(rng.normal())).collect() };
        let mut bases = draw(b * n * k);
        for row in bases.chunks_exact_mut(k) {
            for (j, v) in row.iter_mut().enumerate() {
                let fall = condition.powf(-(j as f32) / (k.max(2) - 1) as f32);
                *v = f64::from(*v as f32 * fall);
            }
            row[0] = 1.0;
        }
        let weight = |i: usize| {
            if i >= n && i % n >= n - n / 5 {
                0.0
            } else {
                1.0
            }
        };
        Self {
            shape,
            bases,
            depths: draw(b * n),
            weights: (0..b * n).map(weight).collect(),
            grad: draw(b * k),
        }
    }

    fn run(&self, device: &Device, dtype: DType, solver: Solver) -> Answer {
        let [b, n, k] = self.shape;
        let device = device.clone().autodiff();
        let data = |v: &[f64], s: &[usize]| TensorData::new(v.to_vec(), s.to_vec());
        let options = (&device, dtype);
        let bases = Tensor::<3>::from_data(data(&self.bases, &[b, n, k]), options).require_grad();
        let depths = Tensor::<2>::from_data(data(&self.depths, &[b, n]), options).require_grad();
        let weights = Tensor::<2>::from_data(data(&self.weights, &[b, n]), options);
        let grad = Tensor::<2>::from_data(data(&self.grad, &[b, k]), options);
        let solution = lstsq(bases.clone(), depths.clone(), weights.clone(), solver);
        let gradients = (solution.clone() * grad).sum().backward();
        let read = |data: TensorData| data.iter::<f64>().collect::<Vec<_>>();
        Answer {
            solution: read(solution.into_data()),
            bases: read(bases.grad(&gradients).unwrap().into_data()),
            depths: read(depths.grad(&gradients).unwrap().into_data()),
            ranks: Factored::new(bases.inner(), depths.inner(), weights.inner(), solver).ranks(),
        }
    }

    /// Returns the values of the fitted functions at every row.
    fn fitted(&self, solution: &[f64]) -> Vec<f64> {
        let [_, n, k] = self.shape;
        let rows = self.bases.chunks_exact(k).enumerate();
        rows.map(|(i, row)| {
            let x = &solution[i / n * k..][..k];
            row.iter().zip(x).map(|(f, x)| f * x).sum()
        })
        .collect()
    }

    /// Compares the GPU in f32 with the CPU in f64: fitted values and gradients, relative to the largest.
    fn check(&self, solver: Solver, tolerance: f64) {
        let Some(gpu) = gpu() else { return };
        let found = self.run(&gpu, DType::F32, solver);
        let expected = self.run(&Device::flex(), DType::F64, solver);
        assert_eq!(found.ranks, expected.ranks, "{:?} {solver:?}", self.shape);
        let fitted = off(
            &self.fitted(&found.solution),
            &self.fitted(&expected.solution),
        );
        let bases = off(&found.bases, &expected.bases);
        let depths = off(&found.depths, &expected.depths);
        let worst = fitted.max(bases).max(depths);
        assert!(
            worst < tolerance,
            "{:?} {solver:?}: fitted {fitted:.1e}, gradient of bases {bases:.1e}, of depths {depths:.1e}",
            self.shape
        );
    }
}

const EXACT: Solver = Solver::Truncated(1.5e-5);

#[test]
fn well_conditioned_problems_agree() {
    Batch::new([2, 40, 7], 1.0).check(EXACT, 1e-5);
    Batch::new([2, 300, 129], 1.0).check(EXACT, 1e-4);
    Batch::new([3, 20, 1], 1.0).check(EXACT, 1e-5);
}

#[test]
fn more_points_than_a_block_holds_agree() {
    Batch::new([2, 1500, 16], 1.0).check(EXACT, 1e-5);
    Batch::new([1, 3000, 33], 10.0).check(Solver::Ridge(1e-4), 1e-4);
}

#[test]
fn a_ridge_agrees() {
    Batch::new([2, 200, 129], 1e3).check(Solver::Ridge(1e-4), 1e-3);
    // Half of the directions are determined by the ridge alone: a condition number of 100, squared in gradients.
    Batch::new([2, 6, 12], 1.0).check(Solver::Ridge(1e-3), 1e-3);
}

#[test]
fn ill_conditioned_problems_agree_as_far_as_f32_goes() {
    // Beyond the limit of the triangular path, and within that of the rank.
    Batch::new([2, 120, 12], 3e3).check(EXACT, 1e-2);
}

#[test]
fn fewer_points_than_functions_agree() {
    Batch::new([2, 10, 17], 1.0).check(EXACT, 1e-4);
    Batch::new([1, 60, 129], 1.0).check(EXACT, 1e-3);
}

#[test]
fn dependent_functions_agree() {
    for k in [6, 33] {
        let mut batch = Batch::new([2, 80, k], 1.0);
        for row in batch.bases.chunks_exact_mut(k) {
            row[k - 1] = row[1];
            row[k - 2] = 2.0 * row[2];
            row[k - 3] = 0.0;
        }
        batch.check(EXACT, 1e-4);
    }
}

#[test]
fn more_functions_than_units_agree() {
    // Several pairs per unit, and several launches.
    let mut batch = Batch::new([1, 700, 530], 1.0);
    for row in batch.bases.chunks_exact_mut(530) {
        row[529] = row[1];
    }
    batch.check(EXACT, 1e-3);
}

#[test]
fn padding_gets_no_gradient() {
    let Some(gpu) = gpu() else { return };
    let batch = Batch::new([2, 50, 5], 1.0);
    let found = batch.run(&gpu, DType::F32, EXACT);
    assert_eq!(found.depths[90..], [0.0; 10]);
    assert_eq!(found.bases[90 * 5..], [0.0; 50]);
}

#[test]
fn random_problems_agree_where_the_rank_is_unambiguous() {
    let Some(gpu) = gpu() else { return };
    // Factor on the number of problems.
    let more: usize = std::env::var("LSDC_PROBLEMS").map_or(1, |n| n.parse().unwrap());
    // Problems of one shape in one launch: columns that decrease to 1e-3, repeated rows, zero rows, columns that repeat or
    // vanish.
    for (seed, shape) in [[200, 30, 6], [200, 5, 9], [100, 90, 20]]
        .into_iter()
        .enumerate()
    {
        let [b, n, k] = [shape[0] * more, shape[1], shape[2]];
        let mut batch = Batch::new([b, n, k], 1.0);
        let mut rng = Rng::stream(seed as u64, &["random"]);
        for image in 0..b {
            let rows = &mut batch.bases[image * n * k..][..n * k];
            let fall = 10.0_f32.powf(-3.0 * rng.unit());
            for (i, v) in rows.iter_mut().enumerate() {
                *v *= f64::from(fall.powf((i % k) as f32 / k as f32));
            }
            match rng.below(5) {
                0 => rows.copy_within(0..n / 2 * k, (n - n / 2) * k),
                1 => rows.chunks_exact_mut(k).for_each(|row| row[k - 1] = row[0]),
                2 => rows.chunks_exact_mut(k).for_each(|row| row[k - 1] = 0.0),
                3 => rows[..n / 2 * k].fill(0.0),
                _ => {}
            }
        }
        for v in &mut batch.bases {
            *v = f64::from(*v as f32);
        }
        let found = batch.run(&gpu, DType::F32, EXACT);
        let expected = batch.run(&Device::flex(), DType::F64, EXACT);
        let (ours, theirs) = (
            batch.fitted(&found.solution),
            batch.fitted(&expected.solution),
        );
        let mut agreeing = 0;
        for image in 0..b {
            let range = image * n..(image + 1) * n;
            if found.ranks[image] == expected.ranks[image] {
                assert!(
                    off(&ours[range.clone()], &theirs[range]) < 2e-3,
                    "{shape:?} {image}"
                );
                agreeing += 1;
            }
        }
        // The others have a singular value near the cut.
        assert!(agreeing * 100 >= b * 98, "{agreeing} of {b}");
        assert!(
            found
                .bases
                .iter()
                .chain(&found.depths)
                .all(|v| v.is_finite())
        );
    }
}
