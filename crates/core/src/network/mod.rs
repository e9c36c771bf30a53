//! The trained network that computes basis functions and affinities from an image, prepared for the CPU. Depths are not an
//! input.
//!
//! Normalisation is folded into the weights; bias, skip connection and ReLU are folded into the kernels; layers pass on maps
//! `[height, width, channels]`. No full-resolution intermediate is ever stored as a whole: the first layer of the MLP is
//! applied before upsampling, which commutes with it, and the weights of the fit are folded into the last layer.

mod affinity_net;
mod backbone;
mod colour_affinity;
mod config;
mod decoder;
mod encoder;
mod encoding;
mod executor;
mod extractor;
mod grid;
mod head;
mod layers;
mod map;
mod tensors;
mod workspace;

pub use backbone::{BACKBONE_STEM, InvertedBlock};
pub use colour_affinity::{CONTRAST, ColourAffinity, LEAST_AFFINITY, MAX_LOG_FACTOR};
pub use config::{
    BackboneConfig, CHANGES, CHANNELS_PER_GROUP, EPSILON, ExtractorConfig, NetworkConfig, NormKind,
    StageConfig,
};
pub use encoder::{
    BlockWeights, DEPTH_HEAD, DepthHead, Encoder, EncoderConfig, EncoderSide, EncoderWeights,
    FeatureMap, Features, HeadLayers, LAYER_EPSILON, NormWeights, PATCH, TokenLayer, in_patches,
    positions,
};
pub use encoding::{channels, codes};
pub use executor::{Executor, HeadExecutor, Prepare};
pub use extractor::ExtractedMaps;
pub use head::{FirstFunction, HeadWeights, MAX_LOG_DEPTH};
pub use layers::NetworkLayers;

use crate::error::{Error, WeightsError};
use crate::tensor::Tensor;
use colour_affinity::affinities;
use head::{Head, HeadInput};
use lsdc_kernels::conv::Layer;
use lsdc_kernels::simd::Level;
use map::Map;
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::Arc;
pub use tensors::LinearWeights;
use tensors::Tensors;
use workspace::Workspace;

/// A network that turns an image into basis functions and affinities.
pub trait Network: Debug + Send + Sync {
    /// Runs the part of the forward pass that basis functions and affinities share, on a normalised image `[height, width, 3]`
    /// of `size` (height, width).
    ///
    /// # Errors
    /// An image that cannot be encoded.
    fn forward(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Forward>, Error>;

    /// The sizes of the pretrained encoder, if the network uses one.
    fn published_encoder(&self) -> Option<&EncoderConfig> {
        None
    }

    /// Whether the network's device also runs the depth head of the encoder (see [`Forward::published_depths`]).
    fn has_depth_head(&self) -> bool {
        false
    }

    /// The same network whose encoder reads images of another size; `None` without an encoder, and if the device has no choice.
    fn with_encoder_side(&self, _side: EncoderSide) -> Option<Arc<dyn Network>> {
        None
    }

    /// Frees cached memory.
    fn release(&self) {}
}

/// The two parts of the forward pass of one image, which can run in parallel.
pub trait Forward: Debug + Send + Sync {
    /// The basis functions.
    fn basis(&self) -> Box<dyn Basis>;

    /// The affinities of each pixel to its right and lower neighbour, `[height, width, 2]`, and the height and width.
    fn affinities(&self) -> (Vec<f32>, (usize, usize));

    /// The relative inverse depth predicted by the depth head of the encoder, and its height and width, if the network's device
    /// also runs the head.
    fn published_depths(&self) -> Option<(Vec<f32>, (usize, usize))> {
        None
    }

    /// The features of the encoder, for its depth head (see [`Network::published_encoder`]).
    fn published_features(&self) -> Option<Features> {
        None
    }
}

/// The basis functions of one image.
pub trait Basis: Debug + Send + Sync {
    /// The values `[places, N + 1]` at positions (u, v) of the image at `size` (height, width); the first
    /// function is the constant 1. Position (0, 0) is the centre of the first pixel.
    fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32>;

