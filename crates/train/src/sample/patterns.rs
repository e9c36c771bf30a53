//! Patterns of the points of samples.

use lsdc_eval::sampling::{BEAMS, Pattern};
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};

/// Shares of samples whose points follow a [`Pattern`]; the points of other samples are uniform.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PatternShares {
    /// Returns of a spinning laser scanner, with a log-uniform number of 4 to 128 beams.
    pub scanner: f32,
    /// Corners of the image.
    pub corners: f32,
    /// Uniform points in one half of the image.
    pub half: f32,
    /// Uniform points in some square blocks.
    pub clusters: f32,
}

impl PatternShares {
    /// Returns whether the points of all samples are uniform.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Checks every share.
    ///
    /// # Errors
    /// A share outside 0 to 1, or a sum above 1.
    pub(super) fn check(&self) -> Result<()> {
        let Self {
            scanner,
            corners,
            half,
            clusters,
        } = *self;
        let shares = [scanner, corners, half, clusters];
        let sum: f32 = shares.iter().sum();
        // Allows for the rounding of decimal fractions.
        if shares.iter().all(|share| (0.0..=1.0).contains(share)) && sum <= 1.0 + 1e-6 {
            return Ok(());
        }
        Err(Error::config(format!(
            "`supervision.patterns`: shares of 0 to 1 that add up to at most 1, but scanner = {scanner}, \
             corners = {corners}, half = {half}, clusters = {clusters}"
        )))
    }

    /// Draws the pattern of a sample of up to `points` points; `None` for uniform points. Draws no random numbers if the points
    /// of all samples are uniform.
    pub(super) fn draw(&self, points: usize, rng: &mut Rng) -> Option<Pattern> {
        if self.is_empty() {
            return None;
        }
        let beams = log_uniform(*BEAMS.start(), *BEAMS.end(), rng);
        let patterns = [
            (self.scanner, Pattern::Scanner(beams)),
            (self.corners, Pattern::Corners(points)),
            (self.half, Pattern::Half(points)),
            (self.clusters, Pattern::Clusters(points)),
        ];
        let mut rest = rng.unit();
        let found = patterns.into_iter().find(|(share, _)| {
            rest -= share;
            rest < 0.0
        });
        found.map(|(_, pattern)| pattern)
    }
}

/// Draws a number from `fewest` to `most`, uniform in its logarithm.
pub(super) fn log_uniform(fewest: usize, most: usize, rng: &mut Rng) -> usize {
    let span = (most as f32 / fewest as f32).ln();
    (fewest as f32 * (span * rng.unit()).exp()).round() as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHARES: PatternShares = PatternShares {
        scanner: 0.2,
        corners: 0.1,
        half: 0.05,
        clusters: 0.15,
    };

    /// Returns whether a count of `draws` is within four standard deviations of a binomial.
    fn is_share(count: usize, draws: usize, share: f64) -> bool {
        let (count, draws) = (count as f64, draws as f64);
        (count - share * draws).abs() < 4.0 * (draws * share * (1.0 - share)).sqrt()
    }

    #[test]
    fn shares_are_respected_and_beams_log_uniform() {
        const DRAWS: usize = 20_000;
        let mut rng = Rng::stream(5, &["patterns"]);
        let mut counts = [0; 5];
        let mut beams = Vec::new();
        for _ in 0..DRAWS {
            let law = match SHARES.draw(700, &mut rng) {
                None => 0,
                Some(Pattern::Scanner(n)) => {
                    beams.push(n);
                    1
                }
                Some(Pattern::Corners(700)) => 2,
                Some(Pattern::Half(700)) => 3,
                Some(Pattern::Clusters(700)) => 4,
                Some(other) => panic!("{other}"),
            };
            counts[law] += 1;
        }
        for (count, share) in counts.into_iter().zip([0.5, 0.2, 0.1, 0.05, 0.15]) {
            assert!(is_share(count, DRAWS, share), "{count} {share}");
        }
        assert!(beams.iter().all(|n| (4..=128).contains(n)));
        // Numbers that round to 22 or less make up ln(22.5 / 4) / ln(32) of the logarithms.
        let few = beams.iter().filter(|n| **n <= 22).count();
        assert!(is_share(few, beams.len(), 0.498_37), "{few}");
    }

    #[test]
    fn nothing_is_read_of_the_stream_without_shares_and_wrong_shares_are_refused() {
        let mut rng = Rng::stream(1, &[]);
        let mut same = rng.clone();
        assert_eq!(PatternShares::default().draw(500, &mut rng), None);
        assert_eq!(rng.unit(), same.unit());
        assert!(PatternShares::default().check().is_ok());
        let all = PatternShares {
            scanner: 0.1,
            corners: 0.2,
            half: 0.3,
            clusters: 0.4,
        };
        assert!(all.check().is_ok());
        for scanner in [-0.1, 0.11, 1.1, f32::NAN] {
            let wrong = PatternShares { scanner, ..all };
            let error = wrong.check().unwrap_err().to_string();
            assert!(error.contains("supervision.patterns"), "{error}");
        }
    }
}
