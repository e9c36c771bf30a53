//! The pixels of a frame used in a training step.

use super::PatternShares;
use super::patterns::log_uniform;
use image::RgbImage;
use lsdc_core::network::FeatureMap;
use lsdc_eval::data::{DepthMap, Frame};
use lsdc_eval::sampling::Pattern;
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};

/// Settings of the points of fits and the pixels of losses.
///
/// The network's convolutions always run on the whole image. The per-pixel MLP and the loss can be limited to the sparse points
/// and random square patches, at a fraction of the cost.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SupervisionConfig {
    /// Number of candidate sparse points per image.
    pub points: usize,
    /// Smallest number of points of a fit; the number is drawn log-uniformly up to `points`.
    pub fewest: usize,
    /// Number of fits per image and step, each with its own draw of points; the network runs once.
    pub draws: usize,
    /// Number of patches; if 0, the loss covers the whole image.
    pub patches: usize,
    /// Side length of a patch in pixels.
    pub patch: usize,
    /// Patterns of candidates; if a pattern finds fewer than `fewest` points, they are uniform. The first fit to scanner
    /// returns reads all candidates, at most `points` random returns. The truth is the whole depth of the frame for every
    /// pattern.
    #[serde(skip_serializing_if = "PatternShares::is_empty")]
    pub patterns: PatternShares,
}

impl Default for SupervisionConfig {
    fn default() -> Self {
        Self {
            points: 1000,
            fewest: 300,
            draws: 1,
            patches: 0,
            patch: 16,
            patterns: PatternShares::default(),
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
        self.patterns.check()
    }
}

/// A training example, as plain arrays.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The colour image.
    pub rgb: RgbImage,
    /// The output of a pretrained encoder, for networks trained on one.
    pub encoded: Option<FeatureMap>,
    /// Pixels `y * width + x`: first the candidate points, then the patches row by row.
    pub pixels: Vec<u32>,
    /// Depth of each candidate point in metres; 0 = none.
    pub measured: Vec<f32>,
    /// Target depth at each pixel in metres; 0 = none.
    pub depths: Vec<f32>,
    /// Target depth of the whole image, row by row.
    pub map: Vec<f32>,
    /// Weight of the error at each pixel of the whole image; `None` if they are equal.
    pub weights: Option<Vec<f32>>,
    /// Mask of each draw: 1 for every candidate point that the fit reads, otherwise 0.
    pub draws: Vec<Vec<f32>>,
    /// Rows and columns of each patch.
    pub patch: (usize, usize),
}

impl Sample {
    /// Draws points and patches of a frame.
    ///
    /// # Errors
    /// The errors of [`Pattern::draw`].
    pub(super) fn draw(frame: &Frame, config: &SupervisionConfig, rng: &mut Rng) -> Result<Self> {
        let depth = &frame.depth;
        let (width, height) = (depth.width(), depth.height());
        let pattern = config.patterns.draw(config.points, rng);
        let drawn = match &pattern {
            Some(pattern) => Some(pattern.draw(frame, u64::from(rng.below(u32::MAX)))?),
            None => None,
        };
        let drawn = drawn.filter(|drawn| drawn.count() >= config.fewest);
        let is_scan = drawn.is_some() && matches!(pattern, Some(Pattern::Scanner(_)));
        let given = drawn.as_ref().unwrap_or(depth);
        let mut valid: Vec<u32> = (0..(width * height) as u32)
            .filter(|&i| given.values()[i as usize] > 0.0)
            .collect();
        rng.choose(&mut valid, config.points);
        valid.truncate(config.points);
        let found = valid.len();
        let draws = (0..config.draws)
            .map(|fit| match fit {
                0 if is_scan => mask(config, 0..found),
                _ => draw(config, found, rng),
            })
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
            values(given, &pixels[..config.points]),
            values(map, &pixels),
        ];
        measured[found..].fill(0.0);
        depths[found..config.points].fill(0.0);
        Ok(Self {
            rgb: frame.rgb.clone(),
            encoded: None,
            map: map.values().to_vec(),
            weights: target.map(|target| target.weights.clone()),
            pixels,
            measured,
            depths,
            draws,
            patch,
        })
    }
}

/// Draws a random subset of the `found` candidates, as a mask over all of them.
fn draw(config: &SupervisionConfig, found: usize, rng: &mut Rng) -> Vec<f32> {
    let count = log_uniform(config.fewest, config.points, rng);
    let mut order: Vec<usize> = (0..found).collect();
    rng.choose(&mut order, count);
    mask(config, order.into_iter().take(count))
}

