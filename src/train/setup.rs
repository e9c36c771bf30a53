//! What a run makes of its settings before the first step.

use super::teacher::Taught;
use super::{BackboneTraining, TrainConfig, divide};
use crate::data::{Dataset, Mixture};
use crate::error::{Error, Result};
use crate::model::{AdapterConfig, BasisNet, NetworkConfig, Normalisation, fill};
use crate::predict::open_weights;
use crate::pretrained::read_backbone;
use crate::sample::{Order, Protocol, Sampler, SamplerConfig};
use lsdc_core::Weights;
use std::sync::Arc;

/// The weights of the teacher, if its network is compared with.
pub(super) fn imitated(
    config: &TrainConfig,
    normalisation: &Normalisation,
) -> Result<Option<Weights>> {
    let Some(teacher) = config.teacher.as_ref().filter(|_| config.loss.imitates()) else {
        return Ok(None);
    };
    let weights = open_weights(Some(&teacher.weights))?;
    if weights.network.adapters.is_some() {
        return Err(Error::config(
            "the network of a teacher with adapters cannot be compared with: it reads other features",
        )
        .hint("take a teacher without, or set the losses of a teacher's network to 0"));
    }
    let Normalisation { input, .. } = weights.normalisation;
    if weights.normalisation == *normalisation {
        return Ok(Some(weights));
    }
    Err(Error::config(format!(
        "the network of the teacher sees {}x{} pixels, that which is trained {}x{}, or other colours",
        input[0], input[1], normalisation.input[0], normalisation.input[1]
    ))
    .hint("set `train.protocol` to the size of the teacher, or the losses of a teacher's network to 0"))
}

/// Whether a network can start from weights: adapters belong to what was trained with them.
pub(super) fn start_adapters(start: &NetworkConfig, network: &NetworkConfig) -> Result<()> {
    let Some(adapters) = start.adapters else {
        return Ok(());
    };
    if network.adapters == start.adapters {
        return Ok(());
    }
    let AdapterConfig { blocks, rank } = adapters;
    Err(Error::config(
        "the start weights were trained with other adapters of their encoder than are trained now",
    )
    .hint(format!(
        "set `adapters = {{ blocks = {blocks}, rank = {rank} }}`"
    )))
}

/// The network with the published tensors in its backbone, if they are given.
pub(super) fn with_backbone(
    net: BasisNet,
    network: &NetworkConfig,
    config: &BackboneTraining,
) -> Result<BasisNet> {
    let Some(path) = &config.pretrained else {
        return Ok(net);
    };
    let backbone = network.extractor.backbone.ok_or_else(|| {
        Error::config("`train.backbone.pretrained` is for networks with a backbone")
            .hint("set `preset = \"lite\"`, or leave it out")
    })?;
    fill(read_backbone(path, backbone)?, net)
}

/// Samples of the frames that are learned from: all but those held out of the first dataset.
pub(super) fn sampler(mixture: Mixture, config: &TrainConfig) -> Result<Sampler> {
    let (training, _) = divide(mixture.first().as_ref(), config.held_out);
    let parts = mixture.parts().enumerate().map(|(number, (range, share))| {
        let frames = if number == 0 {
            training.clone()
        } else {
            range.collect()
        };
        (frames, share)
    });
    let order = Order::new(parts.collect())?;
    let mixture: Arc<dyn Dataset> = Arc::new(mixture);
    let (frames, protocol): (Arc<dyn Dataset>, _) = match config.completing() {
        None => (mixture, config.protocol),
        Some(teacher) => (
            Arc::new(Taught::new(mixture, config.protocol, teacher)?),
            config.protocol.after_scaling(),
        ),
    };
    let config = SamplerConfig {
        protocol,
        augment: config.augment,
        views: config.views,
        supervision: config.supervision,
        batch: config.batch,
        seed: config.seed,
    };
    Sampler::new(frames, order, config)
}

/// The height and width at which the network learns: the protocol's, or those of the first frame.
pub(super) fn input_size(protocol: &Protocol, frames: &dyn Dataset) -> Result<[usize; 2]> {
    Ok(match protocol.crop.or(protocol.resize) {
        Some(size) => [size.height, size.width],
        None if frames.is_empty() => return Err(Error::config("there is no frame to learn from")),
        None => {
            let depth = protocol.apply(&frames.load(0)?)?.depth;
            [depth.height(), depth.width()]
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::InitNetwork as _;
    use burn::tensor::Device;

    #[test]
    fn a_published_backbone_needs_a_network_that_has_one() {
        let network = NetworkConfig::small();
        let net = network.init(0, &Device::flex()).unwrap();
        let config = BackboneTraining {
            pretrained: Some("efficientnet-lite0.pth".into()),
            ..BackboneTraining::default()
        };
        let error = with_backbone(net, &network, &config).unwrap_err();
        assert!(
            error.to_string().contains("networks with a backbone"),
            "{error}"
        );
        assert!(error.advice().unwrap().contains("lite"));
    }
}
