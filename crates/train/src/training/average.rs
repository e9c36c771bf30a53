//! The running average of a network over its last steps, which predicts better than any single step (Polyak and Juditsky 1992;
//! in this form Tarvainen and Valpola 2017).

use crate::ops::pack::Layout;
use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::Tensor;

/// Moves `average` towards `net` after the step with this number, counted from 1: by `1 - decay`, and by more in the first
/// steps, so that the average does not depend on the random start.
pub(super) fn follow<M: Module>(average: M, net: &M, decay: f64, step: usize) -> M {
    let step = step as f64;
    let decay = decay.min(step / (step + 10.0));
    let (old, now) = (vectors(&average), vectors(net));
    if old.is_empty() {
        return average;
    }
    let mut layout = Layout::default();
    for part in &old {
        layout.push(1, part.dims()[0]);
    }
    let (old, now) = (layout.pack(&old), layout.pack(&now));
    let mut parts = Parts {
        packed: now.clone() + (old - now) * decay,
        layout,
        next: 0,
    };
    average.map(&mut parts)
}

/// Returns the tensors of a module as vectors, in order.
fn vectors<M: Module>(module: &M) -> Vec<Tensor<1>> {
    struct Collector(Vec<Tensor<1>>);

    impl ModuleVisitor for Collector {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let value = param.val().inner();
            let count = value.shape().num_elements();
            self.0.push(value.reshape([count]));
        }
    }

    let mut collector = Collector(Vec::new());
    module.visit(&mut collector);
    collector.0
}

/// Gives the tensors of a module the values of a vector, in order.
struct Parts {
    packed: Tensor<1>,
    layout: Layout,
    next: usize,
}

impl ModuleMapper for Parts {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let values = self.layout.part(&self.packed, self.next);
        self.next += 1;
        param.map(|tensor| {
            let new = values.reshape(tensor.dims());
            if tensor.device().is_autodiff() {
                Tensor::from_inner(new)
            } else {
                new
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::parameters::named;
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
