//! The sizes of one convolution.

use super::ConvSpec;

/// A convolution of images `[batch, height, width, channels]` with a square kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Number of images.
    pub batch: usize,
    /// Rows of the input.
    pub height: usize,
    /// Columns of the input.
    pub width: usize,
    /// Channels of the input.
    pub channels: usize,
    /// Channels of the output.
    pub outputs: usize,
    /// Side of the kernel.
    pub taps: usize,
    /// Stride, padding and dilation.
    pub spec: ConvSpec,
}

impl Shape {
    /// Checks the sizes that every kernel relies on.
    pub(super) fn check(&self) {
        let ConvSpec {
            stride,
            dilation,
            depthwise,
            ..
        } = self.spec;
        assert!(
            self.taps > 0 && stride > 0 && dilation > 0,
            "taps, stride and dilation must be above 0"
        );
        assert!(
            !depthwise || self.channels == self.outputs,
            "a depthwise convolution has as many outputs as channels"
        );
    }

    /// Rows and columns of the output.
    pub fn out(&self) -> (usize, usize) {
        (
            self.spec.output(self.height, self.taps),
            self.spec.output(self.width, self.taps),
        )
    }

    /// Images, rows and columns of the input.
    pub fn size(&self) -> [usize; 3] {
        [self.batch, self.height, self.width]
    }

    /// Number of output pixels in the batch.
    pub fn out_pixels(&self) -> usize {
        self.batch * self.out().0 * self.out().1
    }

    /// Number of input values.
    pub(super) fn input_len(&self) -> usize {
        self.batch * self.height * self.width * self.channels
    }

    /// Number of output values.
    pub(super) fn output_len(&self) -> usize {
        self.out_pixels() * self.outputs
    }

    /// Number of inputs per output: taps x channels.
    pub fn depth(&self) -> usize {
        let channels = if self.spec.depthwise {
            1
        } else {
            self.channels
        };
        self.taps * self.taps * channels
    }

    /// Whether each output depends only on the pixel at its position.
    pub fn is_pointwise(&self) -> bool {
        self.taps == 1 && self.spec == ConvSpec::pointwise()
    }

    /// Whether Winograd's algorithm applies.
    pub fn is_winograd(&self) -> bool {
        self.taps == 3 && self.spec == ConvSpec::same(self.spec.dilation)
    }
}
