//! A trained network prepared for the CPU: the same base functions as `BasisNet`, several times
//! faster.
//!
//! Normalisation is folded into the weights, bias, skip and ReLU into the kernels; layers hand over
//! maps `[height, width, channels]` as they are. At full resolution nothing is ever formed whole:
//! the first layer of the MLP is applied before enlargement, which commutes with it, and the fit's
//! weights are folded into the last.

mod detail;
mod extractor;
mod head;
mod map;
#[cfg(test)]
mod tests;

use super::BasisNet;
use super::edges::strengths_of;
use crate::simd::{Level, Scratch};
use detail::DetailPlan;
use extractor::{ExtractorPlan, Run};
use head::{HeadPlan, Inputs};
use map::{Map, Pool};
use std::sync::Arc;

/// A network prepared for one instruction set. Clones share weights and memory.
#[derive(Clone, Debug)]
pub struct Plan(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    extractor: ExtractorPlan,
    head: HeadPlan,
    detail: Option<DetailPlan>,
    scratch: Scratch,
    pool: Pool,
}

impl Plan {
    /// Prepares a network, or `None` if it has no fixed statistics to fold: group normalisation, or
    /// no hidden layer.
    pub fn new(net: &BasisNet, level: Level) -> Option<Self> {
        Some(Self(Arc::new(Inner {
            extractor: ExtractorPlan::new(&net.extractor, level)?,
            head: HeadPlan::new(&net.head, level)?,
            detail: match &net.detail {
                None => None,
                Some(detail) => Some(DetailPlan::new(detail, level)?),
            },
            scratch: Scratch::new(),
            pool: Pool::default(),
        })))
    }

    /// The base functions of one normalised image `[height, width, 3]`.
    ///
    /// # Panics
    /// If the image does not have `size.0 * size.1` pixels, at least one.
    pub fn bases(&self, image: &[f32], size: (usize, usize)) -> PlannedBases {
        let Inner {
            extractor,
            head,
            detail,
            scratch,
            pool,
        } = &*self.0;
        let mut map = pool.take(size.0, size.1, 3);
        map.values.copy_from_slice(image);
        // On a thread of the pool, or each of some sixty layers would wake and await it anew.
        let (inputs, changes) = rayon::scope(|_| {
            let run = Run { scratch, pool };
            let (features, half) = extractor.forward(&map, detail.is_some(), run);
            let (mut sharp, mut changes) = (None, None);
            if let (Some(detail), Some(half)) = (detail, half) {
                let [features, edges] = detail.forward(&map, half, &features, run);
                (sharp, changes) = (Some(features), Some(edges));
            }
            let inputs = Inputs {
                features: head.enter(&features, pool),
                detail: sharp,
            };
            pool.give(features);
            (inputs, changes)
        });
        PlannedBases {
            plan: self.clone(),
            inputs,
            image: map,
            changes,
        }
    }
}

/// The base functions of an image: cheap to read anywhere, again and again.
#[derive(Clone, Debug)]
pub struct PlannedBases {
    plan: Plan,
    inputs: Inputs,
    image: Map,
    /// By which edges differ from those of the colours.
    changes: Option<Map>,
}

impl Drop for PlannedBases {
    fn drop(&mut self) {
        let Inputs { features, detail } = std::mem::take(&mut self.inputs);
        let maps = [features, std::mem::take(&mut self.image)].into_iter();
        let maps = maps.chain(detail).chain(self.changes.take());
        maps.for_each(|map| self.plan.0.pool.give(map));
    }
}

impl PlannedBases {
    /// Values `[pixels, N + 1]` at pixels `y * width + x` of an output of `size` (height, width),
    /// the first function being the constant 1.
    pub fn at(&self, size: (usize, usize), pixels: &[u32]) -> Vec<f32> {
        let Inner { head, scratch, .. } = &*self.plan.0;
        head.rows(&self.inputs, size, pixels, scratch)
    }

    /// How strongly each pixel of the image is joined to its right and lower neighbour, `[height,
    /// width, 2]`, and height and width.
    pub fn edges(&self) -> (Vec<f32>, (usize, usize)) {
        let size = (self.image.height, self.image.width);
        let changes = self.changes.as_ref().map(|map| &map.values[..]);
        (strengths_of(&self.image.values, size, changes), size)
    }

    /// Bases x weights at every pixel of an output of `size` (height, width).
    pub fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        let Inner { head, scratch, .. } = &*self.plan.0;
        head.combine(&self.inputs, size, weights, scratch)
    }
}
