//! Traits to run the layers of a network. The network's structure is defined once, for the CPU and for every other device.

use lsdc_kernels::conv::{ConvSpec, Layer};
use lsdc_kernels::simd::Level;
use std::fmt::Debug;

/// Converts the weights of a layer to the form that an [`Executor`] runs.
pub trait Prepare {
    /// A convolution with its weights.
    type Layer: Debug + Send + Sync;

    /// Prepares a convolution with weights `[outputs, channels, taps, taps]` of these `sizes` (outputs, channels, taps), with 1
    /// channel in a depthwise convolution; an empty bias is 0.
    fn layer(
        &self,
        weights: &[f32],
        sizes: [usize; 3],
        bias: &[f32],
        spec: ConvSpec,
    ) -> Self::Layer;
}

impl Prepare for Level {
    type Layer = Layer;

    fn layer(&self, weights: &[f32], sizes: [usize; 3], bias: &[f32], spec: ConvSpec) -> Layer {
        Layer::new(*self, weights, sizes, bias, spec)
    }
}

/// Runs layers on maps `[height, width, channels]`, or records them.
pub trait Executor {
    /// A convolution with its weights.
    type Layer;
    /// A handle of a map; clones share the values.
    type Map: Clone;

    /// Returns the output of a layer; `skip` is added before the ReLU.
    fn layer(
        &self,
        layer: &Self::Layer,
        x: &Self::Map,
        skip: Option<&Self::Map>,
        relu: bool,
    ) -> Self::Map;

    /// Returns `layer(x)` plus a bilinearly upsampled coarser map.
    fn layer_plus_enlarged(
        &self,
        layer: &Self::Layer,
        x: &Self::Map,
        coarser: &Self::Map,
    ) -> Self::Map;

    /// Returns `map` plus the bilinearly upsampled `layer(x)`; the layer is 1x1 and has no bias, so that an executor may
    /// upsample x instead.
    fn plus_enlarged_layer(&self, map: Self::Map, layer: &Self::Layer, x: &Self::Map) -> Self::Map;

    /// A depthwise convolution with ReLU, then a 1x1 convolution; `skip` is added.
    fn separable(
        &self,
        depthwise: &Self::Layer,
        pointwise: &Self::Layer,
        x: &Self::Map,
        skip: Option<&Self::Map>,
    ) -> Self::Map {
        let inner = self.layer(depthwise, x, None, true);
        self.layer(pointwise, &inner, skip, false)
    }

    /// Upsamples a map bilinearly to the size of another.
    fn enlarged(&self, map: &Self::Map, like: &Self::Map) -> Self::Map;

    /// Returns means over windows of each size in pixels; windows are cropped at the end.
    fn averages(&self, map: &Self::Map, sizes: &[usize]) -> Vec<Self::Map>;

    /// Concatenates the channels of two maps of one size and of coarser maps, which are upsampled bilinearly.
    fn concatenated(&self, maps: [&Self::Map; 2], coarser: &[Self::Map]) -> Self::Map;

    /// Applies layers in sequence, each with a ReLU.
    fn layers(&self, layers: &[Self::Layer], x: Self::Map) -> Self::Map {
        let layers = layers.iter();
        layers.fold(x, |x, layer| self.layer(layer, &x, None, true))
    }
}

/// Runs the operations of the depth head of an encoder that other networks do not need.
pub trait HeadExecutor: Executor {
    /// Returns the height and width of a map.
    fn size(&self, map: &Self::Map) -> (usize, usize);

    /// Applies a ReLU to a map.
    fn rectified(&self, map: &Self::Map) -> Self::Map;

    /// Returns the sum of two maps of one size.
    fn sum(&self, one: &Self::Map, other: &Self::Map) -> Self::Map;

    /// Applies a 1x1 convolution whose outputs are `[row, column, channel]` of a square block with this side: each pixel
    /// becomes a block.
    fn in_blocks(&self, layer: &Self::Layer, side: usize, x: &Self::Map) -> Self::Map;

    /// Upsamples a map bilinearly to a height and width, with coinciding centres of the corner pixels.
    fn enlarged_by_corners(&self, map: &Self::Map, size: (usize, usize)) -> Self::Map;
}
