//! Memory shared by the layers of a network.

use super::map::{Map, Pool};
use lsdc_kernels::conv::Layer;
use lsdc_kernels::simd::{Scratch, Tail};

/// Memory for the layers of a network.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    pub(super) scratch: Scratch,
    pub(super) pool: Pool,
}

impl Workspace {
    /// The output of a layer, to which `skip` is added before the ReLU.
    pub(super) fn layer(&self, layer: &Layer, x: &Map, skip: Option<&Map>, relu: bool) -> Map {
        let size = [1, x.height, x.width];
        let shape = layer.shape(size);
        let (height, width) = shape.out();
        let mut output = self.pool.take(height, width, shape.outputs);
        let tail = Tail {
            skip: skip.map(|map| &map.values[..]),
            relu,
        };
        layer.apply(&x.values, size, tail, &self.scratch, &mut output.values);
        output
    }

    /// The output of layers one after the other, each with a ReLU.
    pub(super) fn layers(&self, layers: &[Layer], x: Map) -> Map {
        let layers = layers.iter();
        layers.fold(x, |x, layer| self.layer(layer, &x, None, true))
    }

    /// Frees the memory that is not in use.
    pub(super) fn clear(&self) {
        self.scratch.clear();
        self.pool.clear();
    }
}
