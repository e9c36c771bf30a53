//! Sizes of the network.

use crate::error::SettingsError;
use serde::{Deserialize, Serialize};

/// More channels in a layer, or more blocks in a stage, indicate a damaged file rather than a network.
const MOST_CHANNELS: usize = 4096;
const MOST_BLOCKS: usize = 64;

/// Added to the variance in every normalisation.
pub const EPSILON: f64 = 1e-5;

/// Channels of the levels of the affinity network, as multiples of those at full resolution.
const LEVELS: [usize; 5] = [1, 2, 4, 6, 8];

/// Number of outputs of the affinity network per pixel, two for each of its two neighbours: first the logarithms of factors,
/// then the changes in the exponent of the colour affinity (-1: colour differences have no effect).
pub const CHANGES: usize = 4;

/// The normalisation after every layer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NormKind {
    /// Batch normalisation (Ioffe and Szegedy 2015), as in PSMNet; can be folded into the weights for
    /// inference.
    #[default]
    Batch,
    /// Group normalisation (Wu and He 2018), with 8 channels per group; per pixel in the MLP.
    Group,
}

/// Number of channels per group in group normalisation.
pub const CHANNELS_PER_GROUP: usize = 8;

/// A sequence of residual blocks of equal width.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageConfig {
    /// Number of channels.
    pub width: usize,
    /// Number of residual blocks of two 3x3 convolutions each.
    pub blocks: usize,
}

fn stage(width: usize, blocks: usize) -> StageConfig {
    StageConfig { width, blocks }
}

/// A pretrained `EfficientNet`-Lite0 in parallel with the extractor; only its first stages are used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BackboneConfig {
    /// Number of its seven stages that are used: 2 end at a quarter of the image's resolution, 3 at an eighth, 5 at a 16th, 7
    /// at a 32nd.
    pub stages: usize,
    /// Channels of the feature pyramid that merges the resolutions, at a quarter of the image's resolution.
    pub decoder: usize,
}

impl Default for BackboneConfig {
    /// Down to a 16th of the resolution.
    fn default() -> Self {
        Self {
            stages: 5,
            decoder: 64,
        }
    }
}

/// Widths and depths of the feature extractor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExtractorConfig {
    /// Channels of the three convolutions at half resolution.
    pub stem: usize,
    /// Four stages: at half resolution, at quarter resolution, wider, and with dilation 2.
    pub stages: [StageConfig; 4],
    /// Pool sizes in pixels at quarter resolution, one branch each.
    pub pools: Vec<usize>,
    /// Channels of each pooling branch.
    pub branch: usize,
    /// Channels of the convolution that merges all branches.
    pub merge: usize,
    /// Channels of the output features.
    pub features: usize,
    /// Stages after the fourth, each at half the resolution of the one before it, starting at an eighth of the image's
    /// resolution: their outputs are upsampled and added to the features, which increases the receptive field.
    pub context: Vec<StageConfig>,
    /// Stages of a pretrained network, which training fine-tunes: their output is added to the features, and predicts the map
    /// of depth if the network has one (`mean`); absent: none.
    // Omitted from files without a backbone: earlier versions reject the name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub backbone: Option<BackboneConfig>,
    /// Number of convolutions that sharpen the features at half the image's resolution, using the output of the first stage; 0:
    /// the features stay at quarter resolution, as in PSMNet.
    pub sharpening: usize,
    /// Channels of the branch for the tokens of a pretrained encoder ([`EncoderConfig::small`]); 0: there is no encoder.
    ///
    /// [`EncoderConfig::small`]: super::EncoderConfig::small
    pub encoder: usize,
}

impl Default for ExtractorConfig {
    fn default() -> Self {
        Self::psmnet()
    }
}

impl ExtractorConfig {
    /// PSMNet's sizes: 3,339,552 parameters.
    pub fn psmnet() -> Self {
        Self {
            stem: 32,
            stages: [stage(32, 3), stage(64, 16), stage(128, 3), stage(128, 3)],
            pools: vec![32, 16, 8, 4],
            branch: 32,
            merge: 128,
            features: 32,
            context: vec![],
            backbone: None,
            sharpening: 0,
            encoder: 0,
        }
    }