    /// The weighted sum of the basis functions (N + 1 weights) at every pixel of the image at `size`. A device that has failed
    /// returns NaN here and elsewhere, which completions report as an error.
    fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32>;
}

/// A trained network, prepared for one instruction set of the CPU. Clones share weights and memory.
#[derive(Clone, Debug)]
pub struct CpuNetwork {
    inner: Arc<Inner>,
    encoder_side: EncoderSide,
}

#[derive(Debug)]
struct Inner {
    encoder: Option<Arc<Encoder>>,
    layers: NetworkLayers<Layer>,
    head: Head,
    workspace: Workspace,
}

impl CpuNetwork {
    /// Prepares a network from the tensors of a weights file, with an encoder if it was trained with one.
    ///
    /// # Errors
    /// Sizes that are out of range, a tensor that is missing, unexpected or of the wrong shape, a missing encoder,
    /// and networks without fixed statistics to fold (group normalisation) or without hidden layers.
    pub fn new(
        config: &NetworkConfig,
        tensors: &BTreeMap<String, Tensor>,
        encoder: Option<Arc<Encoder>>,
        level: Level,
    ) -> Result<Self, Error> {
        config.check()?;
        let encoder = match (config.extractor.encoder, encoder) {
            (0, _) => None,
            (_, Some(encoder)) => Some(encoder),
            (_, None) => return Err(WeightsError::NoEncoder.into()),
        };
        let tensors = Tensors::new(tensors, level);
        let channels = encoder.as_ref().map(|encoder| encoder.config().channels());
        let (layers, head) = NetworkLayers::of(config, channels, &tensors)?;
        let inner = Inner {
            layers,
            encoder,
            head: Head::new(level, head)?,
            workspace: Workspace::default(),
        };
        tensors.check_all_used()?;
        Ok(Self {
            inner: Arc::new(inner),
            encoder_side: EncoderSide::default(),
        })
    }
}

impl Network for CpuNetwork {
    fn forward(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Forward>, Error> {
        let pool = &self.inner.workspace.pool;
        let encode = |encoder: &Arc<Encoder>| -> Result<Arc<Map>, Error> {
            let channels = encoder.config().channels();
            let FeatureMap {
                rows,
                columns,
                values,
            } = encoder.encode(image, size, self.encoder_side)?;
            Ok(Arc::new(pool.copy(&values, rows, columns, channels)))
        };
        Ok(Box::new(CpuForward {
            encoded: self.inner.encoder.as_ref().map(encode).transpose()?,
            image: Arc::new(pool.copy(image, size.0, size.1, 3)),
            network: self.clone(),
        }))
    }

    fn published_encoder(&self) -> Option<&EncoderConfig> {
        self.inner.encoder.as_ref().map(|encoder| encoder.config())
    }

    fn with_encoder_side(&self, encoder_side: EncoderSide) -> Option<Arc<dyn Network>> {
        self.inner.encoder.as_ref()?;
        let inner = self.inner.clone();
        Some(Arc::new(Self {
            inner,
            encoder_side,
        }))
    }

    fn release(&self) {
        self.inner.workspace.clear();
        if let Some(encoder) = &self.inner.encoder {
            encoder.release();
        }
    }
}

/// An image, and its features from the encoder.
#[derive(Debug)]
struct CpuForward {
    network: CpuNetwork,
    image: Arc<Map>,
    encoded: Option<Arc<Map>>,
}

impl Forward for CpuForward {
    fn basis(&self) -> Box<dyn Basis> {
        let inner = &*self.network.inner;
        // Run on a thread of the pool, to avoid waking and waiting for the pool in each of about sixty layers.
        let input = rayon::scope(|_| {
            let (image, encoded) = (&self.image, self.encoded.as_ref());
            let output = inner.layers.features(image, encoded, &inner.workspace);
            inner.head.input(output)
        });
        Box::new(CpuBasis {
            network: self.network.clone(),
            input,
        })
    }

    fn affinities(&self) -> (Vec<f32>, (usize, usize)) {
        let inner = &*self.network.inner;
        let size = (self.image.height, self.image.width);
        let changes = rayon::scope(|_| {
            let encoded = self.encoded.as_ref();
            (inner.layers).affinity_changes(&self.image, encoded, &inner.workspace)
        });
        let changes = changes.as_ref().map(|map| &map.values[..]);
        (affinities(&self.image.values, size, changes), size)
    }

    fn published_features(&self) -> Option<Features> {
        let taps = self.network.published_encoder()?.taps.len();
        let map = self.encoded.as_ref()?;
        Some(Features::separated(
            &map.values,
            (map.height, map.width),
            taps,
        ))
    }
}

/// The basis functions of an image, which can be evaluated repeatedly at any positions.
#[derive(Debug)]
struct CpuBasis {
    network: CpuNetwork,
    input: HeadInput,
}

impl Basis for CpuBasis {
    fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        let Inner {
            head, workspace, ..
        } = &*self.network.inner;
        head.at(&self.input, size, places, &workspace.scratch)
    }

    fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        let Inner {
            head, workspace, ..
        } = &*self.network.inner;
        head.combine(&self.input, size, weights, &workspace.scratch)
    }
}
