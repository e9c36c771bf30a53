//! Image to base functions. Knows no file, no dataset, and never sees a sparse depth.

mod bases;
mod cost;
mod edge_net;
mod edges;
mod encoding;
mod extractor;
mod grid;
mod layers;
mod plan;
mod resample;
#[cfg(test)]
mod tests;
mod weights;

pub use bases::{Bases, BasisHead};
pub use encoding::encode;
pub use extractor::{Extractor, ExtractorConfig, StageConfig};
pub use layers::NormKind;
pub use plan::{Plan, PlannedBases};
pub use weights::{Normalisation, Precision, Table, Weights, WeightsRecord};

use crate::error::{Error, Result};
use crate::rng::Rng;
use burn::module::Module;
use burn::tensor::{Device, Tensor};
use edge_net::EdgeNet;
use layers::Init;
use serde::{Deserialize, Serialize};

/// The network: a pyramid-pooling extractor and a per-pixel MLP (paper section 3.2).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BasisNetConfig {
    /// The convolutional part.
    pub extractor: ExtractorConfig,
    /// E of the positional encoding: the raw coordinates twice and E - 1 octaves; 0 leaves the
    /// position out.
    pub octaves: usize,
    /// Widths of the hidden layers of the MLP.
    pub hidden: Vec<usize>,
    /// N, the number of learned base functions; the constant 1 comes in addition.
    pub bases: usize,
    /// Channels at full resolution of the network that tells edges of the depth from edges of the
    /// colours, for fits with a field; 0: the colours alone say.
    pub edges: usize,
    /// Normalisation after every convolution and hidden layer.
    pub norm: NormKind,
}

impl Default for BasisNetConfig {
    fn default() -> Self {
        Self::paper()
    }
}

impl BasisNetConfig {
    /// The paper's network: 3,466,016 parameters, 48 GFLOP at 228x304.
    pub fn paper() -> Self {
        Self {
            extractor: ExtractorConfig::psmnet(),
            octaves: 5,
            hidden: vec![512, 128, 128],
            bases: 128,
            edges: 0,
            norm: NormKind::Batch,
        }
    }

    /// The same design with a quarter of the blocks in its longest stage and a narrower MLP: about
    /// half of the compute.
    pub fn medium() -> Self {
        Self {
            extractor: ExtractorConfig::medium(),
            hidden: vec![128, 128],
            ..Self::paper()
        }
    }

    /// A slimmer extractor with sharpened features, and a network that judges edges: 1.3 M
    /// parameters.
    pub fn sharp() -> Self {
        Self {
            extractor: ExtractorConfig::slim(),
            // At least as wide as `bases` at the end: fewer would make the bases dependent.
            hidden: vec![128, 128],
            edges: 16,
            ..Self::paper()
        }
    }

    /// The same at half the widths: 0.3 M parameters, for weak machines.
    pub fn small() -> Self {
        Self {
            extractor: ExtractorConfig::slimmer(),
            hidden: vec![64, 64],
            bases: 64,
            edges: 8,
            ..Self::paper()
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<()> {
        self.extractor.check()?;
        if self.bases == 0 || self.hidden.contains(&0) {
            return Err(Error::config(
                "`bases` and every width in `hidden` must be above 0",
            ));
        }
        if self.hidden.last().is_some_and(|&last| last < self.bases) {
            return Err(Error::config(format!(
                "the last width in `hidden` must be at least `bases` ({}), else the base functions \
                 depend on each other",
                self.bases
            )));
        }
        if self.octaves > 16 {
            return Err(Error::config("`octaves` must be at most 16"));
        }
        self.norm.check(
            self.extractor
                .widths()
                .into_iter()
                .chain(self.hidden.iter().copied())
                .chain(edge_net::widths(self.edges)),
        )
    }

    /// Builds the network with random weights: He et al. 2015 for convolutions (fan-out, as
    /// PSMNet) and linear layers, drawn from the stream of `seed`.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn init(&self, seed: u64, device: &Device) -> Result<BasisNet> {
        self.build(Some(Rng::stream(seed, &["weights"])), device)
    }

    /// Builds the network with weights 0, to be filled: random ones take longer than a completion.
    fn blank(&self, device: &Device) -> Result<BasisNet> {
        self.build(None, device)
    }

    fn build(&self, rng: Option<Rng>, device: &Device) -> Result<BasisNet> {
        self.check()?;
        let mut init = Init {
            rng,
            norm: self.norm,
            device: device.clone(),
        };
        Ok(BasisNet {
            extractor: self.extractor.init(&mut init),
            head: BasisHead::init(self, &mut init),
            edges: (self.edges > 0).then(|| EdgeNet::init(self.edges, &mut init)),
        })
    }
}

/// The network with its weights.
#[derive(Module, Debug)]
pub struct BasisNet {
    extractor: Extractor,
    head: BasisHead,
    edges: Option<EdgeNet>,
}

impl BasisNet {
    /// Computes the base functions of normalised images `[batch, height, width, 3]`.
    pub fn bases(&self, images: Tensor<4>) -> Bases {
        Bases::new(self.extractor.forward(images), self.head.clone())
    }

    /// How strongly each pixel of normalised images `[batch, height, width, 3]` is joined to its
    /// right and lower neighbour, `[batch, height, width, 2]`, above 0: 1 where nothing tells them
    /// apart.
    pub fn edges(&self, images: Tensor<4>) -> Tensor<4> {
        let changes = self.edges.as_ref().map(|net| net.forward(images.clone()));
        edges::strengths(images, changes)
    }

    /// Lets batch normalisation use its running statistics from now on, in training too, so that
    /// the network learns with the very statistics it will be used with.
    #[must_use]
    pub fn freeze_statistics(self) -> Self {
        self.map(&mut layers::FreezeStatistics)
    }
}

/// The number of trained parameters: weights, gains and shifts, without running statistics.
pub fn parameter_count<M: Module>(module: &M) -> usize {
    weights::named(module)
        .into_iter()
        .filter(|tensor| !tensor.is_statistic())
        .map(|tensor| tensor.data.num_elements())
        .sum()
}
