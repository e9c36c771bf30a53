//! The loss of affinities.

use burn::tensor::Tensor;

/// Returns the mean over pairs of neighbours of `c (D^2 + FLAT^2) / STEP^2 - ln c`: twice the negative log likelihood, up to a
/// constant, of a relative depth difference D that is normal with variance `STEP^2 / c`. Differences are reduced by a bound of
/// the quantisation error of depths. `edges [batch, height, width, 2]`, `depths [batch, height, width]`.
pub(super) fn step_neg_log_likelihood(edges: &Tensor<4>, depths: &Tensor<3>) -> Tensor<1> {
    const STEP: f64 = 0.01;
    const FLAT: f64 = 0.003;
    const QUANTUM: f64 = 0.04;
    let mut sum = Tensor::zeros([1], &edges.device());
    let mut pairs = Tensor::zeros([1], &edges.device());
    for way in [0, 1] {
        let axis = 2 - way;
        let length = depths.dims()[axis];
        if length == 1 {
            continue;
        }
        let here = depths.clone().narrow(axis, 0, length - 1);
        let next = depths.clone().narrow(axis, 1, length - 1);
        let strength = edges.clone().narrow(3, way, 1).squeeze_dim::<3>(3);
        let strength = strength.narrow(axis, 0, length - 1);
        let both = (here.clone() * next.clone()).greater_elem(0.0).float();
        let level = (here.clone() + next.clone()).clamp_min(1e-3) / 2.0;
        let step = ((next - here).abs() - QUANTUM).clamp_min(0.0) / level;
        let square = (step.square() + FLAT * FLAT) / (STEP * STEP);
        let neg_log_likelihood = strength.clone() * square - strength.log();
        sum = sum + (neg_log_likelihood * both.clone()).sum();
        pairs = pairs + both.sum();
    }
    sum / pairs.clamp_min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};

    #[test]
    fn edges_as_likely_as_the_steps_cost_least() {
        let device = Device::flex();
        let tensor = |values: Vec<f32>, shape: [usize; 3]| {
            Tensor::<3>::from_data(TensorData::new(values, shape), &device)
        };
        // A step of 0.54 m between 2 and 2.54, no depth at the last pixel.
        let depths = tensor(vec![2.0, 2.0, 2.54, 2.54, 0.0], [1, 1, 5]);
        let loss = |strengths: [f32; 5]| {
            let edges = strengths.into_iter().flat_map(|c| [c, 1.0]).collect();
            let edges = Tensor::from_data(TensorData::new::<f32, _>(edges, [1, 1, 5, 2]), &device);
            f64::from(step_neg_log_likelihood(&edges, &depths).into_scalar::<f32>())
        };
        // Variances of 0.003^2, and of that and (0.5 / 2.27)^2, in units of 0.01^2.
        let flat = 1.0 / 0.09;
        let jump = 1.0 / (0.09 + (0.5_f64 / 2.27).powi(2) * 1e4);
        let least = [flat, jump, flat, 3.0, 3.0].map(|c| c as f32);
        let expected = (3.0 - (2.0 * flat.ln() + jump.ln())) / 3.0;
        assert!((loss(least) - expected).abs() < 1e-4);
        for i in 0..3 {
            for factor in [0.8, 1.25] {
                let mut other = least;
                other[i] *= factor;
                assert!(loss(other) > loss(least) + 1e-3, "{i} {factor}");
            }
        }
    }
}
