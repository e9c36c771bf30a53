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
    /// Zeros on each side.
    pub padding: usize,
    /// Distance between taps, in input pixels.
    pub dilation: usize,
    /// Each channel is convolved alone: weights are `[channels, 1, taps, taps]`.
    pub depthwise: bool,
}

impl ConvSpec {
    /// 3x3 at stride 1 with the size kept.
    pub fn same(dilation: usize) -> Self {
        Self {
            stride: 1,
            padding: dilation,
            dilation,
            depthwise: false,
        }
    }

    /// 3x3 at stride 2: half the size, rounded up.
    pub fn halving() -> Self {
        Self {
            stride: 2,
            ..Self::same(1)
        }
    }

    /// 1x1.
    pub fn pointwise() -> Self {
        Self {
            padding: 0,
            ..Self::same(1)
        }
    }

    /// Each channel alone, with `taps` x `taps` weights, an odd number: the size divided by the stride, rounded up.
    pub fn depthwise(taps: usize, stride: usize) -> Self {
        Self {
            stride,
            padding: taps / 2,
            depthwise: true,
            ..Self::same(1)
        }
    }

    /// The output's length along an axis of `length` for a kernel of `taps`; 0 if none fits.
    pub fn output(self, length: usize, taps: usize) -> usize {
        let reach = self.dilation * (taps - 1) + 1;
        (length + 2 * self.padding)
            .checked_sub(reach)
            .map_or(0, |steps| steps / self.stride + 1)
    }
}
