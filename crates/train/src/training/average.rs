//! The running average of a network over its last steps, which predicts better than any single step (Polyak and Juditsky 1992;
//! in this form Tarvainen and Valpola 2017).

use crate::model::parameters::{NamedTensor, named};
use burn::module::{Module, ModuleMapper, Param};
use burn::tensor::{Tensor, TensorData};

/// Moves `average` towards `net` after the step with this number, counted from 1: by `1 - decay`, and by more in the first
/// steps, so that the average does not depend on the random start.
pub(super) fn follow<M: Module>(average: M, net: &M, decay: f64, step: usize) -> M {
    let step = step as f64;
    average.map(&mut Mixer {
        tensors: named(net).into_iter(),
        decay: decay.min(step / (step + 10.0)) as f32,
    })
}

/// Moves the tensors of a module towards those of another, in order.
struct Mixer {
    tensors: std::vec::IntoIter<NamedTensor>,
    decay: f32,
}

impl ModuleMapper for Mixer {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(now) = self.tensors.next() else {
            return param;
        };
        let decay = self.decay;
        param.map(|tensor| {
            let old = tensor.to_data();
            let pairs = old.iter::<f32>().zip(now.data.iter::<f32>());
            let values: Vec<f32> = pairs.map(|(a, b)| b + decay * (a - b)).collect();
            Tensor::from_data(TensorData::new(values, old.shape()), &tensor.device())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{BasisNet, InitNetwork as _};
    use burn::tensor::Device;
    use lsdc_core::network::NetworkConfig;

    fn numbers(net: &BasisNet) -> Vec<f32> {
        let tensors = named(net).into_iter();
        tensors
            .flat_map(|tensor| tensor.data.iter::<f32>().collect::<Vec<_>>())
            .collect()
    }

    #[test]
    fn an_average_comes_nearer_with_every_step() {
        let device = Device::flex();
        let start = NetworkConfig::small().init(0, &device).unwrap();
        let net = NetworkConfig::small().init(1, &device).unwrap();
        let first = |net: &BasisNet| f64::from(numbers(net)[0]);
        let (from, to) = (first(&start), first(&net));
        // Late steps use the full decay, the first ones a smaller decay.
        let late = follow(start.clone(), &net, 0.75, 1000);
        assert!((first(&late) - (0.75 * from + 0.25 * to)).abs() < 1e-6);
        let early = follow(start.clone(), &net, 0.75, 1);
        assert!((first(&early) - (from / 11.0 + to * 10.0 / 11.0)).abs() < 1e-6);
        // The average of a constant is exactly that constant.
        assert!(numbers(&follow(net.clone(), &net, 0.9, 7)) == numbers(&net));
    }
}
