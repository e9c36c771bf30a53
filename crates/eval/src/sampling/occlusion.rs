//! Removal of laser returns behind a nearer surface: the scanner is mounted above or beside the camera, so it sees background
//! that is hidden from the camera.

use crate::data::DepthMap;
use crate::window;
use lsdc_files::error::Result;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};

/// A filter that removes returns farther than `ratio` x the nearest depth + `metres`, within a window around it. The window is
/// measured in pixels of the stored image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Occlusion {
    /// Factor on the nearest depth.
    pub ratio: f32,
    /// Offset added to the product, in metres.
    pub metres: f32,
    /// Width of the window; odd.
    pub width: usize,
    /// Height of the window; odd. Larger than the width, because the rings of a scanner are farther apart than the returns on a
    /// ring.
    pub height: usize,
    /// Whether given points are filtered as well as the truth.
    pub given: bool,
}

impl Default for Occlusion {
    fn default() -> Self {
        Self {
            ratio: 1.1,
            metres: 0.3,
            width: 7,
            height: 11,
            given: false,
        }
    }
}

impl Occlusion {
    /// Returns the map without occluded returns.
    ///
    /// # Errors
    /// None for a valid depth map.
    pub fn without(&self, returns: &DepthMap) -> Result<DepthMap> {
        let (width, height) = (returns.width(), returns.height());
        let mut values = returns.values().to_vec();
        for point in returns.points() {
            let rows = window(point.y, self.height / 2, height);
            let columns = || window(point.x, self.width / 2, width);
            let nearest = rows
                .flat_map(|y| columns().map(move |x| returns.at(x, y)))
                .filter(|depth| *depth > 0.0)
                .fold(point.depth, f32::min);
            if point.depth > self.ratio * nearest + self.metres {
                values[point.y * width + point.x] = 0.0;
            }
        }
        Ok(DepthMap::new(width, height, values)?)
    }
}

impl Display for Occlusion {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let Self {
            ratio,
            metres,
            width,
            height,
            given,
        } = self;
        let of = if *given {
            "truth and given points"
        } else {
            "truth"
        };
        write!(
            f,
            "{of} without returns beyond {ratio} x the nearest of {width}x{height} pixels + {metres} m"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_core::Point;

    #[test]
    fn what_lies_behind_a_nearer_return_of_the_window_is_left_out() {
        let at = |x, y, depth| Point { x, y, depth };
        let returns = DepthMap::from_points(
            30,
            40,
            &[
                // Limit beside it: 1.1 x 10 + 0.3 = 11.3 m.
                at(25, 5, 10.0),
                at(26, 5, 11.25),
                at(25, 6, 11.35),
                at(10, 20, 10.0),
                // The corners of 7x11 pixels, and just outside.
                at(7, 15, 30.0),
                at(13, 25, 30.0),
                at(6, 15, 30.0),
                at(14, 25, 30.0),
                at(10, 14, 30.0),
                at(10, 26, 30.0),
                at(0, 39, 3.0),
            ],
        );
        let visible = Occlusion::default().without(&returns).unwrap();
        let removed: Vec<(usize, usize)> = returns
            .points()
            .filter(|p| visible.at(p.x, p.y) == 0.0)
            .map(|p| (p.x, p.y))
            .collect();
        assert_eq!(removed, [(25, 6), (7, 15), (13, 25)]);
        assert_eq!(visible.count(), 8);
    }
}
