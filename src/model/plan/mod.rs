//! A trained network prepared for the CPU: the same base functions as `BasisNet`, several times
//! faster.
//!
//! Normalisation is folded into the weights, bias, skip and ReLU into the kernels; layers hand over
//! maps `[height, width, channels]` as they are. At full resolution nothing is ever formed whole:
//! the first layer of the MLP is applied before enlargement, which commutes with it, and the fit's
//! weights are folded into the last.

mod edge_net;
mod extractor;
mod head;
mod map;
mod run;
#[cfg(test)]
mod tests;

use super::BasisNet;
use super::edges::strengths_of;
use crate::simd::{Level, Scratch};
use edge_net::EdgePlan;
use extractor::ExtractorPlan;
use head::HeadPlan;
use map::{Map, Pool};
use run::Run;
use std::sync::Arc;

/// A network prepared for one instruction set. Clones share weights and memory.
#[derive(Clone, Debug)]
pub struct Plan(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    extractor: ExtractorPlan,
    head: HeadPlan,
    edges: Option<EdgePlan>,
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
            edges: match &net.edges {
                None => None,
                Some(edges) => Some(EdgePlan::new(edges, level)?),
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
            scratch,
            pool,
            ..
        } = &*self.0;
        let mut map = pool.take(size.0, size.1, 3);
        map.values.copy_from_slice(image);
        // On a thread of the pool, or each of some sixty layers would wake and await it anew.
        let inputs = rayon::scope(|_| {
            let features = extractor.forward(&map, Run { scratch, pool });
            let inputs = head.enter(&features, pool);
            pool.give(features);
            inputs
        });
        PlannedBases {
            plan: self.clone(),
            inputs,
            image: map,
        }
    }
}

/// The base functions of an image: cheap to read anywhere, again and again.
#[derive(Clone, Debug)]
pub struct PlannedBases {
    plan: Plan,
    /// What the features add to the first hidden layer, at their resolution.
    inputs: Map,
    image: Map,
}

impl Drop for PlannedBases {
    fn drop(&mut self) {
        let maps = [&mut self.inputs, &mut self.image].map(std::mem::take);
        for map in maps {
            self.plan.0.pool.give(map);
        }
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
        let Inner {
            edges,
            scratch,
            pool,
            ..
        } = &*self.plan.0;
        let size = (self.image.height, self.image.width);
        let run = Run { scratch, pool };
        let changes = rayon::scope(|_| Some(edges.as_ref()?.forward(&self.image, run)));
        let values = changes.as_ref().map(|map| &map.values[..]);
        let strengths = strengths_of(&self.image.values, size, values);
        if let Some(map) = changes {
            pool.give(map);
        }
        (strengths, size)
    }

    /// Bases x weights at every pixel of an output of `size` (height, width).
    pub fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        let Inner { head, scratch, .. } = &*self.plan.0;
        head.combine(&self.inputs, size, weights, scratch)
    }
}
