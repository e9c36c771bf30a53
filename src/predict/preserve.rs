//! What becomes of the given depths themselves.

use super::places;
use crate::data::DepthMap;
use crate::error::Result;
use crate::nearest::Cells;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Whether the dense depth meets the points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preserve {
    /// Not exactly: the fit stays as it is.
    #[default]
    None,
    /// At the pixels of the points, and nowhere else.
    Exact,
    /// Exactly, and their neighbourhood follows: residuals are interpolated by the inverse square
    /// of the distance and fade out.
    Blend,
}

impl Preserve {
    /// All choices.
    pub const ALL: [Self; 3] = [Self::None, Self::Exact, Self::Blend];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Exact => "exact",
            Self::Blend => "blend",
        }
    }

    /// `depth` with the points of `sparse` in it; a point at (x, y) belongs to the pixel that its
    /// centre falls into where sizes differ.
    ///
    /// # Errors
    /// None for maps that are sound.
    pub fn apply(self, depth: DepthMap, sparse: &DepthMap) -> Result<DepthMap> {
        let (width, height) = (depth.width(), depth.height());
        let scaled = |v: usize, from: usize, to: usize| ((2 * v + 1) * to / (2 * from)).min(to - 1);
        let (places, depths) = places(sparse);
        let places: Vec<[usize; 2]> = places
            .iter()
            .map(|&[x, y]| {
                [
                    scaled(x, sparse.width(), width),
                    scaled(y, sparse.height(), height),
                ]
            })
            .collect();
        let mut values = depth.into_values();
        match self {
            Self::None => {}
            Self::Exact => {
                for (&[x, y], d) in places.iter().zip(depths) {
                    values[y * width + x] = d;
                }
            }
            Self::Blend => blend(&mut values, width, &places, &depths),
        }
        DepthMap::new(width, height, values)
    }
}

fn blend(values: &mut [f32], width: usize, places: &[[usize; 2]], depths: &[f32]) {
    /// Points that take part at a pixel (Shepard 1968).
    const COUNT: usize = 6;
    if places.is_empty() {
        return;
    }
    // Two thirds of the mean distance between points.
    let reach = 0.67 * (values.len() as f64 / places.len() as f64).sqrt().max(1.5);
    let pairs = places.iter().zip(depths);
    let residuals: Vec<f64> = pairs
        .map(|(&[x, y], d)| f64::from(d - values[y * width + x]))
        .collect();
    let cells = Cells::new(places);
    values
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, row)| {
            for (x, value) in row.iter_mut().enumerate() {
                let near = cells.nearest([x, y], COUNT);
                let distance = (near[0].0 as f64).sqrt();
                if distance >= reach {
                    continue;
                }
                let (mut sum, mut total) = (0.0, 0.0);
                for &(square, i) in &near {
                    // At a point nothing else counts.
                    let weight = 1.0 / (square as f64).max(1e-9);
                    sum += weight * residuals[i];
                    total += weight;
                }
                let fade = (1.0 - (distance / reach).powi(2)).powi(2);
                *value += (fade * sum / total) as f32;
            }
        });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Point;

    fn flat() -> DepthMap {
        DepthMap::new(40, 30, vec![2.0; 1200]).unwrap()
    }

    fn points() -> DepthMap {
        let at = |x, y, depth| Point { x, y, depth };
        DepthMap::from_points(40, 30, &[at(5, 5, 3.0), at(30, 20, 1.5), at(39, 29, 2.0)])
    }

    #[test]
    fn exact_changes_the_points_and_nothing_else() {
        let (flat, points) = (flat(), points());
        assert_eq!(Preserve::None.apply(flat.clone(), &points).unwrap(), flat);
        let exact = Preserve::Exact.apply(flat.clone(), &points).unwrap();
        for (i, (value, point)) in exact.values().iter().zip(points.values()).enumerate() {
            let expected = if *point > 0.0 { *point } else { 2.0 };
            assert_eq!(*value, expected, "pixel {i}");
        }
    }

    #[test]
    fn blend_meets_the_points_and_has_no_jump() {
        let (flat, points) = (flat(), points());
        let blended = Preserve::Blend.apply(flat.clone(), &points).unwrap();
        for p in points.points() {
            let value = blended.values()[p.y * 40 + p.x];
            assert!((value - p.depth).abs() < 1e-6, "{value}");
        }
        for row in blended.values().chunks_exact(40) {
            let steps = row.array_windows().map(|[a, b]| (a - b).abs());
            assert!(steps.fold(0.0, f32::max) < 0.25);
        }
    }

    #[test]
    fn points_find_their_pixel_at_another_size() {
        let large = DepthMap::new(80, 60, vec![2.0; 4800]).unwrap();
        let exact = Preserve::Exact.apply(large, &points()).unwrap();
        assert_eq!(exact.values()[11 * 80 + 11], 3.0);
        assert_eq!(exact.values()[59 * 80 + 79], 2.0);
    }
}
