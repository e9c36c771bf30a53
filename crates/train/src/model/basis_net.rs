//! The complete network: from images to basis functions and affinities.

use super::affinity_net::AffinityNet;
use super::bases::{Bases, BasisHead};
use super::extractor::{self, Extractor};
use super::layers::{self, Init};
use super::{affinities, bases};
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use lsdc_core::network::NetworkConfig;
use lsdc_files::error::Result;
use lsdc_rng::Rng;

/// Construction of networks from their sizes.
pub trait InitNetwork {
    /// Builds the network with random weights drawn from the stream of `seed`: He et al. 2015 for convolutions (fan-out, as in
    /// PSMNet) and linear layers.
    ///
    /// # Errors
    /// A setting is out of range.
    fn init(&self, seed: u64, device: &Device) -> Result<BasisNet>;

    /// Builds the network with zero weights, to be filled later: drawing random ones takes longer than a completion.
    ///
    /// # Errors
    /// A setting is out of range.
    fn blank(&self, device: &Device) -> Result<BasisNet>;
}

impl InitNetwork for NetworkConfig {
    fn init(&self, seed: u64, device: &Device) -> Result<BasisNet> {
        build(self, Some(Rng::stream(seed, &["weights"])), device)
    }

    fn blank(&self, device: &Device) -> Result<BasisNet> {
        build(self, None, device)
    }
}

fn build(config: &NetworkConfig, rng: Option<Rng>, device: &Device) -> Result<BasisNet> {
    let mut init = Init {
        rng,
        norm: config.norm,
        momentum: layers::MOMENTUM,
        device: device.clone(),
    };
    BasisNet::init(config, &mut init)
}

/// The network with its weights.
#[derive(Module, Debug)]
pub struct BasisNet {
    pub(super) extractor: Extractor,
    pub(super) head: BasisHead,
    /// Named like the tensors in weights files.
    pub(super) edges: Option<AffinityNet>,
}

impl BasisNet {
    /// Returns the backbone features of images `[batch, height, width, 3]`.
    #[cfg(test)]
    pub(crate) fn backbone_features(&self, images: Tensor<4>) -> Vec<Tensor<4>> {
        let backbone = self.extractor.backbone.as_ref();
        backbone.map_or_else(Vec::new, |net| net.forward(images))
    }

    /// Builds the network layer by layer.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn init(config: &NetworkConfig, init: &mut Init) -> Result<Self> {
        config.check()?;
        Ok(Self {
            extractor: extractor::build(&config.extractor, config.mean, init),
            head: BasisHead::init(config, init),
            edges: (config.affinities > 0).then(|| AffinityNet::init(config, init)),
        })
    }

    /// Computes the basis functions of normalised images `[batch, height, width, 3]`. `encoded [batch, rows, columns,
    /// channels]` are features of a pretrained encoder, for networks trained on one.
    pub fn bases(&self, images: Tensor<4>, encoded: Option<Tensor<4>>) -> Bases {
        Bases::new(self.extractor.forward(images, encoded), self.head.clone())
    }

    /// Returns the depth map predicted by the backbone from normalised images `[batch, height, width, 3]`, at pixels as in
    /// [`Bases::at`]: `[batch, pixels]`, up to scale. The rest of the network is not run. `None` without a backbone that
    /// predicts such a map.
    pub fn map_at(
        &self,
        images: Tensor<4>,
        size: (usize, usize),
        pixels: &[Vec<u32>],
    ) -> Option<Tensor<2>> {
        let logarithm = self.extractor.logarithm(images)?;
        Some(bases::map_at(logarithm, size, pixels))
    }

    /// Returns the affinities between each pixel of normalised images `[batch, height, width, 3]` and its right and lower
    /// neighbour, `[batch, height, width, 2]`, above 0; 1 for equal colours.
    pub fn affinities(&self, images: Tensor<4>, encoded: Option<Tensor<4>>) -> Tensor<4> {
        let edges = self.edges.as_ref();
        let changes = edges.map(|net| net.forward(images.clone(), encoded));
        affinities::affinities(images, changes)
    }

    /// Freezes the affinity network, including its running statistics.
    #[must_use]
    pub fn fix_affinities(self) -> Self {
        let fixed = |net: AffinityNet| net.no_grad().map(&mut layers::FreezeStatistics);
        Self {
            edges: self.edges.map(fixed),
            ..self
        }
    }

    /// Makes batch normalisation use its running statistics from now on, also in training, so that the network is trained with
    /// the statistics used at inference.
    #[must_use]
    pub fn freeze_statistics(self) -> Self {
        self.map(&mut layers::FreezeStatistics)
    }
}
