//! A feature pyramid (Lin et al. 2017): merges the maps of a backbone into one at a quarter of the image's resolution.

use super::config::BackboneConfig;
use super::executor::{Executor, Prepare};
use super::tensors::Tensors;
use crate::error::WeightsError;
use lsdc_kernels::conv::ConvSpec;

/// The pyramid, and the output layers on its finest level.
#[derive(Debug)]
pub(super) struct Decoder<L> {
    /// Levels, finest first.
    levels: Vec<Level<L>>,
    /// Projection to an addend for the features of the extractor.
    pub(super) features: L,
    /// Predicts the logarithm of the map of depth, if the network has one.
    pub(super) map: Option<L>,
}

#[derive(Debug)]
struct Level<L> {
    lateral: L,
    mix: L,
}

impl<L> Decoder<L> {
    pub(super) fn new(
        config: BackboneConfig,
        features: usize,
        mean: bool,
        tensors: &Tensors<'_, impl Prepare<Layer = L>>,
    ) -> Result<Self, WeightsError> {
        let (own, pointwise) = (config.decoder, ConvSpec::pointwise());
        let name = |part: &str| format!("extractor.decoder.{part}");
        let reads = config.blocks().into_iter().filter(|block| block.read);
        let levels = reads.enumerate().map(|(i, block)| {
            let (lateral, mix) = (name(&format!("lateral.{i}")), name(&format!("mix.{i}")));
            Ok(Level {
                lateral: tensors.conv(&lateral, [own, block.to, 1], pointwise)?,
                mix: tensors.conv_norm(&mix, [own, own, 3], ConvSpec::same(1))?,
            })
        });
        let map = || tensors.conv(&name("map"), [1, own, 1], pointwise);
        Ok(Self {
            levels: levels.collect::<Result<_, WeightsError>>()?,
            features: tensors.conv(&name("features"), [features, own, 1], pointwise)?,
            map: mean.then(map).transpose()?,
        })
    }

    /// Returns the finest level, from the outputs of the backbone, finest first.
    pub(super) fn forward<M: Clone>(
        &self,
        maps: Vec<M>,
        executor: &impl Executor<Layer = L, Map = M>,
    ) -> Option<M> {
        let levels = maps.into_iter().zip(&self.levels).rev();
        levels.fold(None, |coarser, (map, level)| {
            let x = match coarser {
                None => executor.layer(&level.lateral, &map, None, false),
                Some(coarser) => executor.layer_plus_enlarged(&level.lateral, &map, &coarser),
            };
            drop(map);
            Some(executor.layer(&level.mix, &x, None, true))
        })
    }
}
