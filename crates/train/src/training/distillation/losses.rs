//! Distillation losses apart from depths: affinities, and the span of basis functions.

use crate::model::{BasisNet, HiddenBases, every};
use crate::ops::Factored;
use crate::sample::Batch;
use crate::training::LossConfig;
use burn::tensor::Tensor;
use lsdc_core::fit::Solver;

/// Approximate limit of pixels of an image at which basis functions are compared: neighbours add little information.
const PIXELS: usize = 4096;
/// The ridge of the regression, relative to the mean square of the student's functions.
const RIDGE: f64 = 1e-4;

/// The outputs of a teacher's network for a batch that losses compare with.
#[derive(Clone, Debug)]
pub struct TeacherOutput {
    /// Basis functions at every n-th pixel of the batch, `[images, pixels, N + 1]`, and n.
    functions: Option<(Tensor<3>, usize)>,
    /// Affinities `[images, height, width, 2]`.
    affinities: Option<Tensor<4>>,
}

impl TeacherOutput {
    /// Runs a network for a batch that is on the autodiff version of the network's device.
    pub(crate) fn new(net: &BasisNet, batch: &Batch, config: &LossConfig) -> Self {
        let images = batch.images.clone().inner();
        let encoded = batch.encoded.clone().map(Tensor::inner);
        let functions = (config.teacher_span > 0.0).then(|| {
            let count = batch.pixels.first().map_or(0, Vec::len);
            let step = count.div_ceil(PIXELS).max(1);
            let lists = batch.pixels.iter();
            let some = lists.map(|list| list.iter().copied().step_by(step).collect());
            let bases = net.bases(images.clone(), encoded.clone());
            let values = bases.at(batch.size, &some.collect::<Vec<_>>());
            (Tensor::from_inner(values), step)
        });
        let affinities = (config.teacher_affinities > 0.0)
            .then(|| Tensor::from_inner(net.affinities(images, encoded)));
        Self {
            functions,
            affinities,
        }
    }

    /// Returns the weighted loss of affinities `[images, height, width, 2]`.
    pub(crate) fn affinity_loss(&self, own: &Tensor<4>, config: &LossConfig) -> Option<Tensor<1>> {
        let teacher = self.affinities.clone()?;
        Some(log_ratio_square(own.clone(), teacher) * config.teacher_affinities)
    }

    /// Returns the weighted loss of the basis functions at all pixels of the batch. `depths [images, pixels]` are 0 at pixels
    /// to ignore.
    pub(crate) fn span_loss(
        &self,
        own: &HiddenBases,
        depths: &Tensor<2>,
        config: &LossConfig,
    ) -> Option<Tensor<1>> {
        let (teacher, step) = self.functions.clone()?;
        let own = own.every(step).functions();
        let depths = every(depths.clone(), step);
        Some(span_residual(own, teacher, depths.greater_elem(0.0).float()) * config.teacher_span)
    }
}

/// Returns the mean over pairs of neighbours of `ln(a / b)^2` for affinities a and b `[images, height, width, 2]`.
fn log_ratio_square(a: Tensor<4>, b: Tensor<4>) -> Tensor<1> {
    let [images, height, width, _] = a.dims();
    let squares = (a.log() - b.log()).square();
    // Affinities beyond the border are excluded.
    let right = squares
        .clone()
        .slice([0..images, 0..height, 0..width - 1, 0..1]);
    let down = squares.slice([0..images, 0..height - 1, 0..width, 1..2]);
    let pairs = images * (height * (width - 1) + (height - 1) * width);
    (right.sum() + down.sum()) / pairs.max(1) as f64
}