fn mask(config: &SupervisionConfig, read: impl Iterator<Item = usize>) -> Vec<f32> {
    let mut mask = vec![0.0; config.points];
    for i in read {
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
    use lsdc_eval::data::{Dataset as _, Rooms, RoomsConfig, Split};

    fn room() -> Frame {
        let config = RoomsConfig {
            width: 96,
            height: 72,
            ..RoomsConfig::default()
        };
        let rooms = Rooms::new(Split::Train, &config).unwrap();
        rooms.load(0).unwrap()
    }

    fn sample(frame: &Frame, config: &SupervisionConfig, seed: u64) -> Sample {
        Sample::draw(frame, config, &mut Rng::stream(seed, &[])).unwrap()
    }

    /// Returns the pixels of the candidates, and their depths.
    fn candidates(sample: &Sample) -> (Vec<u32>, Vec<f32>) {
        let pairs = sample.pixels.iter().zip(&sample.measured);
        pairs.filter(|(_, depth)| **depth > 0.0).unzip()
    }

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
            ..SupervisionConfig::default()
        };
        let sample = sample(&frame, &config, 0);
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

    #[test]
    fn without_patterns_the_stream_gives_candidates_then_fits_then_patches() {
        let frame = room();
        let config = SupervisionConfig {
            points: 400,
            fewest: 20,
            draws: 2,
            patches: 1,
            patch: 8,
            ..SupervisionConfig::default()
        };
        let found = sample(&frame, &config, 9);
        let mut rng = Rng::stream(9, &[]);
        let mut valid: Vec<u32> = (0..96 * 72).collect();
        valid.retain(|&i| frame.depth.values()[i as usize] > 0.0);
        rng.choose(&mut valid, 400);
        assert_eq!(found.pixels[..400], valid[..400]);
        for mask in &found.draws {
            let count = (20.0 * (20.0_f32.ln() * rng.unit()).exp()).round() as usize;
            let mut order: Vec<usize> = (0..400).collect();
            rng.choose(&mut order, count);
            let read: Vec<usize> = (0..400).filter(|i| mask[*i] > 0.0).collect();
            order.truncate(count);
            order.sort_unstable();
            assert_eq!(read, order);
        }
        let (left, top) = (rng.below(96 - 7), rng.below(72 - 7));
        assert_eq!(found.pixels[400], top * 96 + left);
    }

    #[test]
    fn patterns_choose_the_candidates_and_the_truth_stays_dense() {
        let frame = room();
        let of = |patterns| SupervisionConfig {
            points: 600,
            fewest: 10,
            draws: 2,
            patterns,
            ..SupervisionConfig::default()
        };
        let none = PatternShares::default();
        let scanner = of(PatternShares {
            scanner: 1.0,
            ..none
        });
        let half = of(PatternShares { half: 1.0, ..none });
        let clusters = of(PatternShares {
            clusters: 1.0,
            ..none
        });
        for config in [scanner, half, clusters] {
            for seed in 0..10 {
                let found = sample(&frame, &config, seed);
                let again = sample(&frame, &config, seed);
                assert_eq!(found.pixels, again.pixels);
                assert_eq!(found.measured, again.measured);
                assert_eq!(found.draws, again.draws);
                assert_eq!(found.depths[600..], *frame.depth.values());
                let (pixels, measured) = candidates(&found);
                assert!((10..=600).contains(&pixels.len()), "{}", pixels.len());
                let distinct: std::collections::BTreeSet<_> = pixels.iter().collect();
                assert_eq!(distinct.len(), pixels.len());
                let exact = pixels.iter().zip(&measured);
                let exact = exact.filter(|(p, d)| frame.depth.values()[**p as usize] == **d);
                let exact = exact.count();
                let read = found.draws[0].iter().sum::<f32>() as usize;
                if config == scanner {
                    // Ranges have noise, and the first fit reads all returns.
                    assert!(10 * exact < pixels.len(), "{exact}");
                    assert_eq!(read, pixels.len());
                } else {
                    assert_eq!(exact, pixels.len());
                }
                if config == half {
                    let all = |inside: fn(u32, u32) -> bool| {
                        pixels.iter().all(|p| inside(p % 96, p / 96))
                    };
                    let halves: [fn(u32, u32) -> bool; 4] =
                        [|x, _| x < 48, |x, _| x >= 48, |_, y| y < 36, |_, y| y >= 36];
                    assert!(halves.into_iter().any(all));
                }
            }
        }
    }

    #[test]
    fn a_pattern_that_finds_too_few_points_is_replaced_by_uniform_ones() {
        // An image without corners.
        let depth = DepthMap::new(40, 30, vec![2.0; 1200]).unwrap();
        let frame = Frame::new("f".into(), RgbImage::new(40, 30), depth).unwrap();
        let config = SupervisionConfig {
            points: 50,
            fewest: 10,
            patterns: PatternShares {
                corners: 1.0,
                ..PatternShares::default()
            },
            ..SupervisionConfig::default()
        };
        assert_eq!(candidates(&sample(&frame, &config, 0)).0.len(), 50);
    }
}
