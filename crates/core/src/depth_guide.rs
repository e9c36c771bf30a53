//! A dense prediction of depth by other means, used as additional basis functions.

use crate::bilinear::InterpolationWeights;
use crate::ensemble::mirrored;
use crate::error::{ImageError, Result};
use crate::fit::median;
use crate::image::check_length;
use crate::sky::InverseDepthScale;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::sync::Arc;

/// The meaning of the values of a guide, each up to scale and shift.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GuideKind {
    /// Depths above 0, for example from metric networks, photogrammetry, or an earlier recording.
    #[default]
    Depth,
    /// Inverse depths: larger is nearer, as predicted by `MiDaS` and Depth Anything.
    Disparity,
    /// Logarithms of depths, to any base.
    Log,
}

/// A dense prediction of depth for an image, by any other network or program.
///
/// It is converted to basis functions: a constant, the depths that it represents under several shifts, and the first of these
/// multiplied by low-frequency cosines. The fit estimates their weights, so neither unit, scale nor shift need be known; the
/// points determine how much the guide is trusted. The affinity of neighbouring pixels is reduced where the guide has a step.
///
/// ```
/// use lsdc_core::{DepthGuide, GuideKind};
///
/// # fn main() -> Result<(), lsdc_core::Error> {
/// // Any size; where there is no prediction, NaN.
/// let disparity = [0.9, 0.8, f32::NAN, 0.4];
/// let guide = DepthGuide::new(GuideKind::Disparity, 2, 2, &disparity)?;
/// assert_eq!(guide.missing(), 1);
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct DepthGuide(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    height: usize,
    width: usize,
    /// Functions of mean 0 and mean square 1 over the image, `[height, width, functions]`.
    functions: Vec<f32>,
    count: usize,
    missing: usize,
    sky: Option<Sky>,
}

/// Relative inverse depths of an image that shows sky.
#[derive(Debug)]
struct Sky {
    scale: InverseDepthScale,
    inverse: Vec<f32>,
}

/// Frequencies along x and y of the cosines that multiply the first function.
const COSINES: [(f64, f64); 5] = [(1.0, 0.0), (0.0, 1.0), (2.0, 0.0), (1.0, 1.0), (0.0, 2.0)];
/// Expected weights of the products with cosines, relative to those of the functions themselves.
const PRODUCTS: f32 = 0.3;
/// Shifts of inverse depths, relative to their range in an image. Without a shift the farthest would be at infinity.
const SHIFTS: [f64; 3] = [0.3, 0.1, 1.0];
/// Shifts if the image shows sky. Medians of laser scans outdoors are 0.02 to 0.04.
const SHIFTS_OUTDOORS: [f64; 3] = [0.02, 0.06, 0.2];
/// The step between neighbours that halves their affinity, in standard deviations of the first function.
const STEP: f64 = 0.2;
/// Values are clamped to this factor from their median.
const EXTREME: f64 = 50.0;

impl DepthGuide {
    /// A guide of any size from `height` rows of `width` values. Values that are not finite, and depths that are not above 0,
    /// are missing: gaps are filled from both sides. Depths further than a factor of 50 from their median are clamped.
    ///
    /// # Errors
    /// The number of values is not `width * height`, the guide is empty, or all of its values are missing or equal.
    pub fn new(kind: GuideKind, width: usize, height: usize, values: &[f32]) -> Result<Self> {
        Self::made(kind, (width, height), values, None)
    }

    /// A guide of relative inverse depths with infinity at 0, as predicted by Depth Anything: it knows where sky is.
    ///
    /// # Errors
    /// As for [`Self::new`].
    #[doc(hidden)]
    pub fn with_sky(width: usize, height: usize, inverse: &[f32]) -> Result<Self> {
        let scale = InverseDepthScale::of(inverse).filter(|scale| scale.has_sky);
        let sky = scale.map(|scale| Sky {
            scale,
            inverse: inverse.to_vec(),
        });
        Self::made(GuideKind::Disparity, (width, height), inverse, sky)
    }

    fn made(
        kind: GuideKind,
        (width, height): (usize, usize),
        values: &[f32],
        sky: Option<Sky>,
    ) -> Result<Self> {
        check_length(width, height, values.len())?;
        let usable = |v: f32| v.is_finite() && (kind != GuideKind::Depth || v > 0.0);
        let missing = values.iter().filter(|v| !usable(**v)).count();
        let known: Vec<Option<f32>> = values.iter().map(|&v| usable(v).then_some(v)).collect();
        let filled = filled(known, width).ok_or(ImageError::NoGuide)?;
        let maps = standardised(kind.depths(&filled, sky.is_some()));
        if maps.is_empty() {
            return Err(ImageError::NoGuide.into());
        }
        let pixels = 0..width * height;
        let functions = pixels.flat_map(|i| maps.iter().map(move |map| map[i]));
        Ok(Self(Arc::new(Inner {
            height,
            width,
            functions: functions.collect(),
            count: maps.len(),
            missing,
            sky,
        })))
    }

