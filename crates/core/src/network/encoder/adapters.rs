//! Low-rank changes of attention that were trained with a network. They are added to the weights of an encoder once, so
//! they do not slow it down.

use super::Encoder;
use crate::error::{Error, WeightsError};
use crate::network::config::AdapterConfig;
use crate::network::tensors::Tensors;
use crate::tensor::Tensor;
use std::collections::BTreeMap;

/// What the names of the tensors of adapters begin with.
pub const ADAPTERS: &str = "adapters.";
/// Why adapters do not belong to an encoder.
pub const MORE_BLOCKS: &str = "it has adapters for more blocks than its encoder has";

/// Two matrices whose product, divided by their rank, is added to a matrix.
struct LowRankUpdate<'a> {
    /// `[width, rank]`
    down: &'a [f32],
    /// `[rank, width]`
    up: &'a [f32],
    width: usize,
}

impl<'a> LowRankUpdate<'a> {
    fn new(
        tensors: &Tensors<'a>,
        name: &str,
        width: usize,
        rank: usize,
    ) -> Result<Self, WeightsError> {
        let values = |part: &str, shape: [usize; 2]| {
            tensors.values(&format!("{ADAPTERS}{name}.{part}.weight"), &shape)
        };
        Ok(Self {
            down: values("down", [width, rank])?,
            up: values("up", [rank, width])?,
            width,
        })
    }

    fn at(&self, row: usize, column: usize) -> f32 {
        let rank = self.up.len() / self.width;
        let down = &self.down[row * rank..][..rank];
        let up = self.up[column..].iter().step_by(self.width);
        let terms = down.iter().zip(up);
        let sum: f64 = terms.map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        (sum / rank as f64) as f32
    }
}

impl Encoder {
    /// The encoder with the adapters among these tensors. It shares the weights that they do not change.
    ///
    /// # Errors
    /// Adapters of more blocks than there are, and tensors that are missing or of the wrong shape.
    pub fn with_adapters(
        &self,
        config: AdapterConfig,
        tensors: &BTreeMap<String, Tensor>,
    ) -> Result<Self, Error> {
        Ok(self.adapted(config, &Tensors::new(tensors, self.level))?)
    }

    /// The same from tensors that record which of them were used.
    pub(in crate::network) fn adapted(
        &self,
        AdapterConfig { blocks, rank }: AdapterConfig,
        tensors: &Tensors<'_>,
    ) -> Result<Self, WeightsError> {
        let width = self.config.width;
        let Some(first) = self.blocks.len().checked_sub(blocks) else {
            return Err(WeightsError::Unsupported(MORE_BLOCKS));
        };
        let mut adapted = self.clone();
        for (i, block) in adapted.blocks[first..].iter_mut().enumerate() {
            let update = |part: &str| {
                let name = format!("blocks.{i}.{part}");
                LowRankUpdate::new(tensors, &name, width, rank)
            };
            let (queries, values) = (update("queries")?, update("values")?);
            *block = block.plus(|row, column| match column / width {
                0 => queries.at(row, column),
                2 => values.at(row, column % width),
                // Keys.
                _ => 0.0,
            });
        }
        Ok(adapted)
    }
}
