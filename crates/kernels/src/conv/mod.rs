//! 2-D convolution of images `[batch, height, width, channels]`, and its gradients.

mod depthwise;
mod layer;
mod shape;
mod unfold;
mod winograd;

pub use layer::{Layer, input_gradient, weight_gradient};
pub use shape::Shape;

/// Stride, padding and dilation, equal in both directions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvSpec {
    /// Distance between outputs, in input pixels.
    pub stride: usize,
    /// Padding with zeros on each side.
    pub padding: usize,
    /// Distance between taps, in input pixels.
    pub dilation: usize,
    /// Whether the convolution is depthwise: weights are `[channels, 1, taps, taps]`.
    pub depthwise: bool,
}

impl ConvSpec {
    /// A 3x3 convolution at stride 1 that keeps the size.
    pub fn same(dilation: usize) -> Self {
        Self {
            stride: 1,
            padding: dilation,
            dilation,
            depthwise: false,
        }
    }

    /// A 3x3 convolution at stride 2: half the size, rounded up.
    pub fn halving() -> Self {
        Self {
            stride: 2,
            ..Self::same(1)
        }
    }

    /// A 1x1 convolution.
    pub fn pointwise() -> Self {
        Self {
            padding: 0,
            ..Self::same(1)
        }
    }

    /// A depthwise convolution with `taps` x `taps` weights, an odd number: the size is divided by the stride and rounded up.
    pub fn depthwise(taps: usize, stride: usize) -> Self {
        Self {
            stride,
            padding: taps / 2,
            depthwise: true,
            ..Self::same(1)
        }
    }

    /// The output's length along an axis of `length` for a kernel of `taps`; 0 if the kernel does not fit.
    pub fn output(self, length: usize, taps: usize) -> usize {
        let reach = self.dilation * (taps - 1) + 1;
        (length + 2 * self.padding)
            .checked_sub(reach)
            .map_or(0, |steps| steps / self.stride + 1)
    }
}
