//! From an image to basis functions and affinities: the trained network, prepared for the CPU. It never sees
//! a depth.
//!
//! Normalisation is folded into the weights; bias, skip connection and ReLU are folded into the kernels;
//! layers pass on maps `[height, width, channels]` without copies. No full-resolution intermediate is ever
//! stored whole: the first layer of the MLP is applied before enlargement, which commutes with it, and the
//! weights of the fit are folded into the last layer.

mod affinity_net;
mod backbone;
mod colours;
mod colours_alone;
mod config;
mod decoder;
mod encoder;
mod encoding;
mod extractor;
mod grid;
mod head;
mod map;
mod run;
mod tensors;

pub use backbone::{BACKBONE_STEM, InvertedBlock};
pub use colours::{CONTRAST, LEAST, MOST_CHANGE};
pub use colours_alone::ColourAffinity;
pub use config::{
    AdapterConfig, BackboneConfig, CHANGES, CHANNELS_PER_GROUP, EPSILON, ExtractorConfig,
    NetworkConfig, NormKind, StageConfig,
};
pub use encoder::{
    ADAPTERS, Encoded, Encoder, EncoderConfig, Features, LAYER_EPSILON, MORE_BLOCKS, PATCH,
    in_patches, positions,
};
pub use encoding::{channels, codes};
pub use head::STEEPEST;

use crate::error::{Error, WeightsError};
use crate::tensor::Tensor;
use affinity_net::AffinityNet;
use colours::affinities;
use extractor::Extractor;
use head::{Head, Inputs};
use lsdc_kernels::simd::{Level, Scratch};
use map::{Map, Pool};
use run::Run;
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::Arc;
use tensors::Tensors;

/// A network that turns an image into basis functions and affinities.
pub trait Network: Debug + Send + Sync {
    /// The forward pass of a normalised image `[height, width, 3]` of `size` (height, width), as far as basis functions and
    /// affinities share it.
    ///
    /// # Errors
    /// An image that cannot be encoded.
    fn forward(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Forward>, Error>;

    /// Gives back memory that is kept for further images.
    fn release(&self) {}
}

/// The two parts of the forward pass of one image, which can run side by side.
pub trait Forward: Debug + Send + Sync {
    /// The basis functions.
    fn basis(&self) -> Box<dyn Basis>;

    /// The affinities of each pixel with its right and lower neighbour, `[height, width, 2]`, and the height
    /// and width.
    fn affinities(&self) -> (Vec<f32>, (usize, usize));
}

/// The basis functions of one image.
pub trait Basis: Debug + Send + Sync {
    /// The values `[places, N + 1]` at positions (u, v) of the image at `size` (height, width); the first
    /// function is the constant 1. Position (0, 0) is the centre of the first pixel.
    fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32>;

    /// Basis functions x weights (N + 1 of them), at every pixel of the image at `size`.
    fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32>;
}

/// A network prepared for one instruction set. Clones share weights and memory.
#[derive(Clone, Debug)]
pub struct Prepared(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    encoder: Option<Arc<Encoder>>,
    extractor: Extractor,
    head: Head,
    affinities: Option<AffinityNet>,
    scratch: Scratch,
    pool: Pool,
}

impl Prepared {
    /// Prepares a network from the tensors of a weights file, on top of an encoder if it was trained on one.
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
        if config.norm == NormKind::Group {
            let why = "group normalisation depends on the image";
            return Err(WeightsError::Unsupported(why).into());
        }
        let tensors = Tensors::new(tensors, level);
        let encoder = match (encoder, config.adapters) {
            (Some(encoder), Some(adapters)) => Some(Arc::new(encoder.adapted(adapters, &tensors)?)),
            (encoder, _) => encoder,
        };
        let channels = encoder.as_ref().map(|encoder| encoder.config().channels());
        let affinities =
            (config.affinities > 0).then(|| AffinityNet::new(config, channels, &tensors));
        let inner = Inner {
            extractor: Extractor::new(&config.extractor, channels, config.mean, &tensors)?,
            encoder,
            head: Head::new(config, &tensors)?,
            affinities: affinities.transpose()?,
            scratch: Scratch::new(),
            pool: Pool::default(),
        };
        tensors.check_all_used()?;
        Ok(Self(Arc::new(inner)))
    }
}

impl Inner {
    fn run(&self) -> Run<'_> {
        Run {
            scratch: &self.scratch,
            pool: &self.pool,
        }
    }
}

impl Network for Prepared {
    fn forward(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Forward>, Error> {
        let Inner { encoder, pool, .. } = &*self.0;
        let encode = |encoder: &Arc<Encoder>| -> Result<Map, Error> {
            let encoded = encoder.encode(image, size)?;
            let channels = encoder.config().channels();
            let mut map = pool.take(encoded.rows, encoded.columns, channels);
            map.values.copy_from_slice(&encoded.values);
            Ok(map)
        };
        let encoded = encoder.as_ref().map(encode).transpose()?;
        let mut map = pool.take(size.0, size.1, 3);
        map.values.copy_from_slice(image);
        Ok(Box::new(PreparedForward {
            network: self.clone(),
            image: map,
            encoded,
        }))
    }

    fn release(&self) {
        self.0.pool.clear();
        self.0.scratch.clear();
    }
}

/// An image, and what the encoder says of it.
#[derive(Debug)]
struct PreparedForward {
    network: Prepared,
    image: Map,
    encoded: Option<Map>,
}

impl Drop for PreparedForward {
    fn drop(&mut self) {
        let image = std::mem::take(&mut self.image);
        for map in [image].into_iter().chain(self.encoded.take()) {
            self.network.0.pool.give(map);
        }
    }
}

impl Forward for PreparedForward {
    fn basis(&self) -> Box<dyn Basis> {
        let inner = &*self.network.0;
        // On a thread of the pool, or each of some sixty layers would wake and await it anew.
        let inputs = rayon::scope(|_| {
            let (image, encoded) = (&self.image, self.encoded.as_ref());
            let seen = inner.extractor.forward(image, encoded, inner.run());
            inner.head.enter(seen, &inner.pool)
        });
        Box::new(PreparedBasis {
            network: self.network.clone(),
            inputs,
        })
    }

    fn affinities(&self) -> (Vec<f32>, (usize, usize)) {
        let inner = &*self.network.0;
        let size = (self.image.height, self.image.width);
        let changes = inner.affinities.as_ref().map(|network| {
            let encoded = self.encoded.as_ref();
            rayon::scope(|_| network.forward(&self.image, encoded, inner.run()))
        });
        let values = changes.as_ref().map(|map| &map.values[..]);
        let values = affinities(&self.image.values, size, values);
        if let Some(map) = changes {
            inner.pool.give(map);
        }
        (values, size)
    }
}

/// The basis functions of an image: cheap to read anywhere, again and again.
#[derive(Debug)]
struct PreparedBasis {
    network: Prepared,
    inputs: Inputs,
}

impl Drop for PreparedBasis {
    fn drop(&mut self) {
        let Inputs { hidden, logarithm } = std::mem::take(&mut self.inputs);
        for map in [hidden].into_iter().chain(logarithm) {
            self.network.0.pool.give(map);
        }
    }
}

impl Basis for PreparedBasis {
    fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        let Inner { head, scratch, .. } = &*self.network.0;
        head.at(&self.inputs, size, places, scratch)
    }

    fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        let Inner { head, scratch, .. } = &*self.network.0;
        head.combine(&self.inputs, size, weights, scratch)
    }
}
