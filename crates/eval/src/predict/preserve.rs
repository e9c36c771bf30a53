//! Preservation of the input depths.

use crate::data::DepthMap;
use lsdc_core::Observations;
use lsdc_core::nearest::NeighbourGrid;
use lsdc_files::error::Result;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How the dense depth preserves the input depths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preserve {
    /// Keep the fit unchanged.
    #[default]
    None,
    /// Replace the depths at the pixels of the points only.
    Exact,
    /// Exact at the points, with their surroundings adapted: residuals are interpolated by inverse squared distance and fade
    /// out. Pixels nearer than the prediction at a point are changed in proportion, so that no depth becomes 0.
    Blend,
}

impl Preserve {
    /// All choices.
    pub const ALL: [Self; 3] = [Self::None, Self::Exact, Self::Blend];

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Exact => "exact",
            Self::Blend => "blend",
        }
    }

    /// Inserts the observations of an image of `size` (width, height) into `depth`. Each belongs to the pixel that contains it;
    /// of several in a pixel, the one nearest to its centre counts.
    ///
    /// # Errors
    /// None for valid maps.
    pub fn apply(
        self,
        depth: DepthMap,
        observations: &Observations,
        size: (usize, usize),
    ) -> Result<DepthMap> {
        if self == Self::None {
            return Ok(depth);
        }
        let (width, height) = (depth.width(), depth.height());
        let mut nearest: BTreeMap<[usize; 2], (f64, f32)> = BTreeMap::new();
        for point in observations
            .iter()
            .filter(|p| p.depth > 0.0 && p.depth.is_finite())
        {
            let [u, v] = [
                (point.u + 0.5) * width as f64 / size.0 as f64 - 0.5,
                (point.v + 0.5) * height as f64 / size.1 as f64 - 0.5,
            ];
            let (x, y) = ((u + 0.5).floor(), (v + 0.5).floor());
            if !(x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64) {
                continue;
            }
            let distance_and_depth = ((u - x).powi(2) + (v - y).powi(2), point.depth);
            let nearest_so_far = nearest
                .entry([y as usize, x as usize])
                .or_insert(distance_and_depth);
            if distance_and_depth
                .0
                .total_cmp(&nearest_so_far.0)
                .then(distance_and_depth.1.total_cmp(&nearest_so_far.1))
                .is_lt()
            {
                *nearest_so_far = distance_and_depth;
            }
        }
        let mut values = depth.into_values();
        if self == Self::Exact {
            for ([y, x], (_, depth)) in nearest {
                values[y * width + x] = depth;
            }
        } else {
            let pixels: Vec<[usize; 2]> = nearest.keys().map(|&[y, x]| [x, y]).collect();
            let depths: Vec<f32> = nearest.values().map(|(_, depth)| *depth).collect();
            blend(&mut values, width, &pixels, &depths);
        }
        Ok(DepthMap::new(width, height, values)?)
    }
}

