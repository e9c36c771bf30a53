//! Conversion of weights between files and burn's tensors.

use super::basis_net::{BasisNet, InitNetwork as _};
use super::parameters::tables;
use burn::module::{Module, ModuleMapper, Param};
use burn::tensor::{Device, Tensor, TensorData};
use lsdc_core::network::NetworkConfig;
use lsdc_core::weights::{Normalisation, Tensor as Table};
use lsdc_core::{Weights, WeightsError};
use lsdc_files::error::{Error, Result};
use std::collections::BTreeMap;

/// Extracts the weights of a network.
pub fn weights_of(net: &BasisNet, network: NetworkConfig, normalisation: Normalisation) -> Weights {
    Weights::new(network, normalisation, tables(net))
}

/// Builds the network and fills in the weights.
///
/// # Errors
/// A tensor that is missing, unexpected or of the wrong shape.
pub fn load(weights: &Weights, device: &Device) -> Result<BasisNet> {
    fill(weights.tensors.clone(), weights.network.blank(device)?)
}

/// Copies the tensors that agree in name and shape into a network, which may have other sizes; the others stay unchanged.
/// Returns the number of unchanged tensors.
///
/// # Errors
/// No tensor agrees.
pub fn transfer(weights: &Weights, net: BasisNet) -> Result<(BasisNet, usize)> {
    let (net, filler) = Filler::apply(weights.tensors.clone(), net);
    if filler.filled == 0 {
        return Err(
            Error::weights("no tensor of the start weights fits the network")
                .hint("set `preset` or `network` closer to that of the start weights"),
        );
    }
    Ok((net, filler.wrong.len()))
}

/// Fills all tensors of a module.
///
/// # Errors
/// A tensor that is missing, unexpected or of the wrong shape.
pub fn fill<M: Module>(tensors: BTreeMap<String, Table>, module: M) -> Result<M> {
    let (module, filler) = Filler::apply(tensors, module);
    filler.check()?;
    Ok(module)
}

/// Fills some tensors of a module; the others stay unchanged.
///
/// # Errors
/// A tensor that the module does not have, or of the wrong shape.
pub fn fill_part<M: Module>(tensors: BTreeMap<String, Table>, module: M) -> Result<M> {
    let (module, mut filler) = Filler::apply(tensors, module);
    filler.wrong.retain(|(_, reason)| reason != MISSING);
    filler.check()?;
    Ok(module)
}

/// Reason given for a missing tensor.
const MISSING: &str = "is missing";

/// Fills the tensors of a module that agree in name and shape.
struct Filler {
    tensors: BTreeMap<String, Table>,
    path: Vec<String>,
    filled: usize,
    wrong: Vec<(String, String)>,
}

impl Filler {
    fn apply<M: Module>(tensors: BTreeMap<String, Table>, module: M) -> (M, Self) {
        let mut filler = Self {
            tensors,
            path: Vec::new(),
            filled: 0,
            wrong: Vec::new(),
        };
        (module.map(&mut filler), filler)
    }

    /// Checks that all tensors of the module were present, and no other.
    fn check(self) -> Result<()> {
        let superfluous = self.tensors.keys().min();
        let superfluous = superfluous.map(|name| (name.clone(), "is superfluous".to_owned()));
        match self.wrong.into_iter().next().or(superfluous) {
            None => Ok(()),
            Some((name, reason)) => Err(WeightsError::Tensor { name, reason }.into()),
        }
    }
}

impl ModuleMapper for Filler {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let name = self.path.join(".");
        let wrong = match self.tensors.remove(&name) {
            None => MISSING.to_owned(),
            Some(table) if table.shape() != param.val().dims() => {
                let (found, expected) = (table.shape(), param.val().dims());
                format!("has shape {found:?}, expected {expected:?}")
            }
            Some(table) => {
                self.filled += 1;
                let learned = param.is_require_grad();
                let data = TensorData::new(table.values().to_vec(), table.shape().to_vec());
                let param = param.map(|tensor| Tensor::from_data(data, &tensor.device()));
                return param.set_require_grad(learned);
            }
        };
        self.wrong.push((name, wrong));
        param
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_weights::{Precision, to_bytes};

    fn small() -> Weights {
        let network = NetworkConfig::small();
        let net = network.init(0, &Device::flex()).unwrap();
        weights_of(&net, network, Normalisation::default())
    }

    /// Replaces one value of a running variance, and returns the name of its tensor.
    fn with_variance(weights: &mut Weights, value: f32) -> String {
        let mut names = weights.tensors.keys();
        let name = names.find(|n| n.contains("running_var")).unwrap().clone();
        let tensor = &weights.tensors[&name];
        let mut values = tensor.values().to_vec();
        values[1] = value;
        let tensor = Table::new(tensor.shape().to_vec(), values).unwrap();
        weights.tensors.insert(name.clone(), tensor);
        name
    }

    #[test]
    fn numbers_that_do_not_fit_half_precision_stay() {
        let mut weights = small();
        let name = with_variance(&mut weights, 123_456.0);
        let half = to_bytes(&weights, Precision::Half).unwrap();
        let read = Weights::from_bytes(&half).unwrap();
        assert_eq!(read.tensors[&name], weights.tensors[&name]);
        let single = to_bytes(&weights, Precision::Single).unwrap().len();
        assert!(2 * half.len() < single + 200_000);
    }

    #[test]
    fn numbers_that_are_not_finite_are_refused() {
        let mut weights = small();
        let name = with_variance(&mut weights, f32::INFINITY);
        let bytes = to_bytes(&weights, Precision::Half).unwrap();
        let error = Weights::from_bytes(&bytes).unwrap_err().to_string();
        assert!(
            error.contains("not finite") && error.contains(&name),
            "{error}"
        );
    }

    #[test]
    fn tensors_that_do_not_belong_are_refused() {
        let device = Device::flex();
        let whole = small();
        assert!(load(&whole, &device).is_ok());
        let name = "head.last.weight".to_owned();
        for (change, expected) in [
            (None, "is missing"),
            (Table::new(vec![1], vec![0.0]), "has shape"),
        ] {
            let mut weights = whole.clone();
            match change {
                None => weights.tensors.remove(&name),
                Some(tensor) => weights.tensors.insert(name.clone(), tensor),
            };
            let error = load(&weights, &device).unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains(&name), "{error}");
        }
        let mut weights = whole;
        let more = Table::new(vec![1], vec![0.0]).unwrap();
        weights.tensors.insert("more".to_owned(), more);
        let error = load(&weights, &device).unwrap_err().to_string();
        assert!(error.contains("superfluous"), "{error}");
    }
}
