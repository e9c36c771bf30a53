//! The sizes of one convolution.

use super::ConvSpec;

/// A convolution with a square kernel of images `[batch, height, width, channels]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shape {
    pub(crate) batch: usize,
    pub(crate) height: usize,
    pub(crate) width: usize,
    pub(crate) channels: usize,
    pub(crate) outputs: usize,
    pub(crate) taps: usize,
    pub(crate) spec: ConvSpec,
}

impl Shape {
    /// Rows and columns of the output.
    pub(crate) fn out(&self) -> (usize, usize) {
        (
            self.spec.output(self.height, self.taps),
            self.spec.output(self.width, self.taps),
        )
    }

    /// Images, rows and columns of the input.
    pub(crate) fn size(&self) -> [usize; 3] {
        [self.batch, self.height, self.width]
    }

    /// Pixels of all outputs.
    pub(crate) fn out_pixels(&self) -> usize {
        self.batch * self.out().0 * self.out().1
    }

    /// Inputs of one output: taps x channels.
    pub(crate) fn depth(&self) -> usize {
        self.taps * self.taps * self.channels
    }

    /// Whether an output reads just the pixel it lies on.
    pub(crate) fn is_pointwise(&self) -> bool {
        self.taps == 1 && self.spec == ConvSpec::pointwise()
    }

    /// Whether Winograd's algorithm applies.
    pub(crate) fn is_winograd(&self) -> bool {
        self.taps == 3 && self.spec == ConvSpec::same(self.spec.dilation)
    }
}