    /// The scale of relative inverse depths, if they show sky.
    pub(crate) fn scale_with_sky(&self) -> Option<InverseDepthScale> {
        self.0.sky.as_ref().map(|sky| sky.scale)
    }

    /// The relative inverse depth at the pixel nearest to a position (u, v) of an image of `size` (height, width), if the guide
    /// shows sky.
    pub(crate) fn inverse_at(&self, size: (usize, usize), place: [f64; 2]) -> Option<f32> {
        let Inner {
            height, width, sky, ..
        } = &*self.0;
        // Saturates at the borders.
        let pixel = |at: f64, length: usize, own: usize| {
            (((at + 0.5) * own as f64 / length as f64) as usize).min(own - 1)
        };
        let x = pixel(place[0], size.1, *width);
        let y = pixel(place[1], size.0, *height);
        sky.as_ref().map(|sky| sky.inverse[y * width + x])
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.0.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.0.height
    }

    /// The number of pixels without a usable value.
    pub fn missing(&self) -> usize {
        self.0.missing
    }

    /// The guide of the mirror image.
    pub(crate) fn mirrored(&self) -> Self {
        let Inner {
            height,
            width,
            ref functions,
            count,
            missing,
            ref sky,
        } = *self.0;
        Self(Arc::new(Inner {
            height,
            width,
            functions: mirrored(functions, width, count),
            count,
            missing,
            sky: sky.as_ref().map(|sky| Sky {
                scale: sky.scale,
                inverse: mirrored(&sky.inverse, width, 1),
            }),
        }))
    }

    /// The number of basis functions.
    pub(crate) fn count(&self) -> usize {
        1 + self.0.count + COSINES.len()
    }

    /// The functions `[places, count]` at positions (u, v) of an image of `size` (height, width).
    pub(crate) fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        let Inner {
            height,
            width,
            functions,
            count,
            ..
        } = &*self.0;
        let mut rows = vec![0.0; places.len() * self.count()];
        let pairs = rows.par_chunks_exact_mut(self.count()).zip(places);
        pairs.for_each(|(row, &place)| {
            row[0] = 1.0;
            let (own, products) = row[1..].split_at_mut(*count);
            for (pixel, share) in InterpolationWeights::new(place, size, (*height, *width)).iter() {
                let values = &functions[pixel as usize * count..][..*count];
                let sums = own.iter_mut().zip(values);
                sums.for_each(|(sum, value)| *sum += share as f32 * value);
            }
            let [x, y] = [(place[0], size.1), (place[1], size.0)]
                .map(|(v, length)| PI * (v + 0.5) / length as f64);
            for (product, (across, down)) in products.iter_mut().zip(COSINES) {
                let cosine = (across * x).cos() * (down * y).cos();
                *product = PRODUCTS * own[0] * cosine as f32;
            }
        });
        rows
    }

    /// Returns the share of its affinity to its right neighbour, and to the one below, that each pixel of a grid keeps,
    /// `[height, width, 2]`: less where the guide has a step.
    pub(crate) fn affinity_shares(&self, (height, width): (usize, usize)) -> Vec<f64> {
        let line = |y: usize| {
            let places: Vec<[f64; 2]> = (0..width).map(|x| [x as f64, y as f64]).collect();
            let functions = self.at((height, width), &places);
            let firsts = functions.chunks_exact(self.count()).map(|row| row[1]);
            firsts.collect::<Vec<f32>>()
        };
        let lines: Vec<Vec<f32>> = (0..height).into_par_iter().map(line).collect();
        let share = |from: f32, to: Option<&f32>| {
            to.map_or(1.0, |to| {
                (1.0 + (f64::from(to - from) / STEP).powi(2)).recip()
            })
        };
        let pixel = |i: usize| {
            let (y, x) = (i / width, i % width);
            let below = lines.get(y + 1).map(|line| &line[x]);
            [
                share(lines[y][x], lines[y].get(x + 1)),
                share(lines[y][x], below),
            ]
        };
        (0..height * width).flat_map(pixel).collect()
    }

    /// Adds the weighted sum of the functions to a map of `size` (height, width).
    pub(crate) fn add_to(&self, size: (usize, usize), weights: &[f64], map: &mut [f32]) {
        let rows = map.par_chunks_exact_mut(size.1.max(1)).enumerate();
        rows.for_each(|(y, row)| {
            let places: Vec<[f64; 2]> = (0..size.1).map(|x| [x as f64, y as f64]).collect();
            let functions = self.at(size, &places);
            for (value, functions) in row.iter_mut().zip(functions.chunks_exact(self.count())) {
                let pairs = functions.iter().zip(weights);
                *value += pairs.map(|(f, w)| f64::from(*f) * w).sum::<f64>() as f32;
            }
        });
    }
}

