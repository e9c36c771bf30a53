//! The operation against closed forms and central differences.

use super::lstsq;
use burn::tensor::{DType, Device, Tensor, TensorData};
use lsdc_core::fit::Solver;
use lsdc_rng::Rng;

const EXACT: Solver = Solver::Truncated(1e-9);

fn random(count: usize, name: &str) -> Vec<f64> {
    let mut rng = Rng::stream(0, &["lstsq", name]);
    (0..count).map(|_| f64::from(rng.normal())).collect()
}

/// A problem and its gradients, computed with tensors and burn's tape.
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

    /// Returns `sum(direction * x)`, and its gradients by the tape.
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

    /// Checks every gradient against central differences.
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
    // The differences raise the discarded singular value to about 1e-6, far below the cut.
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
