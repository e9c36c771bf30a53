//! Setup of a run from its settings.

use super::distillation::DistilledDataset;
use super::efficientnet::read_backbone;
use super::loss::map_of_backbone;
use super::{BackboneTraining, TrainConfig, TrainedPart};
use crate::model::{BasisNet, fill_part};
use crate::sample::{Order, Sampler, SamplerConfig};
use lsdc_core::Weights;
use lsdc_core::network::NetworkConfig;
use lsdc_core::weights::Normalisation;
use lsdc_eval::data::{Dataset, Mixture};
use lsdc_eval::sampling::Protocol;
use lsdc_files::error::{Error, Result};
use lsdc_weights::open_weights;
use std::sync::Arc;

/// Returns the weights of the teacher, if its network is compared with.
pub(super) fn teacher_weights(
    config: &TrainConfig,
    normalisation: &Normalisation,
) -> Result<Option<Weights>> {
    let Some(teacher) = config
        .teacher
        .as_ref()
        .filter(|_| config.loss.compares_networks())
    else {
        return Ok(None);
    };
    let weights = open_weights(Some(&teacher.weights))?;
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

/// Checks that a network has the part that `config` trains.
pub(super) fn check_network(network: &NetworkConfig, config: &TrainConfig) -> Result<()> {
    if config.part == TrainedPart::Affinities && network.affinities == 0 {
        return Err(Error::config(
            "`train.part = \"affinities\"` needs a network with `affinities` above 0",
        ));
    }
    if config.loss.mean > 0.0 && (!network.mean || config.part == TrainedPart::Affinities) {
        return Err(Error::config(
            "`train.loss.mean` needs a network with `mean = true` whose basis functions are trained",
        )
        .hint("set `preset = \"lite\"` or \"taught\", or leave it at 0"));
    }
    let backbone = network.extractor.backbone.is_some();
    if config.part == TrainedPart::Map && !backbone {
        return Err(map_of_backbone());
    }
    if config.backbone != BackboneTraining::default() && !backbone {
        return Err(
            Error::config("`train.backbone` is for networks with a pretrained backbone")
                .hint("set `preset = \"lite\"`, or leave it out"),
        );
    }
    Ok(())
}

/// Loads the published tensors into the backbone of a network, if they are given.
pub(super) fn with_backbone(
    net: BasisNet,
    network: &NetworkConfig,
    config: &BackboneTraining,
) -> Result<BasisNet> {
    match (&config.pretrained, network.extractor.backbone) {
        (Some(path), Some(backbone)) => fill_part(read_backbone(path, backbone)?, net),
        _ => Ok(net),
    }
}

/// Returns the sampler of the training frames: all but those held out of the first dataset.
pub(super) fn sampler(mixture: Mixture, config: &TrainConfig) -> Result<Sampler> {
    let (training, _) = config.divide(mixture.first().as_ref())?;
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
    let (frames, protocol): (Arc<dyn Dataset>, _) = match config.depth_teacher() {
        None => (mixture, config.protocol),
        Some(teacher) => (
            Arc::new(DistilledDataset::new(mixture, config.protocol, teacher)?),
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

/// Returns the protocol for batches of frames of one size: a protocol that keeps the shape of each frame uses that of the
/// first.
pub(super) fn batch_protocol(protocol: &Protocol, frames: &dyn Dataset) -> Result<Protocol> {
    if protocol.pixels.is_none() || frames.is_empty() {
        return Ok(*protocol);
    }
    Ok(protocol.sized_as(&frames.load(0)?))
}

/// Returns the height and width of training images: those of the protocol, or those of the first frame.
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
    use crate::training::LossConfig;

    #[test]
    fn a_backbone_is_trained_where_there_is_one() {
        let refused = |network: &NetworkConfig, config: &TrainConfig, words: [&str; 2]| {
            let error = check_network(network, config).unwrap_err();
            assert!(error.to_string().contains(words[0]), "{error}");
            assert!(error.advice().unwrap().contains(words[1]), "{error}");
        };
        let mut config = TrainConfig::default();
        config.backbone.pretrained = Some("efficientnet-lite0.pth".into());
        let words = ["networks with a pretrained backbone", "lite"];
        refused(&NetworkConfig::small(), &config, words);
        check_network(&NetworkConfig::lite_small(), &config).unwrap();
        let config = TrainConfig {
            part: TrainedPart::Map,
            loss: LossConfig::of_map(1.0),
            ..TrainConfig::default()
        };
        refused(
            &NetworkConfig::taught(),
            &config,
            ["a map of depth", "lite"],
        );
        let without = NetworkConfig {
            mean: false,
            ..NetworkConfig::lite()
        };
        refused(&without, &config, ["mean = true", "lite"]);
        check_network(&NetworkConfig::lite(), &config).unwrap();
    }
}
