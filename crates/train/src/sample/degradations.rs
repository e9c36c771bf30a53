//! Degradations of images by cameras and files: blur, noise, compression.

use image::codecs::jpeg::JpegEncoder;
use image::{ImageFormat, Rgb, RgbImage};
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};

/// A degradation of some images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Degradation {
    /// Probability that an image is degraded.
    pub chance: f32,
    /// Largest strength; drawn uniformly, starting at 0.
    pub most: f32,
}

impl Degradation {
    pub(super) fn is_sound(self, limit: f32) -> bool {
        (0.0..=1.0).contains(&self.chance) && (0.0..=limit).contains(&self.most)
    }

    /// Draws the strength for an image; `None` if it is not degraded. With a probability of 0, no random numbers are drawn.
    fn draw(self, rng: &mut Rng) -> Option<f32> {
        (self.chance > 0.0 && rng.chance(self.chance)).then(|| rng.range(0.0, self.most))
    }
}

/// Applies a Gaussian blur with a standard deviation in pixels.
pub(super) fn blurred(rgb: RgbImage, flaw: Degradation, rng: &mut Rng) -> RgbImage {
    /// Below this, no pixel changes by more than a level.
    const LEAST: f32 = 0.1;
    match flaw.draw(rng) {
        Some(deviation) if deviation > LEAST => image::imageops::blur(&rgb, deviation),
        _ => rgb,
    }
}

/// Adds independent normal noise, with a standard deviation in levels of 255, to each pixel and channel.
pub(super) fn noisy(mut rgb: RgbImage, flaw: Degradation, rng: &mut Rng) -> RgbImage {
    if let Some(deviation) = flaw.draw(rng) {
        for Rgb(channels) in rgb.pixels_mut() {
            *channels = channels.map(|c| (f32::from(c) + deviation * rng.normal() + 0.5) as u8);
        }
    }
    rgb
}

/// Compresses as JPEG with quality 100 minus the strength.
pub(super) fn compressed(rgb: RgbImage, flaw: Degradation, rng: &mut Rng) -> Result<RgbImage> {
    let Some(strength) = flaw.draw(rng) else {
        return Ok(rgb);
    };
    let broken = |e: image::ImageError| Error::shape("an image cannot be compressed").because(e);
    let quality = (100.0 - strength).round() as u8;
    let mut bytes = Vec::new();
    let encoder = JpegEncoder::new_with_quality(&mut bytes, quality.clamp(1, 100));
    rgb.write_with_encoder(encoder).map_err(broken)?;
    let read = image::load_from_memory_with_format(&bytes, ImageFormat::Jpeg);
    Ok(read.map_err(broken)?.into_rgb8())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rng() -> Rng {
        Rng::stream(1, &["flaws"])
    }

    fn always(most: f32) -> Degradation {
        Degradation { chance: 1.0, most }
    }

    /// Returns the strength drawn first from the stream.
    fn drawn(most: f32) -> f32 {
        always(most).draw(&mut rng()).unwrap()
    }

    fn edge() -> RgbImage {
        RgbImage::from_fn(64, 48, |x, _| Rgb([if x < 32 { 40 } else { 200 }; 3]))
    }

    /// Returns the mean squared difference.
    fn apart(a: &RgbImage, b: &RgbImage) -> f32 {
        let pairs = a.as_raw().iter().zip(b.as_raw());
        let squares = pairs.map(|(a, b)| (f32::from(*a) - f32::from(*b)).powi(2));
        squares.sum::<f32>() / a.as_raw().len() as f32
    }

    #[test]
    fn a_blurred_edge_is_the_integral_of_a_gaussian() {
        let found = blurred(edge(), always(3.0), &mut rng());
        let deviation = f64::from(drawn(3.0));
        // The normal distribution function by Simpson's rule.
        let below = |z: f64| {
            let f = |t: f64| (-0.5 * t * t).exp() / std::f64::consts::TAU.sqrt();
            let h = (z + 8.0) / 400.0;
            let terms = (0..=400).map(|i| {
                let weight = if i == 0 || i == 400 {
                    1.0
                } else {
                    2.0 + 2.0 * f64::from(i % 2)
                };
                weight * f(-8.0 + h * f64::from(i))
            });
            h / 3.0 * terms.sum::<f64>()
        };
        for x in 24..40_u32 {
            let expected = 40.0 + 160.0 * below((f64::from(x) - 31.5) / deviation);
            let value = f64::from(found.get_pixel(x, 24)[0]);
            assert!((value - expected).abs() < 4.0, "{x}: {value} {expected}");
        }
    }

    #[test]
    fn noise_has_its_standard_deviation() {
        let found = noisy(edge(), always(10.0), &mut rng());
        let expected = drawn(10.0).powi(2) + 1.0 / 12.0;
        // 9,216 draws: the standard deviation of a variance is 1.5 % of it.
        assert!((apart(&found, &edge()) / expected - 1.0).abs() < 0.06);
    }

    #[test]
    fn compression_grows_with_its_strength() {
        let mut noise = rng();
        let image = RgbImage::from_fn(64, 48, |_, _| Rgb([0; 3].map(|_| noise.below(256) as u8)));
        let loss = |most| {
            let found = compressed(image.clone(), always(most), &mut rng()).unwrap();
            assert_eq!(found.dimensions(), image.dimensions());
            apart(&found, &image)
        };
        let losses = [1.0, 30.0, 60.0, 99.0].map(loss);
        assert!(losses.is_sorted() && losses[0] < losses[3], "{losses:?}");
    }

    #[test]
    fn what_no_image_has_draws_nothing() {
        let mut used = rng();
        let same = blurred(edge(), Degradation::default(), &mut used);
        let same = noisy(same, Degradation::default(), &mut used);
        assert_eq!(
            compressed(same, Degradation::default(), &mut used).unwrap(),
            edge()
        );
        assert_eq!(used.unit(), rng().unit());
    }
}
