//! A block of a transformer.

use super::config::LAYER_EPSILON;
use super::weights::BlockWeights;
use lsdc_kernels::attention::{attention, gelu, layer_norm};
use lsdc_kernels::simd::{Level, Packed, Scratch, Tail};
use rayon::prelude::*;

/// Returns the number of tokens per task, for an even number of tasks of at most 84 tokens.
pub(super) fn tokens_per_task(tokens: usize) -> usize {
    const MOST: usize = 56;
    tokens.div_ceil(2 * tokens.div_ceil(2 * MOST).max(1)).max(1)
}

#[derive(Debug)]
pub(super) struct Block {
    level: Level,
    width: usize,
    heads: usize,
    /// Gain and shift of the normalisation before attention, and before the MLP.
    norms: [(Vec<f32>, Vec<f32>); 2],
    queries_keys_values: Packed,
    /// Output projection of all heads, with the layer scale folded in, as in `second`.
    projection: Packed,
    /// The layers of the MLP.
    first: Packed,
    second: Packed,
}

impl Block {
    pub(super) fn new(level: Level, heads: usize, weights: &BlockWeights<'_>) -> Self {
        let [queries_keys_values, projection, first, second] = weights.layers.map(|layer| {
            let depth = layer.depth();
            let scale = |column: usize| layer.scale.map_or(1.0, |scales| scales[column]);
            let bias = layer.bias.iter().enumerate();
            let bias: Vec<f32> = bias.map(|(column, b)| b * scale(column)).collect();
            let at =
                |row: usize, column: usize| layer.weights[column * depth + row] * scale(column);
            Packed::new(level, (depth, bias.len()), &bias, at)
        });
        Self {
            level,
            width: weights.norms[0].0.len(),
            heads,
            norms: weights
                .norms
                .map(|(gain, shift)| (gain.to_vec(), shift.to_vec())),
            queries_keys_values,
            projection,
            first,
            second,
        }
    }

    /// Computes attention between the tokens for each head; `rows` hold queries, keys and values.
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

    /// Adds the projected attention, then the output of the MLP, to the tokens.
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

/// A tail that adds rows to a product.
fn plus(skip: &[f32]) -> Tail<'_> {
    Tail {
        skip: Some(skip),
        relu: false,
    }
}
