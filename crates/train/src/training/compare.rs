//! Comparison of fitted depths with target depths.

use super::LossConfig;
use burn::tensor::Tensor;

/// The losses of a batch, each a scalar `[1]`.
#[derive(Clone, Debug)]
pub struct Losses {
    /// Weighted sum of the losses, to differentiate.
    pub total: Tensor<1>,
    /// Mean absolute error in metres.
    pub l1: Tensor<1>,
    /// Mean squared error in square metres.
    pub l2: Tensor<1>,
}

impl Losses {
    /// Returns losses without errors of depths.
    pub(super) fn only(total: Tensor<1>) -> Self {
        let nothing = total.zeros_like();
        Self {
            total,
            l1: nothing.clone(),
            l2: nothing,
        }
    }
}

/// Weights of errors; `None` if they are equal.
#[derive(Default)]
pub(super) struct ErrorWeights {
    /// Weight of each fit, `[images, 1, draws]`.
    pub(super) fits: Option<Tensor<3>>,
    /// Weight of each pixel, `[images, pixels, 1]`.
    pub(super) pixels: Option<Tensor<3>>,
}

impl ErrorWeights {
    /// Multiplies errors, or their squares, `[images, pixels, draws]`, by the weights of their pixels.
    fn of_pixels(&self, errors: Tensor<3>) -> Tensor<3> {
        weighted(errors, self.pixels.as_ref())
    }

    /// Multiplies errors, or means of errors, by the weights of their fits.
    fn of_fits(&self, errors: Tensor<3>) -> Tensor<3> {
        weighted(errors, self.fits.as_ref())
    }
}

fn weighted(errors: Tensor<3>, weights: Option<&Tensor<3>>) -> Tensor<3> {
    match weights {
        None => errors,
        Some(weights) => errors * weights.clone(),
    }
}

/// Compares `fitted [images, pixels, draws]` with `depths [images, pixels]`, 0 = none. The pixels after the first ones form
/// patches of a height and width.
pub(super) fn compared(
    fitted: Tensor<3>,
    depths: &Tensor<2>,
    weights: &ErrorWeights,
    (points, patch): (usize, (usize, usize)),
    config: &LossConfig,
) -> Losses {
    let [images, pixels, draws] = fitted.dims();
    let depths = depths.clone().reshape([images, pixels, 1]);
    let valid = depths.clone().greater_elem(0.0).float();
    let error = (fitted - depths) * valid.clone();
    let count = (valid.clone().sum() * draws as f64).clamp_min(1.0);
    let absolutes = weights.of_pixels(error.clone().abs());
    let squares = weights.of_pixels(error.clone().square());
    let l1 = absolutes.clone().sum() / count.clone();
    let l2 = squares.clone().sum() / count.clone();
    let absolute = match &weights.fits {
        None => l1.clone(),
        Some(_) => weights.of_fits(absolutes).sum() / count.clone(),
    };
    let mut total = absolute * config.l1 + l2.clone() * config.l2;
    if config.rmse > 0.0 {
        // Keeps the root differentiable at an error of 0.
        const LEAST: f64 = 1e-6;
        let means = squares.sum_dim(1) / valid.clone().sum_dim(1).clamp_min(1.0);
        total = total + weights.of_fits((means + LEAST).sqrt()).mean() * config.rmse;
    }
    if config.berhu > 0.0 {
        let bends = weights.of_pixels(reverse_huber(error.clone()));
        total = total + weights.of_fits(bends).sum() / count * config.berhu;
    }
    if config.gradient > 0.0 {
        let certain = weights.of_pixels(valid.clone());
        total = total + gradient(error, [valid, certain], points, patch) * config.gradient;
    }
    Losses { total, l1, l2 }
}

/// Returns absolute errors, replaced by parabolas above a fifth of the largest (Laina et al. 2016, equation 4).
fn reverse_huber(error: Tensor<3>) -> Tensor<3> {
    /// Lower bound, in case all errors are 0.
    const LEAST: f64 = 1e-6;
    let absolute = error.clone().abs();
    let bend = absolute.clone().max().detach() * 0.2;
    let bend = bend.clamp_min(LEAST).reshape([1, 1, 1]);
    let above = absolute
        .clone()
        .greater(bend.clone().expand(absolute.dims()));
    let parabola = (error.square() + bend.clone().square()) / (bend * 2.0);
    absolute.mask_where(above, parabola)
}

