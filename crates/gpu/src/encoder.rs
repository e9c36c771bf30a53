//! A vision transformer, its tokens stored as the pixels of a one-row map, and its depth head.

use crate::kernel::{Activation, MOST_HEAD};
use crate::plan::{Map, Place, Recorder};
use crate::weights::{GpuLayer, Packer, quads};
use lsdc_core::network::{
    DepthHead, EncoderConfig, EncoderWeights, Executor as _, HeadLayers, PATCH, Prepare as _,
    positions,
};
use lsdc_core::weights::Tensor;
use lsdc_core::{Error, WeightsError};
use lsdc_kernels::conv::ConvSpec;
use std::collections::BTreeMap;

/// The pretrained encoder of a network.
#[derive(Clone, Debug)]
pub struct Pretrained<'a> {
    /// Its sizes.
    pub config: EncoderConfig,
    /// Tensors of the encoder, by their names in `DINOv2`.
    pub encoder: &'a BTreeMap<String, Tensor>,
    /// Tensors of its depth head, by their published names, if the head guides scenes.
    pub head: Option<&'a BTreeMap<String, Tensor>>,
}

/// An encoder with its weights in the shared buffer.
#[derive(Debug)]
pub(crate) struct GpuEncoder {
    pub(crate) config: EncoderConfig,
    patch_embedding: GpuLayer,
    blocks: Vec<Block>,
    norm: u32,
    class_token: Vec<f32>,
    positions: Vec<f32>,
    head: Option<(HeadLayers<GpuLayer>, GpuLayer)>,
}

#[derive(Debug)]
struct Block {
    norms: [u32; 2],
    /// Queries, keys and values; output projection; both layers of the MLP.
    layers: [GpuLayer; 4],
}

/// Inputs and outputs of the launches of an encoder.
pub(crate) struct Encoded {
    /// Features of all taps, concatenated: `[rows, columns, channels]`.
    pub(crate) features: Map,
    /// Uploaded once: the class token with its position embedding, and the position embeddings of the patches.
    pub(crate) kept: [Map; 2],
    /// Tokens after each tap, and rows and columns of patches.
    taps: Vec<Map>,
    size: (usize, usize),
}

impl GpuEncoder {
    /// Packs the weights.
    ///
    /// # Errors
    /// Tensors do not match the sizes, or sizes are not multiples of 4.
    pub(crate) fn new(pretrained: &Pretrained<'_>, packer: &Packer) -> Result<Self, Error> {
        let config = pretrained.config.clone();
        let weights = EncoderWeights::new(&config, pretrained.encoder)?;
        let depth = config.width / config.heads;
        let whole = [depth, config.hidden].iter().all(|v| v.is_multiple_of(4));
        if !whole || depth > 4 * MOST_HEAD {
            let what = "the GPU runs no encoder of these sizes";
            return Err(WeightsError::Unsupported(what).into());
        }
        let blocks = weights.blocks.iter().map(|block| Block {
            norms: block.norms.map(|norm| packer.norm(norm)),
            layers: block.layers.map(|layer| packer.token_layer(&layer)),
        });
        let blocks = blocks.collect();
        let spec = ConvSpec {
            stride: PATCH,
            padding: 0,
            ..ConvSpec::pointwise()
        };
        let (kernel, bias) = weights.patch_embedding;
        let head = pretrained.head.map(|tensors| -> Result<_, Error> {
            let layers = HeadLayers::new(tensors, packer)?;
            if config.taps.len() != DepthHead::TAPS || layers.width() != config.width {
                let what = "its depth head reads the features of another encoder";
                return Err(WeightsError::Unsupported(what).into());
            }
            if layers.block_channels().any(|channels| channels % 4 != 0) {
                let what = "the GPU runs no depth head of these sizes";
                return Err(WeightsError::Unsupported(what).into());
            }
            let (weights, bias) = layers.last();
            let sizes = [1, weights.len(), 1];
            let last = packer.layer(weights, sizes, &[bias], ConvSpec::pointwise());
            Ok((layers, last))
        });
        Ok(Self {
            patch_embedding: packer.layer(kernel, [config.width, 3, PATCH], bias, spec),
            blocks,
            norm: packer.norm(weights.norm),
            class_token: weights.class_token.to_vec(),
            positions: weights.positions.to_vec(),
            head: head.transpose()?,
            config,
        })
    }

    pub(crate) fn has_head(&self) -> bool {
        self.head.is_some()
    }

    /// Returns [`Encoded::kept`] for these rows and columns of patches.
    pub(crate) fn kept(&self, size: (usize, usize)) -> [Vec<f32>; 2] {
        let EncoderConfig { width, side, .. } = self.config;
        let mut class = positions(&self.positions, side, width, size);
        let patches = class.split_off(width);
        let token = self.class_token.iter();
        class.iter_mut().zip(token).for_each(|(sum, v)| *sum += v);
        [class, patches]
    }

    /// Records the encoder of an image of whole patches.
    pub(crate) fn record(&self, image: &Map, recorder: &Recorder) -> Encoded {
        let place = image.place();
        let size = (place.height / PATCH, place.width / PATCH);
        let (patches, width) = (size.0 * size.1, quads(self.config.width));
        let positions = recorder.map(size, width);
        // The class token stays; the other tokens are written for each image.
        let first = recorder.map((1, 1 + patches), width);
        let embedded = first.place().after(1, size);
        recorder.layer_into(&self.patch_embedding, image, embedded, positions.place());
        let head = quads(self.config.width / self.config.heads);
        let mut tokens = first.clone();
        let mut taps = Vec::new();
        for (i, Block { norms, layers }) in self.blocks.iter().enumerate() {
            let [rows, projection, inner, outer] = layers;
            let none = Activation::None;
            let rows = recorder.token_layer(rows, &tokens, Some(norms[0]), None, none);
            let attended = recorder.attention(&rows, head);
            drop(rows);
            let sum = recorder.token_layer(projection, &attended, None, Some(&tokens), none);
            drop(attended);
            let gelu = Activation::Gelu;
            let inner = recorder.token_layer(inner, &sum, Some(norms[1]), None, gelu);
            tokens = recorder.token_layer(outer, &inner, None, Some(&sum), none);
            if self.config.taps.contains(&i) {
                taps.push(tokens.clone());
            }
        }
        let places: Vec<Place> = taps.iter().map(|tap| tap.place().after(1, size)).collect();
        Encoded {
            features: recorder.features(&places, size, self.norm),
            kept: [first, positions],
            taps,
            size,
        }
    }

    /// Records the relative inverse depth predicted by the depth head, four pixels to a vec4; nothing without a head.
    pub(crate) fn record_head(&self, encoded: &Encoded, recorder: &Recorder) -> Option<Map> {
        let (layers, last) = self.head.as_ref()?;
        let size = encoded.size;
        let taps = encoded.taps.iter();
        let taps = taps.map(|tap| {
            let place = tap.place().after(1, size);
            recorder.features(&[place], size, self.norm)
        });
        let fine = layers.forward(taps, size, recorder)?;
        let depths = recorder.layer(last, &fine, None, true);
        Some(recorder.packed(&depths))
    }
}
