//! Robust least squares as a differentiable operation, for training through the fit.

use super::lstsq::{Factored, lstsq};
use burn::tensor::Tensor;
use lsdc_core::fit::Solver;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Treatment of the weights of points in the gradient.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RobustGradient {
    /// Weights are constants: the gradient is that of the last solve.
    #[default]
    Constant,
    /// The gradient of the Huber estimate, to which reweighting converges, by the implicit function theorem. Exact at
    /// convergence.
    Implicit,
}

/// Settings of reweighted least squares in training (paper Algorithm 2, with Huber weights up to a factor).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Reweighting {
    /// Threshold relative to the mean depth; smaller residuals have equal weights.
    pub threshold: f64,
    /// Number of solves after the first.
    pub iterations: usize,
    /// Treatment of the weights in the gradient.
    pub gradient: RobustGradient,
}

impl Default for Reweighting {
    fn default() -> Self {
        Self {
            threshold: 0.02,
            iterations: 5,
            gradient: RobustGradient::Constant,
        }
    }
}

impl Reweighting {
    /// Checks every setting.
    ///
    /// # Errors
    /// The threshold is not positive.
    pub fn check(&self) -> Result<()> {
        if self.threshold > 0.0 && self.threshold.is_finite() {
            return Ok(());
        }
        Err(Error::config("`train.robust.threshold` must be above 0"))
    }
}

