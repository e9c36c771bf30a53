//! All layers of a network, for any executor.

use super::affinity_net::AffinityNet;
use super::config::{NetworkConfig, NormKind};
use super::encoder::EncoderConfig;
use super::executor::{Executor, Prepare};
use super::extractor::{ExtractedMaps, Extractor};
use super::head::HeadWeights;
use super::tensors::Tensors;
use crate::error::{Error, WeightsError};
use crate::tensor::Tensor;
use std::collections::BTreeMap;

/// The convolutional layers of a network, each prepared for some [`Executor`].
#[derive(Debug)]
pub struct NetworkLayers<L> {
    extractor: Extractor<L>,
    affinities: Option<AffinityNet<L>>,
}

impl<L> NetworkLayers<L> {
    /// Prepares the layers of a network from the tensors of a weights file, and the weights of its MLP. A network with an
    /// encoder needs the sizes of the encoder.
    ///
    /// # Errors
    /// Sizes that are out of range, a tensor that is missing, unexpected or of the wrong shape, a missing encoder, and networks
    /// without fixed statistics to fold (group normalisation), or without hidden layers.
    pub fn new(
        config: &NetworkConfig,
        encoder: Option<&EncoderConfig>,
        tensors: &BTreeMap<String, Tensor>,
        target: impl Prepare<Layer = L>,
    ) -> Result<(Self, HeadWeights), Error> {
        config.check()?;
        let channels = match (config.extractor.encoder, encoder) {
            (0, _) => None,
            (_, Some(encoder)) => Some(encoder.channels()),
            (_, None) => return Err(WeightsError::NoEncoder.into()),
        };
        let tensors = Tensors::new(tensors, target);
        let layers = Self::of(config, channels, &tensors)?;
        tensors.check_all_used()?;
        Ok(layers)
    }

    /// `channels` is the number of channels of the encoder's features, if there is an encoder.
    pub(super) fn of(
        config: &NetworkConfig,
        channels: Option<usize>,
        tensors: &Tensors<'_, impl Prepare<Layer = L>>,
    ) -> Result<(Self, HeadWeights), WeightsError> {
        if config.norm == NormKind::Group {
            let why = "group normalisation depends on the image";
            return Err(WeightsError::Unsupported(why));
        }
        let affinities =
            (config.affinities > 0).then(|| AffinityNet::new(config, channels, tensors));
        let layers = Self {
            extractor: Extractor::new(&config.extractor, channels, config.mean, tensors)?,
            affinities: affinities.transpose()?,
        };
        Ok((layers, HeadWeights::new(config, tensors)?))
    }

    /// Returns the features of a normalised image, given those of the encoder if there is one.
    pub fn features<M: Clone>(
        &self,
        image: &M,
        encoded: Option<&M>,
        executor: &impl Executor<Layer = L, Map = M>,
    ) -> ExtractedMaps<M> {
        self.extractor.forward(image, encoded, executor)
    }

    /// Returns the network's modifications of the colour affinities, `[height, width, CHANGES]`; `None` without an affinity
    /// network.
    pub fn affinity_changes<M: Clone>(
        &self,
        image: &M,
        encoded: Option<&M>,
        executor: &impl Executor<Layer = L, Map = M>,
    ) -> Option<M> {
        let network = self.affinities.as_ref();
        network.map(|network| network.forward(image, encoded, executor))
    }
}
