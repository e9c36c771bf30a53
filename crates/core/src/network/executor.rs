//! What runs the layers of a network. The network's structure is written once, for the CPU and for every other device.

use lsdc_kernels::conv::{ConvSpec, Layer};
use lsdc_kernels::simd::Level;
use std::fmt::Debug;

/// Turns the weights of a layer into what an [`Executor`] runs.
pub trait Prepare {
    /// A convolution with its weights.
    type Layer: Debug + Send + Sync;

    /// A convolution with weights `[outputs, channels, taps, taps]` of these `sizes` (outputs, channels, taps), with 1 channel
    /// if each is convolved alone; an empty bias is 0.
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

/// Runs layers on maps `[height, width, channels]`, or records that they are to run.
pub trait Executor {
    /// A convolution with its weights.
    type Layer;
    /// A handle of a map; clones share the values.
    type Map: Clone;

    /// The output of a layer, to which `skip` is added before the ReLU.
    fn layer(
        &self,
        layer: &Self::Layer,
        x: &Self::Map,
        skip: Option<&Self::Map>,
        relu: bool,
    ) -> Self::Map;

    /// `layer(x)` plus a coarser map that is enlarged bilinearly.
    fn layer_plus_enlarged(
        &self,
        layer: &Self::Layer,
        x: &Self::Map,
        coarser: &Self::Map,
    ) -> Self::Map;

    /// `map` plus `layer(x)` that is enlarged bilinearly; the layer is 1x1 and has no bias, so that an executor may
    /// enlarge x instead.
    fn plus_enlarged_layer(&self, map: Self::Map, layer: &Self::Layer, x: &Self::Map) -> Self::Map;

    /// A convolution of each channel with its ReLU, then a 1x1 convolution, to which `skip` is added.
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

    /// A map enlarged bilinearly to the size of another.
    fn enlarged(&self, map: &Self::Map, like: &Self::Map) -> Self::Map;

    /// Means over windows of each size in pixels, cut off at the end.
    fn averages(&self, map: &Self::Map, sizes: &[usize]) -> Vec<Self::Map>;

    /// The channels of two maps of one size, then of coarser ones, which are enlarged bilinearly.
    fn concatenated(&self, maps: [&Self::Map; 2], coarser: &[Self::Map]) -> Self::Map;

    /// The output of layers one after the other, each with a ReLU.
    fn layers(&self, layers: &[Self::Layer], x: Self::Map) -> Self::Map {
        let layers = layers.iter();
        layers.fold(x, |x, layer| self.layer(layer, &x, None, true))
    }
}

/// Runs what the depth head of an encoder needs beside the layers of networks.
pub trait HeadExecutor: Executor {
    /// Height and width of a map.
    fn size(&self, map: &Self::Map) -> (usize, usize);

    /// A map without its negative values.
    fn rectified(&self, map: &Self::Map) -> Self::Map;

    /// The sum of two maps of one size.
    fn sum(&self, one: &Self::Map, other: &Self::Map) -> Self::Map;

    /// The output of a 1x1 convolution whose outputs are `[row, column, channel]` of a block of pixels of some side: each pixel
    /// becomes its block.
    fn in_blocks(&self, layer: &Self::Layer, side: usize, x: &Self::Map) -> Self::Map;

    /// A map enlarged bilinearly to a height and width, with the centres of its corner pixels in those of the corners.
    fn enlarged_by_corners(&self, map: &Self::Map, size: (usize, usize)) -> Self::Map;
}
