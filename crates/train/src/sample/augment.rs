//! Augmentation as in sparse-to-dense (Ma and Karaman 2018): zoom, with depths divided by it, rotation, mirroring, colour
//! jitter; optionally smaller images, greyscale, and degradations.

use super::degradations::{Degradation, blurred, compressed, noisy};
use image::{Rgb, RgbImage};
use lsdc_eval::data::{DepthMap, Frame, Target};
use lsdc_eval::sampling::{Protocol, Size};
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};

/// Strength of the augmentation in training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AugmentConfig {
    /// Largest zoom; drawn uniformly, starting at `shrink`. Depths are divided by it.
    pub zoom: f32,
    /// Smallest zoom. Below 1, images are extended by reflection, including depths; otherwise pixels outside the image have no
    /// depth.
    pub shrink: f32,
    /// Largest rotation about the image centre, in degrees in either direction.
    pub rotation: f32,
    /// Probability of a horizontal flip.
    pub mirror: f32,
    /// Largest relative change of brightness, contrast and saturation: factors are 1 +- this.
    pub jitter: f32,
    /// Probability of converting to greyscale.
    pub grey: f32,
    /// Gaussian blur: probability, and largest standard deviation in pixels.
    pub blur: Degradation,
    /// Noise: probability, and largest standard deviation in levels of 255.
    pub noise: Degradation,
    /// JPEG: probability, and largest reduction of the quality below 100.
    pub compression: Degradation,
}

impl Default for AugmentConfig {
    fn default() -> Self {
        Self {
            zoom: 1.5,
            rotation: 5.0,
            mirror: 0.5,
            jitter: 0.4,
            ..Self::none()
        }
    }
}

