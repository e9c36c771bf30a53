//! A feature pyramid (Lin et al. 2017): from a backbone's maps at each resolution to one at a quarter of the image's.

use super::config::BackboneConfig;
use super::map::Map;
use super::tensors::Tensors;
use super::workspace::Workspace;
use crate::error::WeightsError;
use lsdc_kernels::conv::{ConvSpec, Layer};

/// The pyramid, and the layers that read its finest level.
#[derive(Debug)]
pub(super) struct Decoder {
    /// The finest first.
    levels: Vec<Level>,
    /// Added to the features of the extractor.
    pub(super) features: Layer,
    /// The logarithm of the map of depth, if the network suggests one.
    pub(super) map: Option<Layer>,
}

#[derive(Debug)]
struct Level {
    lateral: Layer,
    mix: Layer,
}

impl Decoder {
    pub(super) fn new(
        config: BackboneConfig,
        features: usize,
        mean: bool,
        tensors: &Tensors<'_>,
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

    /// The last level from the outputs of the backbone, the finest first.
    pub(super) fn forward(&self, maps: Vec<Map>, workspace: &Workspace) -> Map {
        let mut coarser: Option<Map> = None;
        for (map, level) in maps.into_iter().zip(&self.levels).rev() {
            let mut x = workspace.layer(&level.lateral, &map, None, false);
            drop(map);
            if let Some(coarser) = coarser.take() {
                x.add_enlarged(&coarser);
            }
            coarser = Some(workspace.layer(&level.mix, &x, None, true));
        }
        coarser.unwrap_or_default()
    }
}
