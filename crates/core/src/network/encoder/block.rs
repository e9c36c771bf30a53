//! A block of a transformer.

use super::config::{EncoderConfig, LAYER_EPSILON};
use crate::error::WeightsError;
use crate::network::tensors::Tensors;
use lsdc_kernels::attention::{attention, gelu, layer_norm};
use lsdc_kernels::simd::{Level, Packed, Scratch, Tail};
use rayon::prelude::*;

/// Tokens of one task, for an even number of tasks of at most 84 tokens.
pub(super) fn tokens_per_task(tokens: usize) -> usize {
    const MOST: usize = 56;
    tokens.div_ceil(2 * tokens.div_ceil(2 * MOST).max(1)).max(1)
}

#[derive(Debug)]
pub(super) struct Block {
    level: Level,
    width: usize,
    heads: usize,
    /// Gain and shift of the normalisation before attention, and before the perceptron.
    norms: [(Vec<f32>, Vec<f32>); 2],
    queries_keys_values: Packed,
    /// The projection of the outputs of all heads, with the scale of the layer, as in `second`.
    projection: Packed,
    /// The layers of the perceptron.
    first: Packed,
    second: Packed,
}

impl Block {
    pub(super) fn new(
        config: &EncoderConfig,
        index: usize,
        tensors: &Tensors<'_>,
    ) -> Result<Self, WeightsError> {
        let (width, hidden) = (config.width, config.hidden);
        let name = |part: &str| format!("blocks.{index}.{part}");
        let vector = |part: &str, length: usize| tensors.values(&name(part), &[length]);
        let norm = |part: &str| -> Result<_, WeightsError> {
            let gain = vector(&format!("{part}.weight"), width)?.to_vec();
            Ok((gain, vector(&format!("{part}.bias"), width)?.to_vec()))
        };
        let linear = |part: &str, (depth, columns): (usize, usize), scale: Option<&str>| {
            let weights = tensors.values(&name(&format!("{part}.weight")), &[columns, depth])?;
            let bias = vector(&format!("{part}.bias"), columns)?;
            let scales = match scale {
                Some(scale) => vector(scale, columns)?.to_vec(),
                None => vec![1.0; columns],
            };
            let bias: Vec<f32> = bias.iter().zip(&scales).map(|(b, s)| b * s).collect();
            let at = |row: usize, column: usize| weights[column * depth + row] * scales[column];
            Ok::<_, WeightsError>(Packed::new(tensors.target, (depth, columns), &bias, at))
        };
        Ok(Self {
            level: tensors.target,
            width,
            heads: config.heads,
            norms: [norm("norm1")?, norm("norm2")?],
            queries_keys_values: linear("attn.qkv", (width, 3 * width), None)?,
            projection: linear("attn.proj", (width, width), Some("ls1.gamma"))?,
            first: linear("mlp.fc1", (width, hidden), None)?,
            second: linear("mlp.fc2", (hidden, width), Some("ls2.gamma"))?,
        })
    }

    /// Attention between the tokens, head by head; `rows` are for queries, keys and values.
    pub(super) fn attend(
        &self,
        tokens: &[f32],
        rows: &mut [f32],
        attended: &mut [f32],
        scratch: &Scratch,
    ) {
        let width = self.width;
        let part = tokens_per_task(tokens.len() / width) * width;
        let parts = rows.par_chunks_mut(3 * part);
        parts.zip(tokens.par_chunks(part)).for_each(|(rows, x)| {
            scratch.with(x.len(), |y| {
                self.normalise(0, x, y);
                self.queries_keys_values.apply(y, Tail::default(), rows);
            });
        });
        let heads = (self.heads, width / self.heads);
        attention(self.level, rows, heads, scratch, attended);
    }

    /// Adds to the tokens the projected attention, then the output of the perceptron.
    pub(super) fn transform(&self, attended: &[f32], tokens: &mut [f32], scratch: &Scratch) {
        let width = self.width;
        let hidden = self.first.columns();
        let part = tokens_per_task(tokens.len() / width) * width;
        let parts = tokens.par_chunks_mut(part).zip(attended.par_chunks(part));
        parts.for_each(|(x, attended)| {
            let count = x.len() / width;
            scratch.with(count * (2 * width + hidden), |memory| {
                let (sum, memory) = memory.split_at_mut(count * width);
                let (y, inner) = memory.split_at_mut(count * width);
                self.projection.apply(attended, plus(x), sum);
                self.normalise(1, sum, y);
                self.first.apply(y, Tail::default(), inner);
                gelu(self.level, inner);
                self.second.apply(inner, plus(sum), x);
            });
        });
    }

    fn normalise(&self, which: usize, x: &[f32], output: &mut [f32]) {
        let (gain, shift) = &self.norms[which];
        layer_norm(self.level, x, (gain, shift), LAYER_EPSILON, output);
    }
}

/// Adds rows to a product.
fn plus(skip: &[f32]) -> Tail<'_> {
    Tail {
        skip: Some(skip),
        relu: false,
    }
}