fn blend(values: &mut [f32], width: usize, pixels: &[[usize; 2]], depths: &[f32]) {
    /// Number of points interpolated at a pixel (Shepard 1968).
    const NEIGHBOURS: usize = 6;
    if pixels.is_empty() {
        return;
    }
    // Two thirds of the mean distance between points.
    let radius = 0.67 * (values.len() as f64 / pixels.len() as f64).sqrt().max(1.5);
    // Predicted depth and residual of each point.
    let residuals: Vec<[f64; 2]> = pixels
        .iter()
        .zip(depths)
        .map(|(&[x, y], &measured)| {
            let value = &mut values[y * width + x];
            if *value == 0.0 {
                // A hole is filled; its residual of 0 leaves the surroundings unchanged.
                *value = measured;
            }
            let predicted = f64::from(*value);
            [predicted, f64::from(measured) - predicted]
        })
        .collect();
    let centres: Vec<_> = pixels.iter().map(|pixel| pixel.map(|v| v as f64)).collect();
    let cells = NeighbourGrid::new(&centres);
    values
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(y, row)| {
            for (x, value) in row.iter_mut().enumerate() {
                let value_before = f64::from(*value);
                if value_before == 0.0 {
                    continue;
                }
                let neighbours = cells.nearest([x as f64, y as f64], NEIGHBOURS);
                let distance = neighbours[0].0.sqrt();
                if distance >= radius {
                    continue;
                }
                let (mut sum, mut total) = (0.0, 0.0);
                for &(square, i) in &neighbours {
                    // At a point, its own weight dominates.
                    let weight = 1.0 / square.max(1e-9);
                    let [predicted, residual] = residuals[i];
                    sum += weight * residual * (value_before / predicted).min(1.0);
                    total += weight;
                }
                let fade = (1.0 - (distance / radius).powi(2)).powi(2);
                *value = (value_before + fade * sum / total) as f32;
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

    fn measured(points: &DepthMap) -> Observations {
        Observations::from_map(points)
    }

    #[test]
    fn exact_changes_the_points_and_nothing_else() {
        let (flat, points) = (flat(), points());
        assert_eq!(
            Preserve::None
                .apply(flat.clone(), &measured(&points), (40, 30))
                .unwrap(),
            flat
        );
        let exact = Preserve::Exact
            .apply(flat.clone(), &measured(&points), (40, 30))
            .unwrap();
        for (i, (value, point)) in exact.values().iter().zip(points.values()).enumerate() {
            let expected = if *point > 0.0 { *point } else { 2.0 };
            assert_eq!(*value, expected, "pixel {i}");
        }
    }

    #[test]
    fn blend_meets_the_points_and_has_no_jump() {
        let (flat, points) = (flat(), points());
        let blended = Preserve::Blend
            .apply(flat.clone(), &measured(&points), (40, 30))
            .unwrap();
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
    fn blend_makes_no_hole_beside_an_outlier() {
        // A foreground at 1 m in front of a wall at 8 m, and a point of 0.3 m where the wall was predicted.
        let step = |i: usize| if i % 40 < 20 { 1.0 } else { 8.0 };
        let depth = DepthMap::new(40, 30, (0..1200).map(step).collect()).unwrap();
        let at = |x, y, depth| Point { x, y, depth };
        let points = DepthMap::from_points(40, 30, &[at(20, 15, 0.3), at(5, 5, 1.1)]);
        let blended = Preserve::Blend
            .apply(depth.clone(), &measured(&points), (40, 30))
            .unwrap();
        assert_eq!(blended.count(), 1200);
        assert_eq!(blended.ignored(), 0);
        for p in points.points() {
            assert!((blended.at(p.x, p.y) - p.depth).abs() < 1e-6);
        }
        // The foreground moves in proportion to its depth.
        assert!(blended.at(19, 15) > 0.03, "{}", blended.at(19, 15));
        assert!(blended.at(19, 15) < 1.0);
    }

    #[test]
    fn blend_leaves_holes_but_for_the_points_in_them() {
        let mut values = vec![2.0; 1200];
        values[..600].fill(0.0);
        let depth = DepthMap::new(40, 30, values).unwrap();
        let at = |x, y, depth| Point { x, y, depth };
        let points = DepthMap::from_points(40, 30, &[at(5, 14, 3.0)]);
        let blended = Preserve::Blend
            .apply(depth, &measured(&points), (40, 30))
            .unwrap();
        assert_eq!(blended.count(), 601);
        assert_eq!((blended.at(5, 14), blended.at(5, 15)), (3.0, 2.0));
    }

    #[test]
    fn points_find_their_pixel_at_another_size() {
        let large = DepthMap::new(80, 60, vec![2.0; 4800]).unwrap();
        let exact = Preserve::Exact
            .apply(large, &measured(&points()), (40, 30))
            .unwrap();
        assert_eq!(exact.values()[11 * 80 + 11], 3.0);
        assert_eq!(exact.values()[59 * 80 + 79], 2.0);
    }
}