/// Minimises Huber's loss of `depths - bases . x`. Returns the solution `[batch, k]` and the weights `[batch, points]` of the
/// last solve, at most 1.
///
/// `bases [batch, points, k]`, `depths [batch, points]`, `mask [batch, points]` with 1 for points and 0 for padding.
/// Differentiable in `bases` and `depths`; the threshold is treated as a constant.
pub fn reweighted(
    bases: Tensor<3>,
    depths: Tensor<2>,
    mask: Tensor<2>,
    solver: Solver,
    settings: Reweighting,
) -> (Tensor<2>, Tensor<2>) {
    let [batch, points, _] = bases.dims();
    let (rows, values) = (bases.clone().detach(), depths.clone().detach());
    let count = mask.clone().sum_dim(1).clamp_min(1.0);
    let mean = (values.clone() * mask.clone()).sum_dim(1) / count;
    let threshold = mean * settings.threshold;
    let residuals = |bases: Tensor<3>, depths: Tensor<2>, x: Tensor<2>| {
        let [_, k] = x.dims();
        depths
            - bases
                .matmul(x.reshape([batch, k, 1]))
                .reshape([batch, points])
    };
    let weights_of = |x: Tensor<2>| {
        let size = residuals(rows.clone(), values.clone(), x).abs();
        let limit = threshold.clone().expand([batch, points]);
        // With a threshold of 0, points with a residual of 0 still count.
        mask.clone() * (limit.clone() / size.max_pair(limit).clamp_min(1e-30)).clamp_max(1.0)
    };
    let mut weights = mask.clone();
    for _ in 0..settings.iterations {
        let x = lstsq(rows.clone(), values.clone(), weights, solver).detach();
        weights = weights_of(x);
    }
    match settings.gradient {
        RobustGradient::Constant => (lstsq(bases, depths, weights.clone(), solver), weights),
        RobustGradient::Implicit => {
            let x = lstsq(rows.clone(), values.clone(), weights.clone(), solver).detach();
            // psi(r) is r within the threshold and constant outside. F^T psi(r) - mu x = 0 at the minimum; its derivative in x
            // is -(F^T psi' F + mu). Weights are exactly 1 within the threshold.
            let inside = weights.clone().floor();
            let residual = residuals(bases.clone(), depths, x.clone());
            let outside = residual.clone().detach() * weights.clone() * (mask - inside.clone());
            let psi = residual * inside.clone() + outside;
            let k = x.dims()[1];
            let pull = bases
                .swap_dims(1, 2)
                .matmul(psi.reshape([batch, points, 1]));
            let pull = pull.clone() - pull.detach();
            let factor = Factored::new(rows, values, inside, solver).factor.detach();
            let along = factor.clone().swap_dims(1, 2).matmul(pull);
            let step = factor.matmul(along).reshape([batch, k]);
            (x + step, weights)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{DType, Device, TensorData};
    use lsdc_rng::Rng;

    const SHAPE: [usize; 3] = [2, 40, 4];

    fn data(values: &[f64], shape: &[usize]) -> TensorData {
        TensorData::new(values.to_vec(), shape.to_vec())
    }

    struct Case {
        bases: Vec<f64>,
        depths: Vec<f64>,
    }

    impl Case {
        /// A plane with small noise, and a gross error at every fifth point.
        fn new() -> Self {
            let [b, n, k] = SHAPE;
            let mut rng = Rng::stream(4, &["reweighted"]);
            let mut bases: Vec<f64> = (0..b * n * k).map(|_| f64::from(rng.normal())).collect();
            bases.chunks_exact_mut(k).for_each(|row| row[0] = 1.0);
            let depths = bases.chunks_exact(k).enumerate().map(|(i, row)| {
                let plane = 5.0 + row[1] - 0.5 * row[2] + 0.1 * row[3];
                let gross = if i % 5 == 0 { 2.0 } else { 0.0 };
                plane + gross + 0.1 * f64::from(rng.normal())
            });
            Self {
                depths: depths.collect(),
                bases,
            }
        }

        /// Returns `sum(direction * x)` and its gradients; the last image has 5 rows of padding.
        fn loss(&self, settings: Reweighting) -> (f64, Vec<f64>, Vec<f64>) {
            let [b, n, k] = SHAPE;
            let device = Device::flex().autodiff();
            let options = (&device, DType::F64);
            let bases = Tensor::<3>::from_data(data(&self.bases, &SHAPE), options).require_grad();
            let depths =
                Tensor::<2>::from_data(data(&self.depths, &[b, n]), options).require_grad();
            let mask: Vec<f64> = (0..b * n).map(|i| f64::from(i < b * n - 5)).collect();
            let mask = Tensor::<2>::from_data(data(&mask, &[b, n]), options);
            let direction: Vec<f64> = (0..b * k).map(|i| (i as f64).sin() + 0.3).collect();
            let direction = Tensor::<2>::from_data(data(&direction, &[b, k]), options);
            let solver = Solver::Truncated(1e-9);
            let (x, _) = reweighted(bases.clone(), depths.clone(), mask, solver, settings);
            let loss = (x * direction).sum();
            let value = loss.clone().into_scalar::<f64>();
            let gradients = loss.backward();
            let read = |data: TensorData| data.iter::<f64>().collect::<Vec<_>>();
            (
                value,
                read(bases.grad(&gradients).unwrap().into_data()),
                read(depths.grad(&gradients).unwrap().into_data()),
            )
        }
    }

    const CONVERGED: Reweighting = Reweighting {
        threshold: 0.02,
        iterations: 300,
        gradient: RobustGradient::Implicit,
    };

    #[test]
    fn the_implicit_gradient_is_that_of_the_converged_estimate() {
        let case = Case::new();
        let (_, bases, depths) = case.loss(CONVERGED);
        let step = 1e-5;
        let scale = bases.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        for i in (0..bases.len()).step_by(7) {
            let moved = |h: f64| {
                let mut bases = case.bases.clone();
                bases[i] += h;
                let depths = case.depths.clone();
                Case { bases, depths }.loss(CONVERGED).0
            };
            let numeric = (moved(step) - moved(-step)) / (2.0 * step);
            assert!(
                (numeric - bases[i]).abs() < 1e-4 * scale,
                "{i}: {numeric} {}",
                bases[i]
            );
        }
        let scale = depths.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        for i in (0..70).step_by(3) {
            // Two depths are changed in opposite directions, so that the threshold is constant.
            let other = if i < 40 {
                (i + 11) % 40
            } else {
                40 + (i + 11) % 35
            };
            let moved = |h: f64| {
                let mut depths = case.depths.clone();
                depths[i] += h;
                depths[other] -= h;
                let bases = case.bases.clone();
                Case { bases, depths }.loss(CONVERGED).0
            };
            let numeric = (moved(step) - moved(-step)) / (2.0 * step);
            let found = depths[i] - depths[other];
            assert!(
                (numeric - found).abs() < 1e-4 * scale,
                "{i}: {numeric} {found}"
            );
        }
    }

    #[test]
    fn constant_weights_have_the_same_values_and_nearly_the_same_gradient() {
        let case = Case::new();
        // Three standard deviations of the noise, 0.3 m.
        let implicit = Reweighting {
            threshold: 0.06,
            ..CONVERGED
        };
        let constant = Reweighting {
            gradient: RobustGradient::Constant,
            ..implicit
        };
        let (value, bases, depths) = case.loss(constant);
        let (exact, exact_bases, exact_depths) = case.loss(implicit);
        assert!((value - exact).abs() < 1e-9 * exact.abs());
        let cosine = |a: &[f64], b: &[f64]| {
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
        };
        assert!(cosine(&bases, &exact_bases) > 0.97);
        assert!(cosine(&depths, &exact_depths) > 0.97);
        // Padding has no effect.
        assert_eq!(depths[75..], [0.0; 5]);
        assert_eq!(exact_depths[75..], [0.0; 5]);
    }

    #[test]
    fn gross_errors_weigh_little() {
        let case = Case::new();
        let [b, n, _] = SHAPE;
        let device = Device::flex();
        let options = (&device, DType::F64);
        let (x, weights) = reweighted(
            Tensor::from_data(data(&case.bases, &SHAPE), options),
            Tensor::from_data(data(&case.depths, &[b, n]), options),
            Tensor::ones([b, n], options),
            Solver::Truncated(1e-9),
            CONVERGED,
        );
        let x: Vec<f64> = x.into_data().iter::<f64>().collect();
        for (found, expected) in x.iter().zip([5.0, 1.0, -0.5, 0.1, 5.0, 1.0, -0.5, 0.1]) {
            assert!((found - expected).abs() < 0.15, "{x:?}");
        }
        let weights: Vec<f64> = weights.into_data().iter::<f64>().collect();
        assert!(weights.iter().step_by(5).all(|w| *w < 0.1));
    }
}
