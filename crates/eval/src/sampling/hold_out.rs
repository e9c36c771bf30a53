//! Held-out pixels of a frame: scored and never given.

use crate::data::{DepthMap, Frame};
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// A rule for holding out pixels of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum HoldOut {
    /// All rings of a laser scanner whose numbers are not multiples of this, to imitate a scanner with fewer rings.
    Rings(i32),
    /// This many square blocks around measured pixels, each an eighth of the shorter side of the image wide.
    Clusters(usize),
    /// A rectangle of half the width and half the height of the image.
    Region,
}

impl HoldOut {
    /// Returns whether each pixel of `frame` is held out under `seed`, row by row; the same on every machine and for every
    /// method.
    ///
    /// # Errors
    /// A frame without rings, or a frame of which no measurement or every measurement would be held out.
    pub fn mask(self, frame: &Frame, seed: u64) -> Result<Vec<bool>> {
        let mut rng = Rng::stream(seed, &["hold-out", &frame.id]);
        let mask = match self {
            Self::Rings(step) => Self::rings(frame, step)?,
            Self::Clusters(count) => Self::clusters(frame, count, &mut rng),
            Self::Region => Self::region(frame, &mut rng),
        };
        let returns = frame.sparse.as_ref().filter(|_| frame.rings.is_some());
        let count = |map: &DepthMap, value: bool| {
            let pixels = map.values().iter().zip(&mask);
            pixels
                .filter(|(depth, held_out)| **depth > 0.0 && **held_out == value)
                .count()
        };
        let given = count(returns.unwrap_or(&frame.depth), false);
        let scored = count(&frame.depth, true);
        if given > 0 && scored > 0 {
            return Ok(mask);
        }
        let what = if scored == 0 { "none" } else { "all" };
        Err(Error::config(format!(
            "frame `{}`: `{}` holds out {what} of its true depths",
            frame.id,
            String::from(self)
        ))
        .hint("choose another --hold-out or --seed"))
    }

    fn rings(frame: &Frame, step: i32) -> Result<Vec<bool>> {
        let known = |rings: &&Vec<i32>| rings.iter().any(|ring| *ring >= 0);
        let Some(rings) = frame.rings.as_ref().filter(known) else {
            return Err(
                Error::config(format!("frame `{}` has no rings to hold out", frame.id)).hint(
                    "scans have them in the array `ring`; give --hold-out clusters:N or region",
                ),
            );
        };
        // A return with an unknown ring may belong to any ring, so it is held out.
        let is_given = |ring: &i32| *ring >= 0 && ring % step == 0;
        Ok(rings.iter().map(|ring| !is_given(ring)).collect())
    }

    /// Returns the pixels of square blocks around this many measured pixels.
    pub(super) fn clusters(frame: &Frame, count: usize, rng: &mut Rng) -> Vec<bool> {
        let (width, height) = (frame.depth.width(), frame.depth.height());
        let side = (width.min(height) / 8).max(1);
        let mut centres: Vec<_> = frame.depth.points().collect();
        rng.choose(&mut centres, count);
        let mut mask = vec![false; width * height];
        for centre in centres.iter().take(count) {
            let span = |at: usize, length: usize| {
                let from = at.saturating_sub(side / 2);
                from..(at + side - side / 2).min(length)
            };
            for y in span(centre.y, height) {
                for x in span(centre.x, width) {
                    mask[y * width + x] = true;
                }
            }
        }
        mask
    }

    /// Returns a random region. A scanner covers little of the upper half of an image, so the first of several random regions
    /// that contains at least a tenth of the measurements is used.
    fn region(frame: &Frame, rng: &mut Rng) -> Vec<bool> {
        const TRIES: usize = 100;
        let depth = &frame.depth;
        let (width, height) = (depth.width(), depth.height());
        let mut span = |length: usize| {
            let part = length.div_ceil(2);
            let from = rng.below((length - part + 1) as u32) as usize;
            from..from + part
        };
        let mut mask = Vec::new();
        for _ in 0..TRIES {
            let (columns, rows) = (span(width), span(height));
            let pixels = (0..width * height).map(|i| (i % width, i / width));
            mask = pixels
                .map(|(x, y)| columns.contains(&x) && rows.contains(&y))
                .collect();
            let inside = depth.points().filter(|p| mask[p.y * width + p.x]).count();
            if inside < depth.count() && 10 * inside >= depth.count() {
                break;
            }
        }
        mask
    }
}

impl Display for HoldOut {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Rings(step) => write!(f, "all rings but every {}", ordinal(*step)),
            Self::Clusters(count) => write!(
                f,
                "{count} blocks of an eighth of the shorter side, around measured pixels"
            ),
            Self::Region => write!(f, "a rectangle of half the width and half the height"),
        }
    }
}

fn ordinal(number: i32) -> String {
    let ending = match (number % 10, number % 100) {
        (_, 11..=13) => "th",
        (1, _) => "st",
        (2, _) => "nd",
        (3, _) => "rd",
        _ => "th",
    };
    format!("{number}{ending}")
}

impl FromStr for HoldOut {
    type Err = Error;

