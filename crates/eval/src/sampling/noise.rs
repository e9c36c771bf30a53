//! Simulated errors of sparse depths.

use super::protocol::per_cent;
use crate::data::{DepthMap, Point};
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};
use std::f32::consts::TAU;
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// A model of errors of the points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Noise {
    /// Adds uniform [0, `most`] metres to this share of the points (Fang et al., section 4.4: 300 of 1000 points, 1 m).
    Added {
        /// Share of the points.
        share: f32,
        /// Largest addition, in metres.
        most: f32,
    },
    /// Replaces this share of the points by depths drawn uniformly between the 10th and 90th percentile of all points
    /// (OMNI-DC's `RobustDC`).
    Outliers {
        /// Share of the points.
        share: f32,
    },
    /// Moves each point by `least` to `most` pixels in a random direction, like a calibration error: near edges, depths bleed
    /// across.
    Moved {
        /// Shortest displacement, in pixels.
        least: f32,
        /// Longest displacement, in pixels.
        most: f32,
    },
    /// Adds the same distance to the points in a rectangle that covers this share of the image.
    Region {
        /// Share of the image.
        share: f32,
        /// Distance added, in metres.
        metres: f32,
    },
    /// Adds normal noise with a standard deviation of `factor` x depth x depth to each point, like the noise of stereo cameras.
    Stereo {
        /// Standard deviation at a depth of 1 m, in metres.
        factor: f32,
    },
}

impl Noise {
    /// Applies the noise to the points of a frame; the same for every method.
    ///
    /// # Errors
    /// None for a valid depth map.
    pub fn apply(self, sparse: &DepthMap, seed: u64, frame: &str) -> Result<DepthMap> {
        let mut rng = Rng::stream(seed, &["noise", frame]);
        let mut points: Vec<Point> = sparse.points().collect();
        let (width, height) = (sparse.width(), sparse.height());
        match self {
            Self::Added { share, most } => {
                for point in random_share(&mut points, share, &mut rng) {
                    point.depth += rng.range(0.0, most);
                }
            }
            Self::Outliers { share } => {
                let mut sorted: Vec<f32> = points.iter().map(|p| p.depth).collect();
                sorted.sort_by(f32::total_cmp);
                let percentile = |share: f32| {
                    let last = sorted.len().saturating_sub(1) as f32;
                    let at = (share * last).round() as usize;
                    sorted.get(at).copied().unwrap_or(0.0)
                };
                let (low, high) = (percentile(0.1), percentile(0.9));
                for point in random_share(&mut points, share, &mut rng) {
                    point.depth = rng.range(low, high);
                }
            }
            Self::Moved { least, most } => {
                for point in &mut points {
                    let (distance, turn) = (rng.range(least, most), rng.range(0.0, TAU));
                    let place = |at: usize, change: f32, length: usize| {
                        let moved = (at as f32 + change).round();
                        (moved.max(0.0) as usize).min(length - 1)
                    };
                    point.x = place(point.x, distance * turn.cos(), width);
                    point.y = place(point.y, distance * turn.sin(), height);
                }
            }
            Self::Region { share, metres } => {
                let mut span = |length: usize| {
                    let side = length as f32 * share.sqrt();
                    let start = rng.range(0.0, length as f32 - side);
                    start..start + side
                };
                let (columns, rows) = (span(width), span(height));
                for point in &mut points {
                    if columns.contains(&(point.x as f32)) && rows.contains(&(point.y as f32)) {
                        point.depth += metres;
                    }
                }
            }
            Self::Stereo { factor } => {
                /// Smallest ratio of noisy and original depth.
                const MIN_RATIO: f32 = 0.05;
                for point in &mut points {
                    let change = factor * point.depth * point.depth * rng.normal();
                    point.depth = (point.depth + change).max(MIN_RATIO * point.depth);
                }
            }
        }
        Ok(DepthMap::from_points(width, height, &points))
    }
}

/// Returns this share of the points, drawn at random.
fn random_share<'a>(points: &'a mut [Point], share: f32, rng: &mut Rng) -> &'a mut [Point] {
    let count = (share * points.len() as f32).round() as usize;
    rng.choose(points, count);
    &mut points[..count]
}

impl Display for Noise {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Added { share, most } => {
                write!(
                    f,
                    "{} % of them with uniform 0 to {most} m added",
                    per_cent(*share)
                )
            }
            Self::Outliers { share } => write!(
                f,
                "{} % of them replaced by uniform depths between their 10th and 90th percentile",
                per_cent(*share)
            ),
            Self::Moved { least, most } => {
                write!(f, "each of them moved by {least} to {most} pixels")
            }
            Self::Region { share, metres } => write!(
                f,
                "those in {} % of the image {metres} m off",
                per_cent(*share)
            ),
            Self::Stereo { factor } => {
                write!(f, "with normal noise of {factor} x depth x depth")
            }
        }
    }
}

impl FromStr for Noise {
    type Err = Error;

