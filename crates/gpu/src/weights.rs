//! The weights of all layers in one buffer, in the order in which the kernels read them.

use half::f16;
use lsdc_core::network::{NormWeights, Prepare, TokenLayer};
use lsdc_kernels::conv::ConvSpec;
use std::cell::RefCell;

/// The offset that stands for no bias or no map.
pub(crate) const NONE: u32 = u32::MAX;

/// A convolution with its weights in the shared buffer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GpuLayer {
    pub(crate) outputs: usize,
    pub(crate) taps: usize,
    pub(crate) spec: ConvSpec,
    /// In vec4.
    pub(crate) weights: u32,
    /// In vec4, or [`NONE`].
    pub(crate) bias: u32,
    /// Whether the weights are in f16, which is exact.
    pub(crate) half: bool,
    /// Factors of the outputs, in vec4, or [`NONE`].
    pub(crate) scale: u32,
}

/// Number of vec4 for this number of values.
pub(crate) fn quads(values: usize) -> usize {
    values.div_ceil(4)
}

/// Collects weights.
#[derive(Debug, Default)]
pub(crate) struct Packer(RefCell<Vec<f32>>);

impl Packer {
    /// Appends rows of `columns` values each, padded with zeros to whole vec4, and `padding` rows of zeros.
    pub(crate) fn rows(&self, values: &[f32], columns: usize, padding: usize) -> u32 {
        let mut all = self.0.borrow_mut();
        let first = all.len() / 4;
        for row in values.chunks_exact(columns.max(1)) {
            all.extend(row);
            let length = all.len().next_multiple_of(4);
            all.resize(length, 0.0);
        }
        let length = all.len() + 4 * quads(columns) * padding;
        all.resize(length, 0.0);
        first as u32
    }

    /// Packs a layer of the transformer. Its weights are stored in f16 if that is exact, as for the published encoder.
    pub(crate) fn token_layer(&self, layer: &TokenLayer<'_>) -> GpuLayer {
        let (inputs, outputs) = (layer.depth(), layer.bias.len());
        self.product(layer.weights, [outputs, inputs], layer.bias, layer.scale)
    }

    /// Packs weights `[outputs, inputs]`, both multiples of 4.
    pub(crate) fn product(
        &self,
        weights: &[f32],
        [outputs, inputs]: [usize; 2],
        bias: &[f32],
        scale: Option<&[f32]>,
    ) -> GpuLayer {
        let is_exact = |&value: &f32| f16::from_f32(value).to_f32().to_bits() == value.to_bits();
        let half = weights.iter().all(is_exact);
        let transposed = (0..inputs).flat_map(|i| (0..outputs).map(move |o| (i, o)));
        let values: Vec<f32> = transposed.map(|(i, o)| weights[o * inputs + i]).collect();
        let weights = if half {
            let pairs = values.chunks(2).map(|pair| {
                let bits = |i: usize| {
                    pair.get(i)
                        .map_or(0, |&v| u32::from(f16::from_f32(v).to_bits()))
                };
                f32::from_bits(bits(0) | bits(1) << 16)
            });
            let pairs: Vec<f32> = pairs.collect();
            self.rows(&pairs, pairs.len(), 0)
        } else {
            self.rows(&values, outputs, 0)
        };
        GpuLayer {
            outputs,
            taps: 1,
            spec: ConvSpec::pointwise(),
            weights,
            bias: self.rows(bias, bias.len(), 0),
            half,
            scale: scale.map_or(NONE, |scale| self.rows(scale, scale.len(), 0)),
        }
    }

    /// Packs gain, then shift of a normalisation.
    pub(crate) fn norm(&self, (gain, shift): NormWeights<'_>) -> u32 {
        let first = self.rows(gain, gain.len(), 0);
        self.rows(shift, shift.len(), 0);
        first
    }

    pub(crate) fn into_values(self) -> Vec<f32> {
        self.0.into_inner()
    }
}

impl Prepare for &Packer {
    type Layer = GpuLayer;

    fn layer(
        &self,
        weights: &[f32],
        [outputs, channels, taps]: [usize; 3],
        bias: &[f32],
        spec: ConvSpec,
    ) -> GpuLayer {
        let area = taps * taps;
        // For each tap and channel, the outputs; channels are padded to whole vec4.
        let padded = channels.next_multiple_of(4);
        let mut rows = Vec::with_capacity(area * padded * outputs);
        for tap in 0..area {
            if spec.depthwise {
                rows.extend((0..outputs).map(|o| weights[o * area + tap]));
                continue;
            }
            for channel in 0..channels {
                rows.extend((0..outputs).map(|o| weights[(o * channels + channel) * area + tap]));
            }
            rows.resize(rows.len() + (padded - channels) * outputs, 0.0);
        }
        let first = self.rows(&rows, outputs, 0);
        // The bias of a depthwise convolution follows its weights, even if it is 0.
        let bias = match bias {
            [] if spec.depthwise => self.rows(&[], outputs, 1),
            [] => NONE,
            _ => self.rows(bias, outputs, 0),
        };
        GpuLayer {
            outputs,
            taps,
            spec,
            weights: first,
            bias,
            half: false,
            scale: NONE,
        }
    }
}