/// Returns the residual of representing functions T `[images, pixels, n]` by functions S `[images, pixels, k]`, at pixels
/// `[images, pixels]` that are valid (1) or not (0): the mean over images and j of
///
/// > min over w of (|S w - T_j|^2 + r |w|^2) / |T_j|^2,
///
/// where r is [`RIDGE`] times the mean of `|S_i|^2`. From 0, if S spans T, to 1, independent of the scales of the functions of
/// T. Differentiable in S.
fn span_residual(own: Tensor<3>, teacher: Tensor<3>, valid: Tensor<2>) -> Tensor<1> {
    let [images, pixels, count] = own.dims();
    let rows = valid.clone().reshape([images, pixels, 1]);
    let (own, teacher) = (own * rows.clone(), teacher * rows);
    // At the minimum the derivative by the weights is 0, so they are treated as constants.
    let fixed = own.clone().detach();
    let factor = Factored::new(
        fixed.clone(),
        valid.zeros_like(),
        valid,
        Solver::Ridge(RIDGE),
    )
    .factor;
    let right = fixed.swap_dims(1, 2).matmul(teacher.clone());
    let weights = factor.clone().matmul(factor.swap_dims(1, 2).matmul(right));
    let residual = own.clone().matmul(weights.clone()) - teacher.clone();
    let ridge = own.square().sum_dim(2).sum_dim(1) * (RIDGE / count as f64);
    let left = residual.square().sum_dim(1) + weights.square().sum_dim(1) * ridge;
    // Functions that are 0 everywhere have a residual of 0.
    let all = teacher.square().sum_dim(1).clamp_min(1e-12);
    (left / all).mean()
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{DType, Device, TensorData};
    use lsdc_rng::Rng;

    fn random(count: usize, name: &str) -> Vec<f64> {
        let mut rng = Rng::stream(2, &[name]);
        (0..count).map(|_| f64::from(rng.normal())).collect()
    }

    fn tensor<const D: usize>(values: &[f64], shape: [usize; D], device: &Device) -> Tensor<D> {
        let data = TensorData::new(values.to_vec(), shape);
        Tensor::from_data(data, (device, DType::F64))
    }

    fn scalar(value: Tensor<1>) -> f64 {
        value.into_scalar::<f64>()
    }

    /// Checks a gradient against central differences.
    fn check(values: &[f64], loss: impl Fn(&[f64]) -> (f64, Vec<f64>)) {
        let (_, gradient) = loss(values);
        assert!(gradient.iter().any(|g| g.abs() > 1e-3));
        for i in 0..values.len() {
            let at = |step: f64| {
                let mut moved = values.to_vec();
                moved[i] += step;
                loss(&moved).0
            };
            let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
            assert!(
                (numeric - gradient[i]).abs() < 1e-7,
                "{numeric} {}",
                gradient[i]
            );
        }
    }

    #[test]
    fn what_is_not_spanned_is_what_a_projection_leaves() {
        let device = Device::flex();
        // Two pixels with one function (0, 2), and three others: (4, 0), which is orthogonal to it, one at 60 degrees, and (0,
        // 5).
        let own = tensor(&[0.0, 2.0], [1, 2, 1], &device);
        let sine = 0.75_f64.sqrt();
        let teacher = tensor(&[4.0, 3.0 * sine, 0.0, 0.0, 1.5, 5.0], [1, 2, 3], &device);
        let valid = tensor(&[1.0; 2], [1, 2], &device);
        // The ridge is 1e-4 times the square of the only function.
        let kept = 1.0 / (1.0 + RIDGE);
        let expected = (1.0 + (1.0 - 0.25 * kept) + (1.0 - kept)) / 3.0;
        let found = scalar(span_residual(own.clone(), teacher.clone(), valid));
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        // Invalid pixels do not count: without the second pixel, only the zero function is represented.
        let first = tensor(&[1.0, 0.0], [1, 2], &device);
        let found = scalar(span_residual(own, teacher, first));
        assert!((found - 2.0 / 3.0).abs() < 1e-9, "{found}");
    }

    #[test]
    fn functions_span_their_own_mixtures_at_any_scale() {
        let device = Device::flex();
        let own = tensor(&random(2 * 30 * 4, "own"), [2, 30, 4], &device);
        let mixing = tensor(&random(2 * 4 * 6, "mixing"), [2, 4, 6], &device) * 50.0;
        let valid = tensor(&[1.0; 60], [2, 30], &device);
        let found = scalar(span_residual(own.clone(), own.matmul(mixing), valid));
        assert!((0.0..1e-3).contains(&found), "{found}");
    }

    #[test]
    fn gradients_of_the_span_are_those_of_differences() {
        let device = Device::flex().autodiff();
        let teacher = random(2 * 9 * 5, "shown");
        let valid: Vec<f64> = (0..18).map(|i| f64::from(u8::from(i % 5 != 3))).collect();
        check(&random(2 * 9 * 3, "own"), |values: &[f64]| {
            let own = tensor(values, [2, 9, 3], &device).require_grad();
            let teacher = tensor(&teacher, [2, 9, 5], &device);
            let loss = span_residual(own.clone(), teacher, tensor(&valid, [2, 9], &device));
            let gradient = own.grad(&loss.clone().backward()).unwrap().into_data();
            (scalar(loss), gradient.iter::<f64>().collect())
        });
    }

    #[test]
    fn affinities_are_compared_by_their_ratios() {
        let device = Device::flex().autodiff();
        let positive = |name: &str| -> Vec<f64> {
            random(2 * 3 * 4 * 2, name)
                .iter()
                .map(|v| v.exp())
                .collect()
        };
        let teacher = positive("shown");
        let loss = |values: &[f64]| {
            let own = tensor(values, [2, 3, 4, 2], &device).require_grad();
            let loss = log_ratio_square(own.clone(), tensor(&teacher, [2, 3, 4, 2], &device));
            let gradient = own.grad(&loss.clone().backward()).unwrap().into_data();
            (scalar(loss), gradient.iter::<f64>().collect::<Vec<_>>())
        };
        check(&positive("own"), loss);
        let tripled: Vec<f64> = teacher.iter().map(|a| 3.0 * a).collect();
        assert!((loss(&tripled).0 - 3.0_f64.ln().powi(2)).abs() < 1e-9);
        // The right neighbours of the last column and the lower ones of the last row do not exist.
        let mut beyond = teacher.clone();
        for (i, value) in beyond.iter_mut().enumerate() {
            let (way, x, y) = (i % 2, i / 2 % 4, i / 8 % 3);
            if (way == 0 && x == 3) || (way == 1 && y == 2) {
                *value *= 9.0;
            }
        }
        assert!(loss(&beyond).0.abs() < 1e-12);
    }
}
