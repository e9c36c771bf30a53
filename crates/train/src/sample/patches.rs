//! Which pixels of a frame take part in a training step.

use super::EncoderOutput;
use image::RgbImage;
use lsdc_eval::data::{DepthMap, Frame};
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};

/// Where the fit reads and where the loss is taken.
///
/// The network's convolutions always run on the whole image; the per-pixel MLP and the loss can be
/// limited to the sparse points and random square patches, at a fraction of the cost.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SupervisionConfig {
    /// Candidate sparse points per image.
    pub points: usize,
    /// Fewest points of a fit; the number is drawn log-uniformly from here to `points`.
    pub fewest: usize,
    /// Fits per image and step, each with its own draw of points; the network runs once.
    pub draws: usize,
    /// Number of patches; 0 takes the loss over the whole image.
    pub patches: usize,
    /// Side of a patch in pixels.
    pub patch: usize,
}

impl Default for SupervisionConfig {
    fn default() -> Self {
        Self {
            points: 1000,
            fewest: 300,
            draws: 1,
            patches: 0,
            patch: 16,
        }
    }
}

impl SupervisionConfig {
    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<()> {
        if self.fewest == 0 || self.fewest > self.points || self.draws == 0 || self.patch < 2 {
            return Err(Error::config(
                "`supervision`: 0 < fewest <= points, draws > 0 and patch > 1",
            ));
        }
        Ok(())
    }
}

/// One training example, as plain arrays.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The colour image.
    pub rgb: RgbImage,
    /// The output of a pretrained encoder, for networks trained on one.
    pub encoded: Option<EncoderOutput>,
    /// Pixels `y * width + x`: first the candidate points, then the patches row by row.
    pub pixels: Vec<u32>,
    /// The depth of each candidate point in metres; 0 = none.
    pub measured: Vec<f32>,
    /// The depth that is to be found at each pixel in metres; 0 = none.
    pub depths: Vec<f32>,
    /// The same of the whole image, row by row.
    pub map: Vec<f32>,
    /// How much an error at each pixel of the whole image counts; the same everywhere if there is nothing.
    pub weights: Option<Vec<f32>>,
    /// For each draw, 1 for every candidate point that the fit may read, else 0.
    pub draws: Vec<Vec<f32>>,
    /// Rows and columns of every patch.
    pub patch: (usize, usize),
}

impl Sample {
    /// Draws points and patches of a frame.
    pub(super) fn draw(frame: &Frame, config: &SupervisionConfig, rng: &mut Rng) -> Self {
        let depth = &frame.depth;
        let (width, height) = (depth.width(), depth.height());
        let mut valid: Vec<u32> = (0..(width * height) as u32)
            .filter(|&i| depth.values()[i as usize] > 0.0)
            .collect();
        rng.choose(&mut valid, config.points);
        valid.truncate(config.points);
        let found = valid.len();
        let draws = (0..config.draws)
            .map(|_| draw(config, found, rng))
            .collect();
        let mut pixels = valid;
        pixels.resize(config.points, 0);
        let patch = if config.patches == 0 {
            pixels.extend(0..(width * height) as u32);
            (height, width)
        } else {
            let side = config.patch.min(width).min(height);
            for _ in 0..config.patches {
                let left = rng.below((width - side + 1) as u32);
                let top = rng.below((height - side + 1) as u32);
                let rows = top..top + side as u32;
                pixels.extend(rows.flat_map(|y| {
                    let start = y * width as u32 + left;
                    start..start + side as u32
                }));
            }
            (side, side)
        };
        let target = frame.target.as_ref();
        let map = target.map_or(depth, |target| &target.depth);
        let [mut measured, mut depths] = [
            values(depth, &pixels[..config.points]),
            values(map, &pixels),
        ];
        measured[found..].fill(0.0);
        depths[found..config.points].fill(0.0);
        Self {
            rgb: frame.rgb.clone(),
            encoded: None,
            map: map.values().to_vec(),
            weights: target.map(|target| target.weights.clone()),
            pixels,
            measured,
            depths,
            draws,
            patch,
        }
    }
}

/// A random subset of the `found` candidates, as a mask over all of them.
fn draw(config: &SupervisionConfig, found: usize, rng: &mut Rng) -> Vec<f32> {
    let span = (config.points as f32 / config.fewest as f32).ln();
    let count = (config.fewest as f32 * (span * rng.unit()).exp()).round() as usize;
    let mut order: Vec<usize> = (0..found).collect();
    rng.choose(&mut order, count);
    let mut mask = vec![0.0; config.points];
    for &i in order.iter().take(count) {
        mask[i] = 1.0;
    }
    mask
}

fn values(depth: &DepthMap, pixels: &[u32]) -> Vec<f32> {
    pixels.iter().map(|&i| depth.values()[i as usize]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_read_only_valid_points() {
        let depths = (0..40 * 30).map(|i| if i % 5 == 0 { 0.0 } else { 2.0 });
        let depth = DepthMap::new(40, 30, depths.collect()).unwrap();
        let frame = Frame::new("f".into(), RgbImage::new(40, 30), depth).unwrap();
        let config = SupervisionConfig {
            points: 1100,
            fewest: 100,
            draws: 3,
            patches: 2,
            patch: 8,
        };
        let sample = Sample::draw(&frame, &config, &mut Rng::stream(0, &[]));
        assert_eq!(sample.pixels.len(), 1100 + 2 * 64);
        assert_eq!(sample.depths[960..1100], [0.0; 140]);
        for mask in &sample.draws {
            let read = mask.iter().sum::<f32>();
            assert!((100.0..=960.0).contains(&read), "{read}");
            let bad = mask
                .iter()
                .zip(&sample.depths)
                .any(|(m, d)| *m > 0.0 && *d == 0.0);
            assert!(!bad);
        }
        assert_ne!(sample.draws[0], sample.draws[1]);
    }
}
