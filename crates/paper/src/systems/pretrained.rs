//! Initialisation of encoders with `torchvision` weights, trained on `ImageNet`.

use super::resnet::torchvision;
use super::{SystemConfig, SystemNet};
use burn::tensor::Device;
use lsdc_files::error::{Error, Result};
use lsdc_train::model::parameters::{NamedTensor, named};
use lsdc_train::model::weights::fill_part;
use lsdc_weights::read_tensors;
use std::collections::BTreeMap;

/// Builds the initial network: random weights from the stream of `seed`, except for the encoder if the settings name a file of
/// `torchvision` weights. The first layer, which also reads depth, stays random, as in the authors' programs; in
/// sparse-to-dense, so does its normalisation.
///
/// # Errors
/// A setting is out of range, or a file cannot be read or is for another encoder.
pub fn initial_net(config: &SystemConfig, seed: u64, device: &Device) -> Result<SystemNet> {
    let net = config.init(seed, device)?;
    let Some(path) = config.pretrained() else {
        return Ok(net);
    };
    let mut theirs = read_tensors(path)?;
    if let SystemConfig::S2d(_) = config {
        theirs.retain(|name, _| !name.starts_with("bn1."));
    }
    theirs.remove("conv1.weight");
    let wrong = |what: &str| {
        Error::format(path, format!("holds no weights of this encoder: {what}")).hint(
            "`system.encoder` and the file must agree: resnet18-*.pth or resnet50-*.pth of torchvision",
        )
    };
    let mut encoder = BTreeMap::new();
    for NamedTensor { name, data } in named(&net) {
        let resnet = name.split_once("resnet.");
        let Some(published) = resnet.and_then(|(_, name)| torchvision(name)) else {
            continue;
        };
        let (found, expected) = (theirs.remove(&published), data.shape().to_vec());
        match found {
            Some(table) if table.shape() == expected => {
                encoder.insert(name, table);
            }
            Some(table) => {
                let found = table.shape();
                let what = format!("`{published}` has shape {found:?}, expected {expected:?}");
                return Err(wrong(&what));
            }
            // The first layer stays random.
            None if published.starts_with("conv1.") || published.starts_with("bn1.") => {}
            None => return Err(wrong(&format!("`{published}` is missing"))),
        }
    }
    if encoder.is_empty() {
        return Err(wrong("it holds none of its tensors"));
    }
    fill_part(encoder, net)
}
