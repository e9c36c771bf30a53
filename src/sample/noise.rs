//! Errors put into sparse depths on purpose.

use super::protocol::per_cent;
use crate::data::{DepthMap, Point};
use crate::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// A law by which some of the points are wrong.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Noise {
    /// This share of the points has uniform [0, `most`] metres added (Fang et al., section 4.4:
    /// 300 of 1000 points, 1 m).
    Added {
        /// Share of the points.
        share: f32,
        /// The most that is added, in metres.
        most: f32,
    },
    /// This share of the points has a depth drawn uniformly between the 10th and 90th percentile
    /// of all points (OMNI-DC's `RobustDC`).
    Outliers {
        /// Share of the points.
        share: f32,
    },
}

impl Noise {
    /// Spoils the points of a frame: the same for every method.
    ///
    /// # Errors
    /// None for a map of depths.
    pub fn apply(self, sparse: &DepthMap, seed: u64, frame: &str) -> Result<DepthMap> {
        let mut rng = Rng::stream(seed, &["noise", frame]);
        let mut points: Vec<Point> = sparse.points().collect();
        let mut sorted: Vec<f32> = points.iter().map(|p| p.depth).collect();
        sorted.sort_by(f32::total_cmp);
        let percentile = |share: f32| {
            let last = sorted.len().saturating_sub(1) as f32;
            sorted
                .get((share * last).round() as usize)
                .copied()
                .unwrap_or(0.0)
        };
        let share = match self {
            Self::Added { share, .. } | Self::Outliers { share } => share,
        };
        let count = (share * points.len() as f32).round() as usize;
        rng.choose(&mut points, count);
        for point in points.iter_mut().take(count) {
            point.depth = match self {
                Self::Added { most, .. } => point.depth + rng.range(0.0, most),
                Self::Outliers { .. } => rng.range(percentile(0.1), percentile(0.9)),
            };
        }
        Ok(DepthMap::from_points(
            sparse.width(),
            sparse.height(),
            &points,
        ))
    }
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
        }
    }
}

impl FromStr for Noise {
    type Err = Error;

    /// `added:SHARE:METRES` or `outliers:SHARE`.
    fn from_str(text: &str) -> Result<Self> {
        let wrong = || {
            Error::config(format!("`{text}` is no noise"))
                .hint("added:SHARE:METRES or outliers:SHARE, as in added:0.3:1")
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
}
