//! The tensors of a module by their paths.

use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::{DType, Tensor, TensorData};
use lsdc_core::weights::is_statistic;

/// A tensor of a module and its path, such as `extractor.stem.0.conv.weight`.
pub struct Named {
    /// The path, its parts joined by dots.
    pub name: String,
    /// Its values.
    pub data: TensorData,
}

impl Named {
    /// Whether this is a running statistic, not a trained parameter.
    pub fn is_statistic(&self) -> bool {
        is_statistic(&self.name)
    }
}

/// All float tensors of a module.
pub fn named<M: Module>(module: &M) -> Vec<Named> {
    let mut collector = Collector::default();
    module.visit(&mut collector);
    collector.found
}

/// The number of trained parameters: weights, gains and shifts, without running statistics.
pub fn parameter_count<M: Module>(module: &M) -> usize {
    named(module)
        .into_iter()
        .filter(|tensor| !tensor.is_statistic())
        .map(|tensor| tensor.data.num_elements())
        .sum()
}

#[derive(Default)]
struct Collector {
    path: Vec<String>,
    found: Vec<Named>,
}

impl ModuleVisitor for Collector {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        self.found.push(Named {
            name: self.path.join("."),
            data: param.val().into_data().convert_dtype(DType::F32),
        });
    }
}
