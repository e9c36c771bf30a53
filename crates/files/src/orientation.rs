//! The rotation of the pixels of an image file to the upright image (EXIF 2.32, tag 0x0112).

/// Stored size of an image, and its rotation to the upright image.
///
/// Cameras and COLMAP models refer to the pixels as stored; images are shown and completed upright.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Orientation {
    stored: (usize, usize),
    exif: u8,
}

impl From<(usize, usize)> for Orientation {
    /// Creates the orientation of an image of this width and height that is stored upright.
    fn from(stored: (usize, usize)) -> Self {
        Self { stored, exif: 1 }
    }
}

impl Orientation {
    /// Creates the orientation of an image of the stored width and height with this EXIF orientation, 1 to 8; other values
    /// mean upright.
    pub fn new(stored: (usize, usize), exif: u8) -> Self {
        let exif = if (1..=8).contains(&exif) { exif } else { 1 };
        Self { stored, exif }
    }

    /// Width and height as stored.
    pub fn stored(&self) -> (usize, usize) {
        self.stored
    }

    /// Width and height of the upright image.
    pub fn upright(&self) -> (usize, usize) {
        self.swapped(self.stored)
    }

    /// The value of the EXIF tag, 1 to 8.
    pub fn exif(&self) -> u8 {
        self.exif
    }

    /// Whether the image is stored upright.
    pub fn is_upright(&self) -> bool {
        self.exif == 1
    }

    /// Returns the same orientation for another upright size.
    #[must_use]
    pub(super) fn resized(&self, upright: (usize, usize)) -> Self {
        let stored = self.swapped(upright);
        Self { stored, ..*self }
    }

    /// Swaps width and height if rows become columns.
    fn swapped(&self, (width, height): (usize, usize)) -> (usize, usize) {
        if self.swaps() {
            (height, width)
        } else {
            (width, height)
        }
    }

    /// Converts a position in the stored image to the upright image.
    pub(super) fn turned(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        self.mirrored(if self.swaps() { [v, u] } else { [u, v] })
    }

    /// Converts a position in the upright image to the stored image.
    pub(super) fn turned_back(&self, position: [f64; 2]) -> [f64; 2] {
        let [u, v] = self.mirrored(position);
        if self.swaps() { [v, u] } else { [u, v] }
    }

    /// Whether rows become columns.
    fn swaps(&self) -> bool {
        self.exif >= 5
    }

    /// Flips the axes of the upright image that are opposite to those of the stored one.
    fn mirrored(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let (width, height) = self.upright();
        let across = matches!(self.exif, 2 | 3 | 6 | 7);
        let down = matches!(self.exif, 3 | 4 | 7 | 8);
        [
            if across { width as f64 - 1.0 - u } else { u },
            if down { height as f64 - 1.0 - v } else { v },
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, GrayImage, metadata};

    /// The reference is the image library, which turns the pixels.
    #[test]
    fn places_move_with_their_pixels_in_all_eight_orientations() {
        const SIZE: (usize, usize) = (5, 3);
        let stored = GrayImage::from_fn(SIZE.0 as u32, SIZE.1 as u32, |x, y| {
            image::Luma([(y * 5 + x) as u8])
        });
        for exif in 1..=8 {
            let orientation = Orientation::new(SIZE, exif);
            let mut upright = DynamicImage::from(stored.clone());
            upright.apply_orientation(metadata::Orientation::from_exif(exif).unwrap());
            let upright = upright.into_luma8();
            let (width, height) = orientation.upright();
            assert_eq!(
                upright.dimensions(),
                (width as u32, height as u32),
                "{exif}"
            );
            for (x, y, value) in stored.enumerate_pixels() {
                let position = [f64::from(x), f64::from(y)];
                let [u, v] = orientation.turned(position);
                assert_eq!(upright.get_pixel(u as u32, v as u32), value, "{exif}");
                assert_eq!(orientation.turned_back([u, v]), position, "{exif}");
            }
        }
    }
}