    /// Parses `added:SHARE:METRES`, `outliers:SHARE`, `moved:PIXELS:PIXELS`, `region:SHARE:METRES` or `stereo:METRES`.
    fn from_str(text: &str) -> Result<Self> {
        let wrong = || {
            Error::config(format!("`{text}` is no noise")).hint(
                "added:0.3:1, outliers:0.1, moved:2:4, region:0.1:0.5 or stereo:0.01, for example",
            )
        };
        let number = |t: &str, most: f32| {
            t.parse()
                .ok()
                .filter(|n| (0.0..=most).contains(n))
                .ok_or_else(wrong)
        };
        match text.split(':').collect::<Vec<_>>()[..] {
            ["added", share, most] => Ok(Self::Added {
                share: number(share, 1.0)?,
                most: number(most, 1e6)?,
            }),
            ["outliers", share] => Ok(Self::Outliers {
                share: number(share, 1.0)?,
            }),
            ["moved", least, most] => {
                let (least, most) = (number(least, 1e4)?, number(most, 1e4)?);
                if least > most {
                    return Err(wrong());
                }
                Ok(Self::Moved { least, most })
            }
            ["region", share, metres] => Ok(Self::Region {
                share: number(share, 1.0)?,
                metres: number(metres, 1e6)?,
            }),
            ["stereo", factor] => Ok(Self::Stereo {
                factor: number(factor, 1e6)?,
            }),
            _ => Err(wrong()),
        }
    }
}

impl TryFrom<String> for Noise {
    type Error = Error;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

impl From<Noise> for String {
    fn from(noise: Noise) -> Self {
        match noise {
            Noise::Added { share, most } => format!("added:{share}:{most}"),
            Noise::Outliers { share } => format!("outliers:{share}"),
            Noise::Moved { least, most } => format!("moved:{least}:{most}"),
            Noise::Region { share, metres } => format!("region:{share}:{metres}"),
            Noise::Stereo { factor } => format!("stereo:{factor}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_asked_share_is_spoiled() {
        let values = (0..400).map(|i| 1.0 + i as f32 / 100.0).collect();
        let sparse = DepthMap::new(20, 20, values).unwrap();
        let changed = |noise: &str| {
            let noise: Noise = noise.parse().unwrap();
            let spoiled = noise.apply(&sparse, 0, "a").unwrap();
            let pairs = spoiled.values().iter().zip(sparse.values());
            pairs
                .map(|(a, b)| a - b)
                .filter(|d| *d != 0.0)
                .collect::<Vec<f32>>()
        };
        let added = changed("added:0.3:1");
        assert_eq!(added.len(), 120);
        assert!(added.iter().all(|d| (0.0..1.0).contains(d)));
        let mean = added.iter().sum::<f32>() / 120.0;
        assert!((mean - 0.5).abs() < 0.1, "{mean}");
        assert_eq!(changed("outliers:0.1").len(), 40);
        assert!("added:2:1".parse::<Noise>().is_err());
    }

    #[test]
    fn a_region_is_off_as_a_whole_and_noise_grows_with_depth() {
        let sparse = DepthMap::new(200, 100, vec![4.0; 20_000]).unwrap();
        let spoiled = |noise: &str| {
            let noise: Noise = noise.parse().unwrap();
            let again: Noise = String::from(noise).parse().unwrap();
            assert_eq!(noise, again);
            noise.apply(&sparse, 3, "a").unwrap()
        };
        let region = spoiled("region:0.25:0.5");
        let changed: Vec<usize> = (0..20_000).filter(|&i| region.values()[i] != 4.0).collect();
        // Half of the width and of the height.
        assert!((4900..5100).contains(&changed.len()), "{}", changed.len());
        assert!(changed.iter().all(|&i| region.values()[i] == 4.5));
        let columns = changed.iter().map(|i| i % 200);
        assert!(columns.clone().max().unwrap() - columns.min().unwrap() <= 100);
        let stereo = spoiled("stereo:0.01");
        let squares: f32 = stereo.values().iter().map(|v| (v - 4.0).powi(2)).sum();
        let deviation = (squares / 20_000.0).sqrt();
        assert!((deviation - 0.16).abs() < 0.004, "{deviation}");
    }

    #[test]
    fn moved_points_are_as_far_away_as_asked() {
        let mut values = vec![0.0; 10_000];
        values[50 * 100 + 50] = 2.0;
        let sparse = DepthMap::new(100, 100, values).unwrap();
        let noise: Noise = "moved:3:4".parse().unwrap();
        let mut directions = std::collections::BTreeSet::new();
        for seed in 0..20 {
            let moved = noise.apply(&sparse, seed, "a").unwrap();
            let points: Vec<Point> = moved.points().collect();
            assert_eq!((points.len(), points[0].depth), (1, 2.0));
            let [x, y] = [points[0].x, points[0].y].map(|v| v as f32 - 50.0);
            // Rounded to whole pixels.
            assert!((2.2..4.8).contains(&x.hypot(y)), "{x} {y}");
            directions.insert((x > 0.0, y > 0.0));
        }
        assert_eq!(directions.len(), 4);
        assert!("moved:4:2".parse::<Noise>().is_err());
    }
}
