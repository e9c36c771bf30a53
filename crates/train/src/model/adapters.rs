//! Low-rank changes of attention in the last blocks of the pretrained encoder (Hu et al. 2022), trained with the network.
//! `lsdc_core::network::Encoder` adds the same to its weights.

use super::layers::{Init, Linear};
use super::parameters::tables;
use burn::module::Module;
use burn::tensor::Tensor;
use lsdc_core::network::{ADAPTERS, AdapterConfig};
use lsdc_core::weights::Tensor as Table;
use std::collections::BTreeMap;

/// The changes of all blocks that have them; named as the tensors in weights files.
#[derive(Module, Debug)]
pub struct Adapters {
    pub(super) blocks: Vec<Adapter>,
    #[module(skip)]
    rank: usize,
}

/// The changes of one block.
#[derive(Module, Debug)]
pub(super) struct Adapter {
    pub(super) queries: LowRank,
    pub(super) values: LowRank,
}

/// The product of two matrices, divided by their rank: 0 before training.
///
/// Steps of Adam and Muon are as large whatever the gradients are: without the division, those that suit layers throw
/// the encoder off (docs/weights.md).
#[derive(Module, Debug)]
pub(super) struct LowRank {
    down: Linear,
    up: Linear,
    #[module(skip)]
    rank: usize,
}

impl LowRank {
    fn init(width: usize, rank: usize, init: &mut Init) -> Self {
        Self {
            down: Linear::init(width, rank, init),
            up: Linear::zero(rank, width, init),
            rank,
        }
    }

    #[cfg(test)]
    pub(super) fn down(&self) -> &burn::module::Param<Tensor<2>> {
        self.down.weight()
    }

    #[cfg(test)]
    pub(super) fn up(&self) -> &burn::module::Param<Tensor<2>> {
        self.up.weight()
    }

    /// Rows `[rows, width]` times both.
    pub(super) fn forward(&self, rows: Tensor<2>) -> Tensor<2> {
        self.up.forward(self.down.forward(rows)) / self.rank as f64
    }
}

impl Adapters {
    /// For an encoder of that many channels.
    pub(super) fn init(config: AdapterConfig, width: usize, init: &mut Init) -> Self {
        let AdapterConfig { blocks, rank } = config;
        let blocks = (0..blocks).map(|_| Adapter {
            queries: LowRank::init(width, rank, init),
            values: LowRank::init(width, rank, init),
        });
        Self {
            blocks: blocks.collect(),
            rank,
        }
    }

    /// Their sizes.
    pub fn config(&self) -> AdapterConfig {
        AdapterConfig {
            blocks: self.blocks.len(),
            rank: self.rank,
        }
    }

    /// Their tensors by the names that they have in weights files.
    pub fn tensors(&self) -> BTreeMap<String, Table> {
        let tables = tables(self).into_iter();
        tables
            .map(|(name, table)| (format!("{ADAPTERS}{name}"), table))
            .collect()
    }
}
