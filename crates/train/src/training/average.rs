//! The running average of a network over its last steps, which predicts better than any of them
//! (Polyak and Juditsky 1992; in this form Tarvainen and Valpola 2017).

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Tensor, TensorData};
use std::collections::VecDeque;

/// Moves `average` towards `net` after the step of this number, counted from 1: by `1 - decay`, and
/// more in the first steps, of which an average would remember the random start.
pub(super) fn follow<M: Module>(average: M, net: &M, decay: f64, step: usize) -> M {
    let step = step as f64;
    let kept = decay.min(step / (step + 10.0)) as f32;
    let mut values = Values::default();
    net.visit(&mut values);
    average.map(&mut Mix {
        values: values.0,
        kept,
    })
}

/// The float tensors of a module, in order.
#[derive(Default)]
struct Values(VecDeque<TensorData>);

impl ModuleVisitor for Values {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.0.push_back(param.val().into_data());
    }
}

struct Mix {
    values: VecDeque<TensorData>,
    kept: f32,
}

impl ModuleMapper for Mix {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(now) = self.values.pop_front() else {
            return param;
        };
        let kept = self.kept;
        param.map(|tensor| {
            let old = tensor.to_data();
            let pairs = old.iter::<f32>().zip(now.iter::<f32>());
            let values: Vec<f32> = pairs.map(|(a, b)| b + kept * (a - b)).collect();
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
        let mut values = Values::default();
        net.visit(&mut values);
        let values = values.0.iter();
        values
            .flat_map(|v| v.iter::<f32>().collect::<Vec<_>>())
            .collect()
    }

    #[test]
    fn an_average_comes_nearer_with_every_step() {
        let device = Device::flex();
        let start = NetworkConfig::small().init(0, &device).unwrap();
        let net = NetworkConfig::small().init(1, &device).unwrap();
        let first = |net: &BasisNet| f64::from(numbers(net)[0]);
        let (from, to) = (first(&start), first(&net));
        // Late steps keep the decay, the first ones less.
        let late = follow(start.clone(), &net, 0.75, 1000);
        assert!((first(&late) - (0.75 * from + 0.25 * to)).abs() < 1e-6);
        let early = follow(start.clone(), &net, 0.75, 1);
        assert!((first(&early) - (from / 11.0 + to * 10.0 / 11.0)).abs() < 1e-6);
        // An average of what does not change is that, bit for bit.
        assert!(numbers(&follow(net.clone(), &net, 0.9, 7)) == numbers(&net));
    }
}
