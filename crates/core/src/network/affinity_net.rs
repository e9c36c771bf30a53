//! The affinity network, layer by layer. It distinguishes depth edges from colour edges, with an encoder down to a
//! sixteenth of the resolution and a decoder back to full resolution.

use super::config::{CHANGES, NetworkConfig};
use super::map::Map;
use super::tensors::Tensors;
use super::workspace::Workspace;
use crate::error::WeightsError;
use lsdc_kernels::conv::{ConvSpec, Layer};

#[derive(Debug)]
pub(super) struct AffinityNet {
    down: Vec<[Layer; 2]>,
    /// From the encoder's features to what is added at the lowest resolution.
    encoded: Option<Layer>,
    up: Vec<UpBlock>,
    last: Layer,
}

#[derive(Debug)]
struct UpBlock {
    narrow: Layer,
    mix: [Layer; 2],
}

impl AffinityNet {
    /// `channels` are those of the encoder's features, if there is an encoder.
    pub(super) fn new(
        config: &NetworkConfig,
        channels: Option<usize>,
        tensors: &Tensors<'_>,
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

    /// The changes of the affinities that follow from the colours, `[height, width, CHANGES]`.
    pub(super) fn forward(&self, image: &Map, encoded: Option<&Map>, workspace: &Workspace) -> Map {
        let mut levels: Vec<Map> = Vec::new();
        for [first, second] in &self.down {
            let x = workspace.layer(first, levels.last().unwrap_or(image), None, true);
            levels.push(workspace.layer(second, &x, None, true));
        }
        let mut lowest = levels.pop().unwrap_or_default();
        if let (Some(layer), Some(map)) = (&self.encoded, encoded) {
            lowest.add_enlarged(&workspace.layer(layer, map, None, false));
        }
        let pairs = self.up.iter().zip(levels.into_iter().rev());
        let x = pairs.fold(lowest, |x, (block, mut level)| {
            let narrow = workspace.layer(&block.narrow, &x, None, false);
            drop(x);
            level.add_enlarged(&narrow);
            drop(narrow);
            workspace.layers(&block.mix, level)
        });
        workspace.layer(&self.last, &x, None, false)
    }
}