impl GuideKind {
    /// Returns maps whose linear combination with a constant may be the depth, the likeliest first. `with_infinity` is whether
    /// inverse depths of 0 are at infinity.
    fn depths(self, values: &[f32], with_infinity: bool) -> Vec<Vec<f64>> {
        let middle = median(values.iter().map(|&v| f64::from(v)));
        let each = |of: &dyn Fn(f64) -> f64| values.iter().map(|v| of(f64::from(*v))).collect();
        match self {
            Self::Depth => {
                let ratio = |v: f64| (v / middle).clamp(EXTREME.recip(), EXTREME);
                vec![
                    each(&ratio),
                    each(&|v| ratio(v).ln()),
                    each(&|v| ratio(v).recip()),
                ]
            }
            Self::Disparity => {
                // Between 0 and 1 except for the nearest, so that shifts are relative to the range in the image.
                let (low, high) = range(values);
                let ratio = |v: f64| ((v - low) / (high - low)).max(0.0);
                let shifted = |shift: f64| each(&|v: f64| (ratio(v) + shift).recip());
                let shifts = if with_infinity {
                    SHIFTS_OUTDOORS
                } else {
                    SHIFTS
                };
                let maps = shifts.into_iter().map(shifted);
                maps.chain([each(&ratio)]).collect()
            }
            Self::Log => {
                let (low, high) = range(values);
                let ratio = |v: f64| ((v - middle) / (high - low)).clamp(-3.0, 3.0);
                let power = |times: f64| each(&|v: f64| (times * ratio(v)).exp());
                vec![power(1.5), power(3.0), each(&ratio)]
            }
        }
    }
}

/// Returns the 2 % and 98 % quantiles.
fn range(values: &[f32]) -> (f64, f64) {
    let mut sorted = values.to_vec();
    sorted.sort_by(f32::total_cmp);
    let at = |share: f64| f64::from(sorted[((sorted.len() - 1) as f64 * share) as usize]);
    let (low, high) = (at(0.02), at(0.98));
    (low, if high > low { high } else { low + 1.0 })
}

/// Scales maps to mean 0 and mean square 1; constant maps are dropped.
fn standardised(maps: Vec<Vec<f64>>) -> Vec<Vec<f32>> {
    let standardise = |map: Vec<f64>| {
        let count = map.len() as f64;
        let mean = map.iter().sum::<f64>() / count;
        let square = map.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
        let constant = square <= 1e-12 * mean * mean || square <= 0.0;
        let scale = square.sqrt().recip();
        let values = map.iter().map(|v| ((v - mean) * scale) as f32);
        (!constant).then(|| values.collect())
    };
    maps.into_iter().filter_map(standardise).collect()
}

/// Fills missing values: by interpolation between the nearest values to the left and right, or, in rows without values, from
/// the row above or below. `None` if all are missing.
fn filled(values: Vec<Option<f32>>, width: usize) -> Option<Vec<f32>> {
    let rows: Vec<Option<Vec<f32>>> = values.chunks(width).map(between).collect();
    let mut last = rows.iter().flatten().next()?;
    let mut filled = Vec::with_capacity(values.len());
    for row in &rows {
        last = row.as_ref().unwrap_or(last);
        filled.extend_from_slice(last);
    }
    Some(filled)
}

/// Fills the gaps of a row linearly; `None` if it has no values.
fn between(row: &[Option<f32>]) -> Option<Vec<f32>> {
    let known: Vec<(usize, f32)> = row
        .iter()
        .enumerate()
        .filter_map(|(x, v)| Some((x, (*v)?)))
        .collect();
    let (first, last) = (known.first()?, known.last()?);
    let mut filled = vec![first.1; row.len()];
    for pair in known.windows(2) {
        let ((start, from), (end, to)) = (pair[0], pair[1]);
        let step = (to - from) / (end - start) as f32;
        let gap = filled[start..=end].iter_mut().enumerate();
        gap.for_each(|(x, value)| *value = from + step * x as f32);
    }
    filled[last.0..].fill(last.1);
    Some(filled)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_of_a_guide_loosen_its_neighbours() {
        // Two halves, each one standard deviation from the mean.
        let values = [1.0, 1.0, 3.0, 3.0].repeat(2);
        let guide = DepthGuide::new(GuideKind::Depth, 4, 2, &values).unwrap();
        let across = (1.0 + (2.0 / STEP).powi(2)).recip();
        for (i, share) in guide.affinity_shares((2, 4)).into_iter().enumerate() {
            let cut = i % 2 == 0 && (i / 2) % 4 == 1;
            let expected = if cut { across } else { 1.0 };
            assert!((share / expected - 1.0).abs() < 1e-4, "{i}: {share}");
        }
    }
}
