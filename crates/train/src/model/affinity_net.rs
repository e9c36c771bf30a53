//! The network that adapts affinities to depth edges rather than colour edges: an encoder down to a sixteenth of the resolution
//! and a decoder back to full resolution (U-Net, Ronneberger et al. 2015, with sums instead of concatenations). It shares no
//! layers with the extractor, so either can be trained separately.

use super::grid::enlarged;
use super::layers::{Conv, ConvNorm, Init};
use burn::module::Module;
use burn::tensor::Tensor;
use lsdc_core::network::{CHANGES, EncoderConfig, NetworkConfig};
use lsdc_kernels::conv::ConvSpec;

/// The network with its weights.
#[derive(Module, Debug)]
pub(super) struct AffinityNet {
    /// Encoder levels from full resolution down, each at half the resolution of the previous one.
    pub(super) down: Vec<[ConvNorm; 2]>,
    /// Projection of the features of a pretrained encoder to a term added at the lowest resolution; zero before training.
    pub(super) encoded: Option<Conv>,
    /// Decoder levels from the lowest resolution up.
    pub(super) up: Vec<UpBlock>,
    pub(super) last: Conv,
}

/// One level of the decoder.
#[derive(Module, Debug)]
pub(super) struct UpBlock {
    /// Projection of the channels of the level below.
    pub(super) narrow: Conv,
    pub(super) mix: [ConvNorm; 2],
}

impl AffinityNet {
    pub(super) fn init(config: &NetworkConfig, init: &mut Init) -> Self {
        let (same, pointwise) = (ConvSpec::same(1), ConvSpec::pointwise());
        let widths = config.levels();
        let mut from = 3;
        let mut down = Vec::new();
        for (level, &width) in widths.iter().enumerate() {
            let first = if level == 0 {
                same
            } else {
                ConvSpec::halving()
            };
            down.push([
                ConvNorm::init(from, width, 3, first, init),
                ConvNorm::init(width, width, 3, same, init),
            ]);
            from = width;
        }
        let encoded = (config.extractor.encoder > 0).then(|| {
            let channels = EncoderConfig::small().channels();
            Conv::zero(channels, from, 1, pointwise, init)
        });
        let pairs = widths.windows(2).rev();
        let up = pairs.map(|pair| UpBlock {
            narrow: Conv::init(pair[1], pair[0], 1, pointwise, init),
            mix: [0, 1].map(|_| ConvNorm::init(pair[0], pair[0], 3, same, init)),
        });
        Self {
            down,
            encoded,
            up: up.collect(),
            last: Conv::zero(config.affinities, CHANGES, 1, pointwise, init),
        }
    }

    /// Computes the changes of affinities `[batch, height, width, CHANGES]` from images `[batch, height, width, 3]`.
    pub(super) fn forward(&self, images: Tensor<4>, encoded: Option<Tensor<4>>) -> Tensor<4> {
        let run = |x, layers: &[ConvNorm; 2]| layers.iter().fold(x, |x, l| l.forward_relu(x));
        let mut x = images;
        let mut levels = Vec::new();
        for layers in &self.down {
            x = run(x, layers);
            levels.push(x.clone());
        }
        levels.pop();
        if let (Some(conv), Some(encoded)) = (&self.encoded, encoded) {
            let size = (x.dims()[1], x.dims()[2]);
            x = x + enlarged(conv.forward(encoded), size);
        }
        for (rise, level) in self.up.iter().zip(levels.into_iter().rev()) {
            let size = (level.dims()[1], level.dims()[2]);
            x = run(enlarged(rise.narrow.forward(x), size) + level, &rise.mix);
        }
        self.last.forward(x)
    }
}