    /// PSMNet's sizes with 4 instead of 16 blocks in the second stage.
    pub fn medium() -> Self {
        let mut config = Self::psmnet();
        config.stages[1].blocks = 4;
        config
    }

    /// Half the widths and two fifths of the blocks of `psmnet`, with twice as many features, which are sharpened.
    pub fn slim() -> Self {
        Self {
            stem: 16,
            stages: [stage(16, 2), stage(32, 6), stage(64, 2), stage(64, 1)],
            branch: 16,
            merge: 64,
            features: 64,
            sharpening: 2,
            ..Self::psmnet()
        }
    }

    /// Half the widths of `slim`.
    pub fn slimmer() -> Self {
        Self {
            stem: 8,
            stages: [stage(8, 2), stage(16, 6), stage(32, 2), stage(32, 1)],
            branch: 8,
            merge: 32,
            features: 32,
            ..Self::slim()
        }
    }

    fn check(&self) -> Result<(), SettingsError> {
        let widths = self.widths();
        let channels = |v: &usize| (1..=MOST_CHANNELS).contains(v);
        let blocks = |v: usize| (1..=MOST_BLOCKS).contains(&v);
        let valid = widths.iter().chain(&self.pools).all(channels)
            && channels(&self.features)
            && self.all_stages().all(|stage| blocks(stage.blocks))
            && self.context.len() <= MOST_BLOCKS
            && self.pools.len() <= MOST_BLOCKS
            && self.backbone.is_none_or(|backbone| {
                (2..=BackboneConfig::MAX_STAGES).contains(&backbone.stages)
                    && channels(&backbone.decoder)
            })
            && self.sharpening <= MOST_BLOCKS
            && self.encoder <= MOST_CHANNELS;
        if valid {
            return Ok(());
        }
        Err(SettingsError::new(format!(
            "widths and pools of the extractor must be from 1 to {MOST_CHANNELS}, numbers of blocks from \
             1 to {MOST_BLOCKS}, stages of the backbone from 2 to {}",
            BackboneConfig::MAX_STAGES
        )))
    }

    fn all_stages(&self) -> impl Iterator<Item = &StageConfig> {
        self.stages.iter().chain(&self.context)
    }

    /// Returns all widths that are normalised.
    fn widths(&self) -> Vec<usize> {
        let mut widths: Vec<usize> = self.all_stages().map(|s| s.width).collect();
        widths.extend([self.stem, self.branch, self.merge]);
        widths.extend(self.backbone.map(|backbone| backbone.decoder));
        if self.sharpening > 0 {
            widths.push(self.features);
        }
        if self.encoder > 0 {
            widths.push(self.encoder);
        }
        widths
    }
}

/// The network: a feature extractor with pyramid pooling and an MLP per pixel (paper section 3.2).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NetworkConfig {
    /// The convolutional feature extractor.
    pub extractor: ExtractorConfig,
    /// E of the positional encoding: the raw coordinates twice and E - 1 octaves; 0 for no positional
    /// encoding.
    pub octaves: usize,
    /// Widths of the hidden layers of the MLP.
    pub hidden: Vec<usize>,
    /// N, the number of learned basis functions, not counting the constant 1.
    pub bases: usize,
    /// Whether the first basis function is a positive map predicted by the network instead of the constant 1: the depth up to
    /// scale. It is the exponential of a linear function of the last level of the backbone's pyramid, or of the last hidden
    /// layer without a backbone.
    pub mean: bool,
    /// Channels at full resolution of the affinity network, which distinguishes depth edges from colour edges, for fits with a
    /// field; 0: affinities depend on the colours alone.
    #[serde(alias = "edges")]
    pub affinities: usize,
    /// Normalisation after every convolution and hidden layer.
    pub norm: NormKind,
}

impl Default for NetworkConfig {
    fn default() -> Self {
        Self::paper()
    }
}

impl NetworkConfig {
    /// The paper's network: 3,466,016 parameters, 48 GFLOP at 228x304.
    pub fn paper() -> Self {
        Self {
            extractor: ExtractorConfig::psmnet(),
            octaves: 5,
            hidden: vec![512, 128, 128],
            bases: 128,
            mean: false,
            affinities: 0,
            norm: NormKind::Batch,
        }
    }

