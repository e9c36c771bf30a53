//! A block of a transformer.

use super::config::{EncoderConfig, LAYER_EPSILON};
use crate::error::WeightsError;
use crate::network::tensors::Tensors;
use lsdc_kernels::attention::{attention, gelu, layer_norm};
use lsdc_kernels::simd::{Level, Packed, Scratch, Tail};
use rayon::prelude::*;
use std::sync::Arc;

/// Tokens that a task takes of so many: an even number of tasks of at most 84 tokens.
pub(super) fn share(tokens: usize) -> usize {
    const MOST: usize = 56;
    tokens.div_ceil(2 * tokens.div_ceil(2 * MOST).max(1)).max(1)
}

/// What blocks work with.
#[derive(Clone, Copy)]
pub(super) struct Workspace<'a> {
    pub(super) level: Level,
    pub(super) scratch: &'a Scratch,
}

#[derive(Debug)]
pub(super) struct Block {
    width: usize,
    heads: usize,
    /// Gain and shift of the normalisation before attention, and before the perceptron.
    norms: [(Vec<f32>, Vec<f32>); 2],
    /// To queries, keys and values.
    queries: Packed,
    /// From the answers of all heads; the scale of the layer is part of it, as of `second`.
    mixed: Arc<Packed>,
    first: Arc<Packed>,
    second: Arc<Packed>,
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
            Ok::<_, WeightsError>(Packed::new(tensors.level, (depth, columns), &bias, at))
        };
        Ok(Self {
            width,
            heads: config.heads,
            norms: [norm("norm1")?, norm("norm2")?],
            queries: linear("attn.qkv", (width, 3 * width), None)?,
            mixed: Arc::new(linear("attn.proj", (width, width), Some("ls1.gamma"))?),
            first: Arc::new(linear("mlp.fc1", (width, hidden), None)?),
            second: Arc::new(linear("mlp.fc2", (hidden, width), Some("ls2.gamma"))?),
        })
    }

    /// The block with `change(input, output)` added to the weights of queries, keys and values, which lie side by side.
    /// All other weights are shared.
    pub(super) fn plus(&self, change: impl Fn(usize, usize) -> f32) -> Self {
        Self {
            width: self.width,
            heads: self.heads,
            norms: self.norms.clone(),
            queries: self.queries.plus(change),
            mixed: self.mixed.clone(),
            first: self.first.clone(),
            second: self.second.clone(),
        }
    }

    /// What attention answers to the tokens, head by head; `rows` takes queries, keys and values.
    pub(super) fn attend(
        &self,
        workspace: Workspace<'_>,
        tokens: &[f32],
        rows: &mut [f32],
        answers: &mut [f32],
    ) {
        let width = self.width;
        let part = share(tokens.len() / width) * width;
        let parts = rows.par_chunks_mut(3 * part);
        parts.zip(tokens.par_chunks(part)).for_each(|(rows, x)| {
            workspace.scratch.with(x.len(), |y| {
                self.normalise(workspace, 0, x, y);
                self.queries.apply(y, Tail::default(), rows);
            });
        });
        let heads = (self.heads, width / self.heads);
        attention(workspace.level, rows, heads, workspace.scratch, answers);
    }

    /// Adds to the tokens what attention answered, then what the perceptron makes of them.
    pub(super) fn transform(&self, workspace: Workspace<'_>, answers: &[f32], tokens: &mut [f32]) {
        let width = self.width;
        let hidden = self.first.columns();
        let part = share(tokens.len() / width) * width;
        let parts = tokens.par_chunks_mut(part);
        parts
            .zip(answers.par_chunks(part))
            .for_each(|(x, answers)| {
                let count = x.len() / width;
                workspace
                    .scratch
                    .with(count * (2 * width + hidden), |memory| {
                        let (sum, memory) = memory.split_at_mut(count * width);
                        let (y, inner) = memory.split_at_mut(count * width);
                        self.mixed.apply(answers, added(x), sum);
                        self.normalise(workspace, 1, sum, y);
                        self.first.apply(y, Tail::default(), inner);
                        gelu(workspace.level, inner);
                        self.second.apply(inner, added(sum), x);
                    });
            });
    }

    fn normalise(&self, workspace: Workspace<'_>, which: usize, x: &[f32], output: &mut [f32]) {
        let (gain, shift) = &self.norms[which];
        layer_norm(workspace.level, x, (gain, shift), LAYER_EPSILON, output);
    }
}

/// What is added to a product.
fn added(skip: &[f32]) -> Tail<'_> {
    Tail {
        skip: Some(skip),
        relu: false,
    }
}
