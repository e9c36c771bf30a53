//! The op against closed forms and central differences.

use super::problem::{divide, times, transposed_times};
use super::{Problem, Solver, lstsq};
use crate::rng::Rng;
use burn::tensor::{DType, Device, Tensor, TensorData};

const EXACT: Solver = Solver::Truncated(1e-9);

fn random(count: usize, name: &str) -> Vec<f64> {
    let mut rng = Rng::stream(0, &["lstsq", name]);
    (0..count).map(|_| f64::from(rng.normal())).collect()
}

/// Gauss-Jordan elimination with pivoting: the plain reference.
fn gauss(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for c in 0..n {
        let pivot = (c..n)
            .max_by(|&i, &j| a[i][c].abs().total_cmp(&a[j][c].abs()))
            .unwrap();
        a.swap(c, pivot);
        b.swap(c, pivot);
        for r in (0..n).filter(|&r| r != c) {
            let factor = a[r][c] / a[c][c];
            let row = a[c].clone();
            a[r].iter_mut().zip(row).for_each(|(x, y)| *x -= factor * y);
            b[r] -= factor * b[c];
        }
    }
    (0..n).map(|i| b[i] / a[i][i]).collect()
}

fn assert_close(a: &[f64], b: &[f64], tolerance: f64) {
    assert_eq!(a.len(), b.len());
    let scale = b.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
    for (x, y) in a.iter().zip(b) {
        assert!((x - y).abs() <= tolerance * scale, "{x} instead of {y}");
    }
}

#[test]
fn full_rank_meets_the_weighted_normal_equations() {
    let (n, k) = (40, 7);
    let (f, d) = (random(n * k, "f"), random(n, "d"));
    let w: Vec<f64> = random(n, "w").iter().map(|v| v.abs()).collect();
    let sum = |g: &dyn Fn(usize) -> f64| (0..n).map(|i| w[i] * g(i)).sum::<f64>();
    let normal = (0..k)
        .map(|a| {
            (0..k)
                .map(|b| sum(&|i| f[i * k + a] * f[i * k + b]))
                .collect()
        })
        .collect();
    let right = (0..k).map(|a| sum(&|i| f[i * k + a] * d[i])).collect();
    let solution = Problem::new(&f, &d, &w).solve(EXACT).unwrap();
    assert_eq!(solution.rank, k);
    assert_close(&solution.weights, &gauss(normal, right), 1e-10);
}

#[test]
fn fewer_points_than_functions_give_the_least_norm() {
    let (n, k) = (5, 9);
    let (f, d) = (random(n * k, "f"), random(n, "d"));
    let gram = (0..n)
        .map(|a| {
            (0..n)
                .map(|b| (0..k).map(|j| f[a * k + j] * f[b * k + j]).sum())
                .collect()
        })
        .collect();
    let dual = gauss(gram, d.clone());
    let expected: Vec<f64> = (0..k)
        .map(|j| (0..n).map(|i| f[i * k + j] * dual[i]).sum())
        .collect();
    let solution = Problem::new(&f, &d, &vec![1.0; n]).solve(EXACT).unwrap();
    assert_eq!(solution.rank, n);
    assert_close(&solution.weights, &expected, 1e-10);
}

#[test]
fn a_repeated_column_shares_its_weight() {
    let (n, k) = (30, 4);
    let mut f = random(n * k, "f");
    for row in f.chunks_exact_mut(k) {
        row[3] = row[2];
    }
    let d = random(n, "d");
    let solution = Problem::new(&f, &d, &vec![1.0; n]).solve(EXACT).unwrap();
    assert_eq!(solution.rank, 3);
    assert!((solution.weights[2] - solution.weights[3]).abs() < 1e-12);
}

#[test]
fn a_small_ridge_changes_little_and_shrinks() {
    let (n, k) = (50, 6);
    let (f, d, w) = (random(n * k, "f"), random(n, "d"), vec![1.0; n]);
    let norm = |solver| {
        let x = Problem::new(&f, &d, &w).solve(solver).unwrap().weights;
        x.iter().map(|v| v * v).sum::<f64>()
    };
    let plain = norm(EXACT);
    assert!((norm(Solver::Ridge(1e-9)) - plain).abs() < 1e-6 * plain);
    assert!(norm(Solver::Ridge(0.1)) < plain);
}

