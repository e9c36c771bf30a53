//! The tensors of a module by their paths.

use crate::traffic::count_readback;
use burn::module::{Module, ModuleVisitor, Param};
use burn::tensor::{DType, Tensor, TensorData};
use lsdc_core::weights::{Tensor as Table, is_statistic};
use std::collections::BTreeMap;

/// A tensor of a module and its path, such as `extractor.stem.0.conv.weight`.
pub struct NamedTensor {
    /// The path, its parts joined by dots.
    pub name: String,
    /// Values of the tensor.
    pub data: TensorData,
}

/// Returns all float tensors of a module.
pub fn named<M: Module>(module: &M) -> Vec<NamedTensor> {
    let mut collector = Collector::default();
    module.visit(&mut collector);
    collector.found
}

/// Returns all float tensors of a module in the format of weights files.
pub fn tables<M: Module>(module: &M) -> BTreeMap<String, Table> {
    let tables = named(module).into_iter().filter_map(|tensor| {
        let values = tensor.data.iter::<f32>().collect();
        let table = Table::new(tensor.data.shape().to_vec(), values)?;
        Some((tensor.name, table))
    });
    tables.collect()
}

/// Returns the number of trainable parameters: weights, gains and shifts, without running statistics.
pub fn parameter_count<M: Module>(module: &M) -> usize {
    named(module)
        .into_iter()
        .filter(|tensor| !is_statistic(&tensor.name))
        .map(|tensor| tensor.data.num_elements())
        .sum()
}

/// Returns the shapes of all float tensors of a module.
pub(crate) fn shapes<M: Module>(module: &M) -> BTreeMap<String, Vec<usize>> {
    let mut collector = ShapeCollector::default();
    module.visit(&mut collector);
    collector.found
}

#[derive(Default)]
struct ShapeCollector {
    path: Vec<String>,
    found: BTreeMap<String, Vec<usize>>,
}

impl ModuleVisitor for ShapeCollector {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let shape = param.shape().to_vec();
        self.found.insert(self.path.join("."), shape);
    }
}

#[derive(Default)]
struct Collector {
    path: Vec<String>,
    found: Vec<NamedTensor>,
}

impl ModuleVisitor for Collector {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        count_readback();
        self.found.push(NamedTensor {
            name: self.path.join("."),
            data: param.val().into_data().convert_dtype(DType::F32),
        });
    }
}