/// Returns the mean absolute difference of errors between horizontal and vertical neighbours inside the patches that both have
/// a depth, weighted by both pixels.
fn gradient(
    error: Tensor<3>,
    [valid, certain]: [Tensor<3>; 2],
    points: usize,
    (height, width): (usize, usize),
) -> Tensor<1> {
    let [images, pixels, draws] = error.dims();
    let patches = images * (pixels - points) / (height * width);
    let cut = |t: Tensor<3>| {
        let channels = t.dims()[2];
        t.slice([0..images, points..pixels])
            .reshape([patches, height, width, channels])
    };
    let (error, valid, certain) = (cut(error), cut(valid), cut(certain));
    let mut sum = Tensor::zeros([1], &error.device());
    let mut count = Tensor::zeros([1], &error.device());
    for axis in [1, 2] {
        let length = [patches, height, width][axis];
        let pair = |t: &Tensor<4>| {
            (
                t.clone().narrow(axis, 1, length - 1),
                t.clone().narrow(axis, 0, length - 1),
            )
        };
        let ((next, here), (c_next, c_here)) = (pair(&error), pair(&certain));
        let (v_next, v_here) = pair(&valid);
        let both = v_next * v_here;
        sum = sum + ((next - here) * (c_next * c_here)).abs().sum();
        count = count + both.sum() * draws as f64;
    }
    sum / count.clamp_min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};

    #[test]
    fn large_errors_lie_on_a_parabola() {
        let errors = TensorData::new(vec![0.5_f32, -1.0, 2.0, -5.0], [1, 4, 1]);
        let found = reverse_huber(Tensor::from_data(errors, &Device::flex()));
        let found: Vec<f32> = found.into_data().iter().collect();
        // c = 1: |x| below, (x^2 + c^2) / 2c above.
        assert_eq!(found, [0.5, 1.0, 2.5, 13.0]);
    }

    #[test]
    fn errors_count_as_much_as_their_pixels() {
        let device = Device::flex();
        let row = |values: [f32; 4], shape: [usize; 3]| {
            Tensor::<3>::from_data(TensorData::new(values.to_vec(), shape), &device)
        };
        // A patch of 2x2 pixels, without depth at the last one.
        let fitted = row([3.0, 4.0, 1.0, 9.0], [1, 4, 1]);
        let depths = vec![2.0_f32, 2.0, 2.0, 0.0];
        let depths = Tensor::from_data(TensorData::new(depths, [1, 4]), &device);
        let weights = ErrorWeights {
            fits: None,
            pixels: Some(row([1.0, 0.5, 0.25, 0.0], [1, 4, 1])),
        };
        let total = |[l1, l2, rmse, gradient]: [f64; 4]| {
            let config = LossConfig {
                l1,
                l2,
                rmse,
                gradient,
                ..LossConfig::default()
            };
            let found = compared(fitted.clone(), &depths, &weights, (0, (2, 2)), &config);
            f64::from(found.total.into_scalar::<f32>())
        };
        // Errors 1, 2, -1; two pairs are neighbours, with differences of 1 and 2.
        let squares: f64 = (1.0 + 0.5 * 4.0 + 0.25) / 3.0;
        for (losses, expected) in [
            ([1.0, 0.0, 0.0, 0.0], (1.0 + 0.5 * 2.0 + 0.25) / 3.0),
            ([0.0, 1.0, 0.0, 0.0], squares),
            ([0.0, 0.0, 1.0, 0.0], squares.sqrt()),
            ([0.0, 0.0, 0.0, 1.0], f64::midpoint(0.5 * 1.0, 0.25 * 2.0)),
        ] {
            let found = total(losses);
            assert!(
                (found - expected).abs() < 1e-5,
                "{losses:?}: {found} {expected}"
            );
        }
    }

    #[test]
    fn few_points_count_as_much_less_as_they_are_told_to() {
        let device = Device::flex();
        let tensor = |values: Vec<f32>, shape: [usize; 3]| {
            Tensor::<3>::from_data(TensorData::new(values, shape), &device)
        };
        // Two pixels with errors of 1 m in a fit to all points, and of 3 m in a fit to a sixteenth of them.
        let fitted = tensor(vec![3.0, 5.0, 3.0, 5.0], [1, 2, 2]);
        let depths = Tensor::from_data(TensorData::new(vec![2.0_f32, 2.0], [1, 2]), &device);
        let total = |shares: Option<Tensor<3>>, l1: f64, rmse: f64| {
            let config = LossConfig {
                l1,
                l2: 0.0,
                rmse,
                gradient: 0.0,
                ..LossConfig::default()
            };
            let weights = ErrorWeights {
                fits: shares,
                pixels: None,
            };
            let found = compared(fitted.clone(), &depths, &weights, (2, (0, 0)), &config);
            f64::from(found.total.into_scalar::<f32>())
        };
        let shares = || Some(tensor(vec![1.0, (1.0_f32 / 16.0).powf(0.25)], [1, 1, 2]));
        for (l1, rmse) in [(1.0, 0.0), (0.0, 1.0)] {
            assert!((total(None, l1, rmse) - 2.0).abs() < 1e-5);
            assert!((total(shares(), l1, rmse) - 1.25).abs() < 1e-5);
        }
    }
}
