//! Data shared by the layers while a network runs.

use super::map::{Map, Pool};
use lsdc_kernels::conv::Layer;
use lsdc_kernels::simd::{Scratch, Tail};

/// Memory for the layers of a run.
#[derive(Clone, Copy)]
pub(super) struct Run<'a> {
    pub(super) scratch: &'a Scratch,
    pub(super) pool: &'a Pool,
}

impl Run<'_> {
    pub(super) fn layer(self, layer: &Layer, x: &Map, skip: Option<&Map>, relu: bool) -> Map {
        let size = [1, x.height, x.width];
        let shape = layer.shape(size);
        let (height, width) = shape.out();
        let mut output = self.pool.take(height, width, shape.outputs);
        let tail = Tail {
            skip: skip.map(|map| &map.values[..]),
            relu,
        };
        layer.apply(&x.values, size, tail, self.scratch, &mut output.values);
        output
    }
}