    /// The same design with a quarter of the blocks in its longest stage and a narrower MLP: about half the
    /// compute.
    pub fn medium() -> Self {
        Self {
            extractor: ExtractorConfig::medium(),
            hidden: vec![128, 128],
            ..Self::paper()
        }
    }

    /// A slimmer extractor with sharpened features, and an affinity network: 1.3 M parameters.
    pub fn sharp() -> Self {
        Self {
            extractor: ExtractorConfig::slim(),
            // The last layer is at least as wide as `bases`, because fewer channels would make the bases linearly dependent.
            hidden: vec![128, 128],
            affinities: 16,
            ..Self::paper()
        }
    }

    /// `sharp` with half the widths: 0.3 M parameters, for low-power machines.
    pub fn small() -> Self {
        Self {
            extractor: ExtractorConfig::slimmer(),
            hidden: vec![64, 64],
            bases: 64,
            affinities: 8,
            ..Self::paper()
        }
    }

    /// `sharp` with a larger receptive field, down to a 32nd of the resolution, and a map of depth as the first function: 3.3 M
    /// parameters.
    pub fn taught() -> Self {
        Self {
            extractor: ExtractorConfig {
                context: vec![stage(96, 1), stage(128, 2), stage(192, 2)],
                ..ExtractorConfig::slim()
            },
            mean: true,
            ..Self::sharp()
        }
    }

    /// `taught` with one block less, in parallel with five stages of a pretrained `EfficientNet`-Lite0, which predict the map
    /// of depth: 3.4 M parameters.
    pub fn lite() -> Self {
        Self {
            extractor: ExtractorConfig {
                backbone: Some(BackboneConfig::default()),
                context: vec![stage(96, 1), stage(128, 2), stage(192, 1)],
                ..ExtractorConfig::slim()
            },
            mean: true,
            ..Self::sharp()
        }
    }

    /// `small` in parallel with the same stages, which predict the map of depth: 1.1 M parameters.
    pub fn lite_small() -> Self {
        Self {
            extractor: ExtractorConfig {
                backbone: Some(BackboneConfig {
                    decoder: 32,
                    ..BackboneConfig::default()
                }),
                ..ExtractorConfig::slimmer()
            },
            mean: true,
            ..Self::small()
        }
    }

    /// `sharp` with a pretrained encoder, whose parameters are not counted: 2.1 M parameters.
    pub fn anything() -> Self {
        Self {
            extractor: ExtractorConfig {
                merge: 128,
                encoder: 128,
                ..ExtractorConfig::slim()
            },
            mean: true,
            ..Self::sharp()
        }
    }

    /// Channels of all levels of the affinity network, from full resolution down.
    pub fn levels(&self) -> [usize; 5] {
        LEVELS.map(|level| level * self.affinities)
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<(), SettingsError> {
        self.extractor.check()?;
        let channels = |v: &usize| (1..=MOST_CHANNELS).contains(v);
        if !self.hidden.iter().chain([&self.bases]).all(channels) || self.hidden.len() > MOST_BLOCKS
        {
            return Err(SettingsError::new(format!(
                "`bases` and every width in `hidden` must be from 1 to {MOST_CHANNELS}"
            )));
        }
        if self.hidden.last().is_some_and(|&last| last < self.bases) {
            return Err(SettingsError::new(format!(
                "the last width in `hidden` must be at least `bases` ({}), else the basis functions \
                 depend on each other",
                self.bases
            )));
        }
        if self.octaves > 16 || self.affinities > MOST_CHANNELS / 8 {
            return Err(SettingsError::new(format!(
                "`octaves` must be at most 16, `affinities` at most {}",
                MOST_CHANNELS / 8
            )));
        }
        let mut widths = self.extractor.widths();
        widths.extend(&self.hidden);
        widths.extend(self.levels());
        let uneven = widths.iter().find(|&w| w % CHANNELS_PER_GROUP != 0);
        match (self.norm, uneven) {
            (NormKind::Group, Some(width)) => Err(SettingsError::new(format!(
                "`norm = \"group\"` needs widths divisible by {CHANNELS_PER_GROUP}, got {width}"
            ))),
            _ => Ok(()),
        }
    }
}
