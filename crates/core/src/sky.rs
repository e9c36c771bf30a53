//! Sky in the relative inverse depths that Depth Anything predicts from an image, and what of it no point measured.

use crate::completion::Completion;
use crate::depth_guide::DepthGuide;
use crate::fit::median;
use crate::nearest::NeighbourGrid;
use rayon::prelude::*;

/// Largest inverse depth of sky, relative to the nearest.
const SKY: f32 = 0.01;
/// Smallest share of sky pixels of an image with sky.
const SKY_AREA: f32 = 0.02;

/// Largest shift of inverse depths, relative to the nearest, at which 0 is taken for infinity. Medians of laser scans outdoors are
/// 0.02 to 0.04, that of rooms is 0.43: there, 0 is the far end of the room, or a mirror.
const LARGEST_SHIFT: f64 = 0.1;
/// Fewest points that tell the shift.
const FEWEST_POINTS: usize = 6;
/// Sky is measured up to this distance from a point in it, in distances between points: the mean, or that of the point from its
/// third nearest neighbour (at random places about the mean), if this is smaller, as in clusters.
const NEAR: f64 = 2.0;
const NEIGHBOUR: usize = 3;

/// The scale of the relative inverse depths of an image, and whether it shows sky. Depth Anything V2 was trained with a loss
/// that does not depend on the shift of inverse depths, but with infinity at 0 (Yang et al. 2024).
#[doc(hidden)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseDepthScale {
    /// The inverse depth of near things: the 95th percentile of those above 0.
    pub nearest: f32,
    /// Whether the image shows sky.
    pub has_sky: bool,
}

impl InverseDepthScale {
    /// The scale of these inverse depths; `None` if all are at infinity.
    pub fn of(inverse: &[f32]) -> Option<Self> {
        let mut sorted = inverse.to_vec();
        sorted.sort_unstable_by(f32::total_cmp);
        // Excludes points at infinity: there may be little below a wide sky.
        let finite = sorted.partition_point(|value| *value <= 0.0);
        let nearest = *sorted.get(finite + (sorted.len() - finite) * 95 / 100)?;
        let sky = sorted.partition_point(|value| *value < SKY * nearest);
        Some(Self {
            nearest,
            has_sky: sky as f32 > SKY_AREA * inverse.len() as f32,
        })
    }

    /// Whether a pixel with this inverse depth shows sky.
    pub fn is_sky(&self, inverse: f32) -> bool {
        self.has_sky && inverse < SKY * self.nearest
    }

    /// Whether 0 is at infinity by points with these (relative, measured) inverse depths, or they are too few to tell. The line
    /// through the medians of the farther and the nearer half (Wald 1940) resists outliers.
    pub fn has_infinity(&self, mut points: Vec<(f32, f64)>) -> bool {
        if points.len() < FEWEST_POINTS {
            return true;
        }
        points.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let (far, near) = points.split_at(points.len() / 2);
        let [(far, least), (near, most)] = [far, near].map(|half| {
            let middle = median(half.iter().map(|(relative, _)| f64::from(*relative)));
            (middle, median(half.iter().map(|(_, measured)| *measured)))
        });
        let slope = (most - least) / (near - far);
        let shift = (least - slope * far) / (slope * f64::from(self.nearest));
        // Points at one relative depth do not tell.
        near == far || (slope > 0.0 && shift < LARGEST_SHIFT)
    }
}

/// The sky of an image that no point measured.
pub(crate) struct UnmeasuredSky<'a> {
    guide: &'a DepthGuide,
    scale: InverseDepthScale,
    /// Height and width of the image.
    size: (usize, usize),
    /// Points in what the guide takes for sky.
    points: NeighbourGrid,
    /// Square of the distance from each of them up to which sky is measured.
    near: Vec<f64>,
}