/// A problem with its gradients, through tensors and burn's tape.
struct Case {
    shape: [usize; 3],
    bases: Vec<f64>,
    depths: Vec<f64>,
    weights: Vec<f64>,
    solver: Solver,
}

impl Case {
    fn new(shape: [usize; 3], solver: Solver) -> Self {
        let [b, n, k] = shape;
        Self {
            shape,
            bases: random(b * n * k, "bases"),
            depths: random(b * n, "depths"),
            weights: random(b * n, "weights").iter().map(|v| v.abs()).collect(),
            solver,
        }
    }

    /// `sum(direction * x)`, and its gradients by the tape.
    fn loss(&self, bases: &[f64], depths: &[f64]) -> (f64, Vec<f64>, Vec<f64>) {
        let [b, n, k] = self.shape;
        let device = Device::flex().autodiff();
        let options = (&device, DType::F64);
        let data = |v: &[f64], s: &[usize]| TensorData::new(v.to_vec(), s.to_vec());
        let bases = Tensor::<3>::from_data(data(bases, &[b, n, k]), options).require_grad();
        let depths = Tensor::<2>::from_data(data(depths, &[b, n]), options).require_grad();
        let weights = Tensor::<2>::from_data(data(&self.weights, &[b, n]), options);
        let direction = Tensor::<2>::from_data(data(&random(b * k, "direction"), &[b, k]), options);
        let loss = (lstsq(bases.clone(), depths.clone(), weights, self.solver) * direction).sum();
        let value = loss.clone().into_scalar::<f64>();
        let gradients = loss.backward();
        let read = |data: TensorData| data.iter::<f64>().collect::<Vec<_>>();
        (
            value,
            read(bases.grad(&gradients).unwrap().into_data()),
            read(depths.grad(&gradients).unwrap().into_data()),
        )
    }

    /// Every gradient against central differences.
    fn check(&self) {
        let (_, bases, depths) = self.loss(&self.bases, &self.depths);
        let step = 1e-6;
        let scale = bases
            .iter()
            .chain(&depths)
            .fold(1.0_f64, |m, v| m.max(v.abs()));
        let difference =
            |change: &dyn Fn(f64) -> f64| (change(step) - change(-step)) / (2.0 * step);
        for i in 0..self.bases.len() {
            let numeric = difference(&|h| {
                let mut moved = self.bases.clone();
                moved[i] += h;
                self.loss(&moved, &self.depths).0
            });
            assert!(
                (numeric - bases[i]).abs() < 1e-6 * scale,
                "{numeric} {}",
                bases[i]
            );
        }
        for i in 0..self.depths.len() {
            let numeric = difference(&|h| {
                let mut moved = self.depths.clone();
                moved[i] += h;
                self.loss(&self.bases, &moved).0
            });
            assert!(
                (numeric - depths[i]).abs() < 1e-6 * scale,
                "{numeric} {}",
                depths[i]
            );
        }
    }
}

#[test]
fn gradients_at_full_rank() {
    Case::new([2, 12, 4], EXACT).check();
}

#[test]
fn gradients_with_fewer_points_than_functions() {
    Case::new([2, 4, 7], EXACT).check();
}

#[test]
fn gradients_with_a_ridge() {
    Case::new([2, 12, 4], Solver::Ridge(0.05)).check();
}

#[test]
fn gradients_with_dependent_functions() {
    // The differences push the lost direction up to about 1e-6, far below the cut.
    let mut case = Case::new([1, 12, 5], Solver::Truncated(1e-3));
    for row in case.bases.chunks_exact_mut(5) {
        row[4] = row[1] - 2.0 * row[3];
    }
    case.check();
}

#[test]
fn gradients_across_a_cut_through_the_spectrum() {
    // Discarded directions that are not zero: the cut lies in a wide gap.
    let mut case = Case::new([1, 12, 4], Solver::Truncated(0.2));
    for row in case.bases.chunks_exact_mut(4) {
        row[3] *= 0.05;
    }
    case.check();
}

