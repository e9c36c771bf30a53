//! Image to base functions. Knows no file, no dataset, and never sees a sparse depth.

mod bases;
mod detail;
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
use detail::Detail;
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
    /// Channels of the features at full resolution, which the base functions and the edges read
    /// beside the extractor's; 0 leaves them out, as the paper has it.
    pub detail: usize,
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
            detail: 0,
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

    /// The same design at about a tenth of the compute, for weak machines.
    pub fn small() -> Self {
        Self {
            extractor: ExtractorConfig::small(),
            octaves: 5,
            // At least as wide as `bases` at the end: fewer would make the bases dependent.
            hidden: vec![128, 128],
            bases: 128,
            detail: 0,
            norm: NormKind::Batch,
        }
    }

    /// The medium network with features at full resolution.
    pub fn sharp() -> Self {
        Self {
            detail: 16,
            ..Self::medium()
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
        if self.detail > 0 && self.hidden.is_empty() {
            return Err(Error::config("`detail` needs a layer in `hidden`"));
        }
        if self.octaves > 16 {
            return Err(Error::config("`octaves` must be at most 16"));
        }
        self.norm.check(
            self.extractor
                .widths()
                .into_iter()
                .chain(self.hidden.iter().copied())
                .chain([self.detail]),
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
            detail: (self.detail > 0)
                .then(|| Detail::init(self.detail, &self.extractor, &mut init)),
        })
    }
}

/// The network with its weights.
#[derive(Module, Debug)]
pub struct BasisNet {
    extractor: Extractor,
    head: BasisHead,
    detail: Option<Detail>,
}

impl BasisNet {
    /// Computes the base functions of normalised images `[batch, height, width, 3]`.
    pub fn bases(&self, images: Tensor<4>) -> Bases {
        let (features, half) = self.extractor.forward_both(images.clone());
        let (detail, changes) = match &self.detail {
            None => (None, None),
            Some(detail) => {
                let (detail, changes) = detail.forward(images.clone(), half, features.clone());
                (Some(detail), Some(changes))
            }
        };
        let edges = edges::strengths(images, changes);
        Bases::new(features, detail, edges, self.head.clone())
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