impl AugmentConfig {
    /// Returns settings that leave frames unchanged.
    pub fn none() -> Self {
        Self {
            zoom: 1.0,
            shrink: 1.0,
            rotation: 0.0,
            mirror: 0.0,
            jitter: 0.0,
            grey: 0.0,
            blur: Degradation::default(),
            noise: Degradation::default(),
            compression: Degradation::default(),
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<()> {
        let fine = self.zoom >= 1.0
            && self.zoom.is_finite()
            && self.shrink > 0.0
            && self.shrink <= 1.0
            && (0.0..=180.0).contains(&self.rotation)
            && (0.0..=1.0).contains(&self.mirror)
            && (0.0..1.0).contains(&self.jitter)
            && (0.0..=1.0).contains(&self.grey)
            && self.blur.is_sound(MOST_BLUR)
            && self.noise.is_sound(255.0)
            && self.compression.is_sound(99.0);
        if fine {
            Ok(())
        } else {
            Err(Error::config(
                "`augment`: zoom >= 1, shrink 0 (exclusive)..1, rotation 0..180, mirror and grey 0..1, jitter 0..1 \
                 (exclusive); chances 0..1, and at most 100 for blur, 255 for noise, 99 for compression",
            ))
        }
    }

    /// Augments a frame that the protocol has scaled, and crops it to the protocol's size. Pixels from outside the protocol's
    /// crop have no depth.
    pub(super) fn apply(&self, frame: &Frame, protocol: &Protocol, rng: &mut Rng) -> Result<Frame> {
        let (left, top) = protocol.corner(frame)?;
        let size = protocol.crop.unwrap_or(Size {
            height: frame.depth.height(),
            width: frame.depth.width(),
        });
        let zoom = rng.range(self.shrink, self.zoom);
        let angle = rng.range(-self.rotation, self.rotation).to_radians();
        let mirror = if rng.chance(self.mirror) { -1.0 } else { 1.0 };
        let (sin, cos) = (angle.sin() / zoom, angle.cos() / zoom);
        let (half_width, half_height) = (size.width as f32 / 2.0, size.height as f32 / 2.0);
        let mut colours = Vec::with_capacity(3 * size.width * size.height);
        // Source position of each pixel, if it is inside the frame.
        let mut sources = Vec::with_capacity(size.width * size.height);
        for y in 0..size.height {
            let v = y as f32 + 0.5 - half_height;
            for x in 0..size.width {
                let u = (x as f32 + 0.5 - half_width) * mirror;
                let mut column = cos * u - sin * v + half_width;
                let mut row = sin * u + cos * v + half_height;
                if self.shrink < 1.0 {
                    column = reflected(column, size.width);
                    row = reflected(row, size.height);
                }
                let inside = (0.0..size.width as f32).contains(&column)
                    && (0.0..size.height as f32).contains(&row);
                let place = (top + row as usize) * frame.depth.width() + left + column as usize;
                sources.push(inside.then_some(place));
                let colour = bilinear(&frame.rgb, left as f32 + column, top as f32 + row);
                colours.extend(colour.map(|c| (c + 0.5) as u8));
            }
        }
        let mut rgb = RgbImage::from_raw(size.width as u32, size.height as u32, colours)
            .ok_or_else(|| Error::shape("augmented image has the wrong size"))?;
        self.recolour(&mut rgb, rng);
        let rgb = noisy(blurred(rgb, self.blur, rng), self.noise, rng);
        let rgb = compressed(rgb, self.compression, rng)?;
        let moved = |values: &[f32], zoom: f32| -> Vec<f32> {
            let found = sources.iter().map(|s| s.map_or(0.0, |s| values[s] / zoom));
            found.collect()
        };
        let nearer =
            |depth: &DepthMap| DepthMap::new(size.width, size.height, moved(depth.values(), zoom));
        let mut changed = Frame::new(frame.id.clone(), rgb, nearer(&frame.depth)?)?;
        if let Some(target) = &frame.target {
            changed.target = Some(Target {
                depth: nearer(&target.depth)?,
                weights: moved(&target.weights, 1.0),
            });
        }
        Ok(changed)
    }

    fn recolour(&self, rgb: &mut RgbImage, rng: &mut Rng) {
        let mut factor = || rng.range(1.0 - self.jitter, 1.0 + self.jitter);
        let (brightness, contrast, saturation) = (factor(), factor(), factor());
        if self.grey > 0.0 && rng.chance(self.grey) {
            rgb.pixels_mut()
                .for_each(|p| p.0 = [grey(*p).round() as u8; 3]);
        }
        if self.jitter == 0.0 {
            return;
        }
        let count = (rgb.width() * rgb.height()) as f32;
        let mean = rgb.pixels().copied().map(grey).sum::<f32>() / count * brightness;
        // Brightness, saturation about the grey value, contrast about the mean: combined into one linear map.
        let own = contrast * saturation * brightness;
        let greyed = contrast * (1.0 - saturation) * brightness;
        let offset = (1.0 - contrast) * mean + 0.5;
        for pixel in rgb.pixels_mut() {
            let level = greyed * grey(*pixel) + offset;
            pixel.0 = pixel.0.map(|c| (own * f32::from(c) + level) as u8);
        }
    }
}

/// Largest blur; larger ones take seconds.
const MOST_BLUR: f32 = 100.0;

/// Returns the position within 0..`length` after reflection at both ends.
fn reflected(position: f32, length: usize) -> f32 {
    let length = length as f32;
    let folded = position.rem_euclid(2.0 * length);
    let folded = if folded < length {
        folded
    } else {
        2.0 * length - folded
    };
    // Below `length` despite rounding.
    folded.min(length - 0.5 * f32::EPSILON * length)
}

/// Returns the luma of BT.601.
fn grey(pixel: Rgb<u8>) -> f32 {
    let [r, g, b] = pixel.0.map(f32::from);
    0.299 * r + 0.587 * g + 0.114 * b
}

/// Returns the colour at a position in pixels relative to the upper left corner; edges are replicated.
fn bilinear(rgb: &RgbImage, x: f32, y: f32) -> [f32; 3] {
    let (width, height) = (rgb.width() as i32, rgb.height() as i32);
    // Rounds down by a cast, at an offset that avoids negative values: `floor` is a function call on most targets.
    let split = |v: f32| {
        let v = v - 0.5 + 4096.0;
        let whole = v as i32;
        (whole - 4096, v - whole as f32)
    };
    let ((x0, u), (y0, v)) = (split(x), split(y));
    let at = |x: i32, y: i32| {
        let i = y.clamp(0, height - 1) * width + x.clamp(0, width - 1);
        let i = 3 * i as usize;
        let pixel: &[u8] = &rgb.as_raw()[i..i + 3];
        [0, 1, 2].map(|c| f32::from(pixel[c]))
    };
    let (a, b) = (at(x0, y0), at(x0 + 1, y0));
    let (c, d) = (at(x0, y0 + 1), at(x0 + 1, y0 + 1));
    std::array::from_fn(|i| {
        (a[i] * (1.0 - u) + b[i] * u) * (1.0 - v) + (c[i] * (1.0 - u) + d[i] * u) * v
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame() -> Frame {
        let rgb = RgbImage::from_fn(32, 24, |x, y| Rgb([(x * 7) as u8, (y * 9) as u8, 30]));
        let depths = (0..32 * 24).map(|i| 1.0 + (i % 32) as f32 * 0.1).collect();
        Frame::new("f".into(), rgb, DepthMap::new(32, 24, depths).unwrap()).unwrap()
    }

    #[test]
    fn nothing_changes_without_augmentation() {
        let frame = frame();
        let mut rng = Rng::stream(0, &[]);
        let same = AugmentConfig::none()
            .apply(&frame, &Protocol::default(), &mut rng)
            .unwrap();
        assert_eq!(same.rgb, frame.rgb);
        assert_eq!(same.depth, frame.depth);
    }

    #[test]
    fn smaller_images_are_continued_by_their_mirror_images() {
        let config = AugmentConfig {
            shrink: 0.1,
            ..AugmentConfig::none()
        };
        let mut rng = Rng::stream(3, &[]);
        let zoom = rng.clone().range(0.1, 1.0);
        let frame = frame();
        let found = config
            .apply(&frame, &Protocol::default(), &mut rng)
            .unwrap();
        assert_eq!(found.depth.count(), 32 * 24);
        // The left border of the image is at this distance, and depths are equal on both sides of it.
        let border = 16.0 - 16.0 * zoom;
        let whole = border.floor() as usize;
        assert!(whole > 2, "{border}");
        for step in 1..whole - 1 {
            let (here, there) = (
                found.depth.at(whole - step, 9),
                found.depth.at(whole + step, 9),
            );
            // Neighbours differ by 0.1 m.
            assert!((here - there).abs() * zoom < 0.25, "{step}: {here} {there}");
        }
        let ratio = found.depth.at(16, 12) / frame.depth.at(16, 12);
        assert!((ratio * zoom - 1.0).abs() < 0.05, "{ratio} {zoom}");
        for position in [-0.1_f32, 0.0, 31.9, 32.0, 40.0, 63.9, 64.0, 1e4] {
            assert!((0.0..32.0).contains(&reflected(position, 32)), "{position}");
        }
    }

    #[test]
    fn grey_images_have_no_colours_and_all_that_is_random_comes_from_the_stream() {
        let config = AugmentConfig {
            grey: 0.5,
            blur: Degradation {
                chance: 0.5,
                most: 1.5,
            },
            noise: Degradation {
                chance: 0.5,
                most: 8.0,
            },
            compression: Degradation {
                chance: 0.5,
                most: 70.0,
            },
            shrink: 0.5,
            ..AugmentConfig::default()
        };
        let frame = frame();
        let apply = |seed| {
            let mut rng = Rng::stream(seed, &[]);
            config
                .apply(&frame, &Protocol::default(), &mut rng)
                .unwrap()
        };
        let (a, b) = (apply(1), apply(1));
        assert_eq!((&a.rgb, &a.depth), (&b.rgb, &b.depth));
        assert_ne!(apply(2).rgb, a.rgb);
        let grey = AugmentConfig {
            grey: 1.0,
            ..AugmentConfig::none()
        };
        let found = grey
            .apply(&frame, &Protocol::default(), &mut Rng::stream(0, &[]))
            .unwrap();
        // 0.299 R + 0.587 G + 0.114 B of (70, 90, 30).
        assert_eq!(found.rgb.get_pixel(10, 10), &Rgb([77; 3]));
        assert!(
            AugmentConfig {
                shrink: 0.0,
                ..config
            }
            .check()
            .is_err()
        );
        assert!(config.check().is_ok());
    }

    #[test]
    fn zoom_divides_the_depth() {
        let config = AugmentConfig {
            zoom: 1.5,
            ..AugmentConfig::none()
        };
        let mut rng = Rng::stream(3, &[]);
        let zoom = rng.clone().range(1.0, 1.5);
        let frame = frame();
        let near = config
            .apply(&frame, &Protocol::default(), &mut rng)
            .unwrap();
        // A point at the centre stays there, and is nearer by the zoom.
        let ratio = frame.depth.at(16, 12) / near.depth.at(16, 12);
        assert!((ratio - zoom).abs() < 0.05 * zoom, "{ratio} {zoom}");
    }
}
