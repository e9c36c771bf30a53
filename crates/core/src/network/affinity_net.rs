//! The affinity network, layer by layer. It distinguishes depth edges from colour edges, with an encoder down to a
//! sixteenth of the resolution and a decoder back to full resolution.

use super::config::{CHANGES, NetworkConfig};
use super::executor::{Executor, Prepare};
use super::tensors::Tensors;
use crate::error::WeightsError;
use lsdc_kernels::conv::ConvSpec;

#[derive(Debug)]
pub(super) struct AffinityNet<L> {
    down: Vec<[L; 2]>,
    /// Maps the encoder's features to an addend at the lowest resolution.
    encoded: Option<L>,
    up: Vec<UpBlock<L>>,
    last: L,
}

#[derive(Debug)]
struct UpBlock<L> {
    narrow: L,
    mix: [L; 2],
}

impl<L> AffinityNet<L> {
    /// `channels` is the number of channels of the encoder's features, if there is an encoder.
    pub(super) fn new(
        config: &NetworkConfig,
        channels: Option<usize>,
        tensors: &Tensors<'_, impl Prepare<Layer = L>>,
    ) -> Result<Self, WeightsError> {
        let (same, pointwise) = (ConvSpec::same(1), ConvSpec::pointwise());
        let widths = config.levels();
        let down = |level: usize| {
            let name = |layer: usize| format!("edges.down.{level}.{layer}");
            let (width, from, spec) = match level {
                0 => (widths[0], 3, same),
                _ => (widths[level], widths[level - 1], ConvSpec::halving()),
            };
            Ok([
                tensors.conv_norm(&name(0), [width, from, 3], spec)?,
                tensors.conv_norm(&name(1), [width, width, 3], same)?,
            ])
        };
        let up = |(i, pair): (usize, &[usize])| {
            let (to, from) = (pair[0], pair[1]);
            let mix = |layer: usize| {
                tensors.conv_norm(&format!("edges.up.{i}.mix.{layer}"), [to, to, 3], same)
            };
            let narrow = format!("edges.up.{i}.narrow");
            Ok(UpBlock {
                narrow: tensors.conv(&narrow, [to, from, 1], pointwise)?,
                mix: [mix(0)?, mix(1)?],
            })
        };
        let pairs = widths.windows(2).rev().enumerate();
        let last = [CHANGES, config.affinities, 1];
        Ok(Self {
            down: (0..widths.len()).map(down).collect::<Result<_, _>>()?,
            encoded: channels
                .map(|from| tensors.conv("edges.encoded", [widths[4], from, 1], pointwise))
                .transpose()?,
            up: pairs.map(up).collect::<Result<_, _>>()?,
            last: tensors.conv("edges.last", last, pointwise)?,
        })
    }

    /// Returns the network's modifications of the colour affinities, `[height, width, CHANGES]`.
    pub(super) fn forward<M: Clone>(
        &self,
        image: &M,
        encoded: Option<&M>,
        executor: &impl Executor<Layer = L, Map = M>,
    ) -> M {
        let mut x = image.clone();
        let mut levels: Vec<M> = Vec::new();
        for [first, second] in &self.down {
            let inner = executor.layer(first, &x, None, true);
            x = executor.layer(second, &inner, None, true);
            levels.push(x.clone());
        }
        levels.pop();
        if let (Some(layer), Some(map)) = (&self.encoded, encoded) {
            x = executor.plus_enlarged_layer(x, layer, map);
        }
        let pairs = self.up.iter().zip(levels.into_iter().rev());
        let x = pairs.fold(x, |x, (block, level)| {
            let sum = executor.plus_enlarged_layer(level, &block.narrow, &x);
            drop(x);
            executor.layers(&block.mix, sum)
        });
        executor.layer(&self.last, &x, None, false)
    }
}