impl<'a> UnmeasuredSky<'a> {
    /// `None` if no guide shows sky, or if the points say that what it takes for sky is not far away.
    pub(crate) fn of(completion: &'a Completion) -> Option<Self> {
        let (scene, usable) = (completion.scene(), completion.usable());
        let guide = scene.guide()?;
        let scale = guide.scale_with_sky()?;
        let size = scene.size();
        let inverse = |place: [f64; 2]| guide.inverse_at(size, place).unwrap_or(f32::INFINITY);
        let points = usable.places.iter().zip(&usable.depths);
        let points = points.map(|(place, depth)| (inverse(*place), f64::from(*depth).recip()));
        if !scale.has_infinity(points.collect()) {
            return None;
        }
        let places = usable.places.iter().copied();
        let in_sky: Vec<_> = places
            .filter(|place| scale.is_sky(inverse(*place)))
            .collect();
        let all = NeighbourGrid::new(&usable.places);
        let mean = (size.0 * size.1) as f64 / usable.places.len().max(1) as f64;
        let near = in_sky.iter().map(|place| {
            // Itself is the nearest.
            let nearest = all.nearest(*place, NEIGHBOUR + 1);
            let neighbour = nearest.get(NEIGHBOUR).map_or(mean, |(square, _)| *square);
            NEAR.powi(2) * neighbour.min(mean)
        });
        Some(Self {
            guide,
            scale,
            size,
            near: near.collect(),
            points: NeighbourGrid::new(&in_sky),
        })
    }

    /// Whether each pixel of a map of `height` rows and `width` columns shows sky that no point measured.
    pub(crate) fn mask(&self, (height, width): (usize, usize)) -> Vec<bool> {
        let down = self.size.0 as f64 / height as f64;
        let right = self.size.1 as f64 / width as f64;
        let pixels = (0..height * width).into_par_iter();
        let mask = pixels.map_init(Vec::new, |nearest, pixel| {
            let (x, y) = ((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
            let place = [x * right - 0.5, y * down - 0.5];
            let inverse = self.guide.inverse_at(self.size, place);
            if !inverse.is_some_and(|inverse| self.scale.is_sky(inverse)) {
                return false;
            }
            self.points.find(place, 1, nearest);
            nearest
                .first()
                .is_none_or(|(square, point)| *square > self.near[*point])
        });
        mask.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sky_is_wide_and_at_infinity() {
        let mut inverse: Vec<f32> = (0..97).map(|i| 1.0 + i as f32).collect();
        inverse.extend([0.0, 0.5, 2.0]);
        let scale = InverseDepthScale::of(&inverse).unwrap();
        // 99 values are above 0; 94 of them are smaller.
        assert_eq!((scale.nearest, scale.has_sky), (93.0, false));
        assert!(!scale.is_sky(0.0));
        inverse[..2].fill(0.9);
        let scale = InverseDepthScale::of(&inverse).unwrap();
        assert!(scale.has_sky && scale.is_sky(0.92) && !scale.is_sky(0.94));
        assert_eq!(InverseDepthScale::of(&[0.0; 9]), None);
    }

    #[test]
    fn points_tell_whether_0_is_at_infinity() {
        let scale = InverseDepthScale {
            nearest: 5.0,
            has_sky: true,
        };
        // Inverse depths 0.02 (g + 5 s), and an outlier in each half.
        let points = |shift: f64, count: u8| {
            let point = |i: u8| {
                (
                    f32::from(i) / 10.0,
                    0.02 * (f64::from(i) / 10.0 + 5.0 * shift),
                )
            };
            let mut points: Vec<_> = (0..count).map(point).collect();
            (points[1].1, points[usize::from(count) - 1].1) = (9.0, 1e-9);
            points
        };
        assert!(scale.has_infinity(points(0.03, 50)) && scale.has_infinity(points(0.05, 50)));
        assert!(!scale.has_infinity(points(0.13, 50)) && !scale.has_infinity(points(0.43, 50)));
        // Too few, all alike, or the wrong way round.
        assert!(scale.has_infinity(points(0.43, 5)));
        assert!(scale.has_infinity(vec![(1.0, 0.5); 9]));
        let reversed = points(0.03, 50).into_iter().map(|(g, y)| (5.0 - g, y));
        assert!(!scale.has_infinity(reversed.collect()));
    }
}
