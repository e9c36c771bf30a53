//! The size of a frame in pixels.

use crate::data::DepthMap;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};

/// Size in rows and columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Size {
    /// Number of rows.
    pub height: usize,
    /// Number of columns.
    pub width: usize,
}

impl Size {
    /// Returns the size of a map.
    pub fn of(map: &DepthMap) -> Self {
        Self {
            height: map.height(),
            width: map.width(),
        }
    }

    /// Returns the size with the same aspect ratio and about this many pixels, as images are resized for the network.
    #[must_use]
    pub fn with_pixels(self, pixels: usize) -> Self {
        let scale = (pixels as f64 / (self.width as f64 * self.height as f64)).sqrt();
        let side = |length: usize| ((length as f64 * scale).round() as usize).max(1);
        Self {
            height: side(self.height),
            width: side(self.width),
        }
    }
}

impl Display for Size {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.height, self.width)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_of_pixels_keeps_the_shape() {
        let size = |height, width| Size { height, width };
        // sqrt(69312 / (375 x 1242)) = 0.38577.
        assert_eq!(size(375, 1242).with_pixels(69_312), size(145, 479));
        assert_eq!(size(228, 304).with_pixels(69_312), size(228, 304));
        // sqrt(400 / 100) = 2.
        assert_eq!(size(5, 20).with_pixels(400), size(10, 40));
        assert_eq!(size(1, 1000).with_pixels(10), size(1, 100));
    }
}
