//! Encoders that start from the weights of `torchvision`, trained on `ImageNet`.

use super::resnet::torchvision;
use super::{Net, SystemConfig};
use burn::module::{Module, ModuleMapper, Param};
use burn::tensor::{Device, Tensor};
use lsdc_core::weights::Tensor as Table;
use lsdc_files::error::{Error, Result};
use lsdc_train::model::weights::{fits, with_values};
use lsdc_weights::read_tensors;
use std::collections::BTreeMap;

/// The network as it starts: random from the stream of `seed`, but for the encoder if its settings name a file of
/// `torchvision`'s weights. Its first layer sees a depth too, and stays random, as in the authors' programs:
/// normalisation behind it included in sparse-to-dense.
///
/// # Errors
/// A setting out of range; a file that cannot be read or is of another encoder.
pub fn begin(config: &SystemConfig, seed: u64, device: &Device) -> Result<Net> {
    let net = config.init(seed, device)?;
    let Some(path) = config.pretrained() else {
        return Ok(net);
    };
    let mut tensors = read_tensors(path)?;
    if let SystemConfig::S2d(_) = config {
        tensors.retain(|name, _| !name.starts_with("bn1."));
    }
    tensors.remove("conv1.weight");
    let mut taken = Taken {
        tensors,
        path: Vec::new(),
        count: 0,
        missing: None,
    };
    let net = net.map(&mut taken);
    match taken.missing {
        None if taken.count > 0 => Ok(net),
        missing => {
            let what = missing.unwrap_or_else(|| "it holds none of its tensors".to_owned());
            Err(
                Error::format(path, format!("holds no weights of this encoder: {what}")).hint(
                    "`system.encoder` and the file must agree: resnet18-*.pth or resnet50-*.pth of torchvision",
                ),
            )
        }
    }
}

/// Fills the encoder of a network.
struct Taken {
    tensors: BTreeMap<String, Table>,
    path: Vec<String>,
    count: usize,
    missing: Option<String>,
}

impl ModuleMapper for Taken {
    fn enter_module(&mut self, name: &str, _: &str) {
        self.path.push(name.to_owned());
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.pop();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let name = self.path.join(".");
        let Some(theirs) = name
            .split_once("resnet.")
            .and_then(|(_, name)| torchvision(name))
        else {
            return param;
        };
        match self
            .tensors
            .remove(&theirs)
            .map(|table| fits(&param, &table))
        {
            Some(Ok(data)) => {
                self.count += 1;
                with_values(param, data)
            }
            Some(Err(what)) => {
                self.missing.get_or_insert(format!("`{theirs}` {what}"));
                param
            }
            // The first layer, which is left random.
            None if theirs.starts_with("conv1.") || theirs.starts_with("bn1.") => param,
            None => {
                self.missing.get_or_insert(format!("`{theirs}` is missing"));
                param
            }
        }
    }
}