#[test]
fn padding_gets_no_gradient_and_changes_nothing() {
    let mut case = Case::new([1, 10, 3], EXACT);
    case.weights[7..].fill(0.0);
    let (value, bases, depths) = case.loss(&case.bases, &case.depths);
    assert_eq!(bases[21..], [0.0; 9]);
    assert_eq!(depths[7..], [0.0; 3]);
    let mut other = case.depths.clone();
    other[8] = 1e6;
    assert_eq!(case.loss(&case.bases, &other).0, value);
}

#[test]
fn values_that_are_not_finite_give_nan_not_a_panic() {
    let mut case = Case::new([1, 10, 3], EXACT);
    case.bases[4] = f64::NAN;
    assert!(case.loss(&case.bases, &case.depths).0.is_nan());
}

#[test]
fn the_fast_path_is_taken_only_where_it_is_safe_and_agrees_with_the_decomposition() {
    let (n, k) = (60, 9);
    let (f, d, w) = (random(n * k, "f"), random(n, "d"), vec![1.0; n]);
    // The last column is another one plus a little: singular values from 1 down to `little`.
    let squeezed = |little: f64| {
        let mut f = f.clone();
        for row in f.chunks_exact_mut(k) {
            row[k - 1] = row[0] + little * row[k - 1];
        }
        Problem::new(&f, &d, &w)
    };
    for little in [1.0, 1e-2, 1e-3] {
        let problem = squeezed(little);
        let fast = problem.full_rank(1e-9).unwrap();
        let kept = problem.decompose(1e-9).unwrap();
        let inner = divide(transposed_times(kept.u.as_ref(), &problem.depths), &kept.s);
        assert_close(&fast.weights, &times(kept.v.as_ref(), &inner), 1e-9);
        assert_eq!(fast.rank, k);
    }
    for little in [1e-5, 1e-8, 0.0] {
        assert!(squeezed(little).full_rank(1e-9).is_none());
    }
    assert!(squeezed(1e-2).full_rank(0.1).is_none(), "must be truncated");
    let few = Problem::new(&f[..5 * k], &d[..5], &w[..5]);
    assert!(few.full_rank(1e-9).is_none(), "fewer points than functions");
}

#[test]
fn a_residual_over_one_minus_leverage_is_that_of_the_point_left_out() {
    let (n, k) = (30, 5);
    let (f, d) = (random(n * k, "f"), random(n, "d"));
    let mut w: Vec<f64> = random(n, "w").iter().map(|v| v.abs()).collect();
    w[3] = 0.0;
    let problem = Problem::new(&f, &d, &w);
    let solution = problem.solve(EXACT).unwrap();
    let leverages = solution.leverages(&f, &w);
    let found = super::residuals(&f, &d, &solution.weights);
    assert_eq!(leverages[3], 0.0);
    for i in 0..n {
        let mut without = w.clone();
        without[i] = 0.0;
        let other = Problem::new(&f, &d, &without).solve(EXACT).unwrap();
        let expected = super::residuals(&f, &d, &other.weights)[i];
        assert_close(&[found[i] / (1.0 - leverages[i])], &[expected], 1e-9);
    }
    // They sum to the number of unknowns.
    let sum: f64 = leverages.iter().sum();
    assert!((sum - k as f64).abs() < 1e-9, "{sum}");
}

#[test]
fn leverages_under_a_ridge_are_the_diagonal_of_the_smoother() {
    let (n, k, share) = (12, 4, 0.3);
    let (f, d) = (random(n * k, "f"), random(n, "d"));
    let solver = Solver::Ridge(share);
    let ones = vec![1.0; n];
    let solution = Problem::new(&f, &d, &ones).solve(solver).unwrap();
    let leverages = solution.leverages(&f, &ones);
    // The fit is linear in the depths with the bases fixed: a unit depth at i gives column i.
    for i in 0..n {
        let mut unit = vec![0.0; n];
        unit[i] = 1.0;
        let solution = Problem::new(&f, &unit, &vec![1.0; n])
            .solve(solver)
            .unwrap();
        let fitted = 1.0 - super::residuals(&f, &unit, &solution.weights)[i];
        assert!(
            (fitted - leverages[i]).abs() < 1e-12,
            "{fitted} {}",
            leverages[i]
        );
    }
}
