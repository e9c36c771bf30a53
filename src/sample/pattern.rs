//! Where sparse depths come from: sampling patterns over the valid pixels of a frame.

use crate::data::{DepthMap, Point};
use crate::rng::Rng;
use serde::{Deserialize, Serialize};

/// A law that picks sparse points from a dense depth map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pattern {
    /// Exactly this many pixels, uniform without replacement among the valid ones (NLSPN's law);
    /// all of them if there are fewer.
    Exactly(usize),
}

impl Pattern {
    /// Draws the points of `frame` under `seed`: the same on every machine, for every method.
    pub fn draw(self, depth: &DepthMap, seed: u64, frame: &str) -> DepthMap {
        let mut points: Vec<Point> = depth.points().collect();
        let Self::Exactly(count) = self;
        Rng::stream(seed, &["pattern", frame]).choose(&mut points, count);
        points.truncate(count);
        DepthMap::from_points(depth.width(), depth.height(), &points)
    }
}

impl std::fmt::Display for Pattern {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self::Exactly(count) = self;
        write!(f, "exactly {count} uniform valid pixels")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> DepthMap {
        let values = (0..1200).map(|i| if i % 3 == 0 { 0.0 } else { i as f32 });
        DepthMap::new(40, 30, values.collect()).unwrap()
    }

    #[test]
    fn points_are_a_subset_of_the_right_size() {
        let depth = ramp();
        let sparse = Pattern::Exactly(500).draw(&depth, 0, "a");
        assert_eq!(sparse.count(), 500);
        assert!(sparse.points().all(|p| p.depth == depth.at(p.x, p.y)));
        assert_eq!(Pattern::Exactly(5000).draw(&depth, 0, "a"), depth);
    }

    #[test]
    fn masks_depend_on_seed_and_frame_alone() {
        let depth = ramp();
        let draw = |seed, frame| Pattern::Exactly(50).draw(&depth, seed, frame);
        assert_eq!(draw(0, "a"), draw(0, "a"));
        assert_ne!(draw(0, "a"), draw(1, "a"));
        assert_ne!(draw(0, "a"), draw(0, "b"));
    }
}