    /// Parses `ring:K`, `clusters:N` or `region`.
    fn from_str(text: &str) -> Result<Self> {
        let wrong = || {
            Error::config(format!("`{text}` does not say what to hold out"))
                .hint("ring:K with K above 1, clusters:N, region")
        };
        let (law, number) = text.split_once(':').unwrap_or((text, ""));
        match law {
            "ring" => number.parse().ok().filter(|k| *k > 1).map(Self::Rings),
            "clusters" => number.parse().ok().filter(|n| *n > 0).map(Self::Clusters),
            "region" if text == law => Some(Self::Region),
            _ => None,
        }
        .ok_or_else(wrong)
    }
}

impl From<HoldOut> for String {
    fn from(law: HoldOut) -> Self {
        match law {
            HoldOut::Rings(step) => format!("ring:{step}"),
            HoldOut::Clusters(count) => format!("clusters:{count}"),
            HoldOut::Region => "region".into(),
        }
    }
}

impl TryFrom<String> for HoldOut {
    type Error = Error;

    fn try_from(text: String) -> Result<Self> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;

    fn plain(width: usize, height: usize, values: Vec<f32>) -> Frame {
        let depth = DepthMap::new(width, height, values).unwrap();
        let rgb = RgbImage::new(width as u32, height as u32);
        Frame::new("set/a".into(), rgb, depth).unwrap()
    }

    fn scan(rings: &[i32]) -> Frame {
        let values = rings.iter().map(|_| 5.0).collect();
        let frame = plain(rings.len(), 1, values);
        let sparse = frame.depth.clone();
        let frame = frame.with_sparse(sparse).unwrap();
        frame.with_rings(rings.to_vec()).unwrap()
    }

    fn mask(law: &str, frame: &Frame, seed: u64) -> Result<Vec<bool>> {
        law.parse::<HoldOut>().unwrap().mask(frame, seed)
    }

    #[test]
    fn every_kth_ring_is_given() {
        let frame = scan(&[0, 1, 2, 3, 4, 7, 8, -1, 12]);
        let given = |law: &str| -> Vec<usize> {
            let mask = mask(law, &frame, 0).unwrap();
            (0..9).filter(|i| !mask[*i]).collect()
        };
        assert_eq!(given("ring:4"), [0, 4, 6, 8]);
        assert_eq!(given("ring:2"), [0, 2, 4, 6, 8]);
    }

    #[test]
    fn frames_without_rings_and_laws_that_leave_nothing_are_errors() {
        let message = |frame: &Frame| mask("ring:2", frame, 0).unwrap_err().to_string();
        assert!(message(&plain(4, 1, vec![1.0; 4])).contains("no rings"));
        assert!(message(&scan(&[-1, -1])).contains("no rings"));
        assert!(message(&scan(&[1, 3])).contains("all of its true depths"));
        assert!(message(&scan(&[2, 4])).contains("none of its true depths"));
    }

    #[test]
    fn blocks_lie_around_measured_pixels() {
        let mut values = vec![0.0; 80 * 64];
        (values[32 * 80 + 40], values[2 * 80 + 78], values[0]) = (3.0, 4.0, 5.0);
        let frame = plain(80, 64, values);
        let mut found = std::collections::BTreeSet::new();
        for seed in 0..30 {
            let mask = mask("clusters:1", &frame, seed).unwrap();
            let pixels: Vec<usize> = (0..mask.len()).filter(|i| mask[*i]).collect();
            let (first, last) = (pixels[0], pixels[pixels.len() - 1]);
            found.insert((first % 80, first / 80, last % 80, last / 80, pixels.len()));
        }
        // Sides of 64 / 8 pixels, cut off at the border of the image.
        let blocks = [(0, 0, 3, 3, 16), (36, 28, 43, 35, 64), (74, 0, 79, 5, 36)];
        assert_eq!(found.into_iter().collect::<Vec<_>>(), blocks);
        assert_eq!(
            mask("clusters:2", &frame, 3).unwrap(),
            mask("clusters:2", &frame, 3).unwrap()
        );
    }

    #[test]
    fn a_region_is_a_quarter_of_the_image_where_there_are_measurements() {
        // Only the lowest eighth is measured.
        let values = (0..40 * 32).map(|i| if i >= 28 * 40 { 2.0 } else { 0.0 });
        let frame = plain(40, 32, values.collect());
        for seed in 0..20 {
            let mask = mask("region", &frame, seed).unwrap();
            assert_eq!(mask.iter().filter(|held_out| **held_out).count(), 20 * 16);
            let scored = frame.depth.points().filter(|p| mask[p.y * 40 + p.x]);
            assert!((16..160).contains(&scored.count()));
        }
    }

    #[test]
    fn laws_are_written_as_they_are_read() {
        for text in ["ring:4", "clusters:12", "region"] {
            let law: HoldOut = text.parse().unwrap();
            assert_eq!(String::from(law), text);
            let json = serde_json::to_string(&law).unwrap();
            assert_eq!(serde_json::from_str::<HoldOut>(&json).unwrap(), law);
        }
        for wrong in ["ring:1", "ring:-2", "ring", "clusters:0", "region:", "half"] {
            assert!(wrong.parse::<HoldOut>().is_err(), "{wrong}");
        }
        let text_of = |text: &str| text.parse::<HoldOut>().unwrap().to_string();
        assert_eq!(text_of("ring:2"), "all rings but every 2nd");
        assert_eq!(text_of("ring:12"), "all rings but every 12th");
    }
}
