//! Muon (Jordan et al. 2024) for the weights of convolutions and linear layers: steps along the nearest orthogonal matrix, as
//! large as those of Adam (Liu et al. 2025, arXiv 2502.16982).

use burn::optim::{AdjustLrFn, LearningRate, Muon, MuonConfig, MuonState, Optimizer};
use burn::tensor::{Device, Tensor};

/// Muon for tensors of any rank, flattened to a matrix with the first axis as rows.
#[derive(Clone)]
pub(super) struct FlattenedMuon(Muon);

impl FlattenedMuon {
    pub(super) fn new() -> Self {
        let config = MuonConfig::new().with_adjust_lr_fn(AdjustLrFn::MatchRmsAdamW);
        Self(config.build())
    }
}

impl Optimizer for FlattenedMuon {
    type State<const D: usize> = MuonState<2>;

    fn step<const D: usize>(
        &self,
        rate: LearningRate,
        tensor: Tensor<D>,
        gradient: Tensor<D>,
        state: Option<Self::State<D>>,
    ) -> (Tensor<D>, Option<Self::State<D>>) {
        let shape = tensor.dims();
        let flat = [shape[0], shape[1..].iter().product()];
        let (tensor, state) =
            self.0
                .step(rate, tensor.reshape(flat), gradient.reshape(flat), state);
        (tensor.reshape(shape), state)
    }

    fn to_device<const D: usize>(state: Self::State<D>, device: &Device) -> Self::State<D> {
        Muon::to_device(state, device)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::TensorData;
    use faer::Mat;
    use lsdc_rng::Rng;

    #[test]
    fn steps_go_along_the_nearest_orthogonal_matrix() {
        const SHAPE: [usize; 4] = [6, 2, 3, 3];
        let (rows, columns) = (6, 18);
        let device = Device::flex();
        let mut rng = Rng::stream(2, &[]);
        let values: Vec<f32> = (0..rows * columns).map(|_| rng.normal()).collect();
        let gradient = Tensor::<4>::from_data(TensorData::new(values.clone(), SHAPE), &device);
        let start = Tensor::<4>::zeros(SHAPE, &device);
        let (end, state) = FlattenedMuon::new().step(0.01, start, gradient, None);
        assert_eq!(end.dims(), SHAPE);
        assert!(state.is_some());

        // Liu et al. 2025, equation 4: 0.2 sqrt(max(rows, columns)) times the rate.
        let length = 0.01 * 0.2 * f64::from(columns as u32).sqrt();
        let end: Vec<f32> = end.into_data().iter().collect();
        let step = Mat::from_fn(rows, columns, |r, c| {
            -f64::from(end[r * columns + c]) / length
        });
        let gradient = Mat::from_fn(rows, columns, |r, c| f64::from(values[r * columns + c]));
        let svd = gradient.thin_svd().unwrap();
        let along = svd.U().transpose() * step * svd.V();
        // Five iterations map singular values to between 0.68 and 1.13 (Jordan et al. 2024).
        for r in 0..rows {
            for c in 0..rows {
                let value = along[(r, c)];
                if r == c {
                    assert!((0.65..1.2).contains(&value), "{value}");
                } else {
                    assert!(value.abs() < 1e-3, "{value}");
                }
            }
        }
    }
}
