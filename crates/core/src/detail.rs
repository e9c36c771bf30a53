//! Dense observations at a higher resolution than the grid of the field. If an image is larger than this grid and many of its
//! pixels are observed, several of them share a pixel of the grid, and a map that is interpolated from it can follow only their
//! mean. The correction in this module makes the map follow each observed pixel, and corrects its neighbours according to their
//! similarity.

use crate::bilinear::InterpolationWeights;
use crate::fit::SmoothField;
use crate::upsampling::{PixelBlock, Upsampling};
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;

/// Pixels on each side of the window.
const REACH: usize = 2;
/// Least share of observed pixels in the window where observations count as dense.
const DENSE: f64 = 0.25;
/// Standard deviation of the window, in pixels. Chosen from 0.6 to 2 on depth maps with a tenth or a half of the pixels held
/// back.
const SPREAD: f32 = 0.65;
/// Weight of a residual of 0 that is included in the mean of the observations.
const NOTHING: f32 = 0.01;

/// The mean residual of the observations in a pixel, and their weight.
#[derive(Clone, Copy, Debug, Default)]
struct PixelResidual {
    value: f32,
    weight: f32,
}

/// Residuals of dense observations at each pixel.
#[derive(Debug)]
pub(crate) struct PixelResiduals {
    /// One mean residual for each pixel of the image.
    values: Vec<PixelResidual>,
    height: usize,
    width: usize,
    /// Weights in the window, by squared distance.
    near: [f32; 2 * REACH * REACH + 1],
}

/// A correction that is added to a map, and the limits of the sum.
#[derive(Debug)]
pub(crate) struct Detail {
    pixel_residuals: PixelResiduals,
    added: SmoothField,
    /// Smallest and largest depth observed around each unobserved pixel; the correction does not move the map beyond them.
    limits: Vec<[f32; 2]>,
}

/// No limits.
const ANY: [f32; 2] = [f32::NEG_INFINITY, f32::INFINITY];

impl PixelResiduals {
    /// From residuals and weights (0 to 1) of observations at `places` of an image of `size` (height, width); `None` if they
    /// are dense nowhere.
    pub(crate) fn new(
        (height, width): (usize, usize),
        places: &[[f64; 2]],
        residuals: &[f64],
        weights: &[f64],
    ) -> Option<Self> {
        let pixels: Vec<u32> = places
            .par_iter()
            .map(|&place| pixel(place, (height, width)) as u32)
            .collect();
        let mut observed = vec![false; height * width];
        for &pixel in &pixels {
            observed[pixel as usize] = true;
        }
        let dense = |pixel: u32| {
            let (mut count, mut all) = (0_u32, 0_u32);
            Neighbourhood::new(pixel as usize, width, height).each(|_, other, _| {
                count += u32::from(observed[other]);
                all += 1;
            });
            f64::from(count) >= DENSE * f64::from(all)
        };
        let all = pixels.par_iter().zip(0..pixels.len() as u32);
        let mut order: Vec<(u32, u32)> = all
            .filter(|(pixel, _)| dense(**pixel))
            .map(|(&pixel, i)| (pixel, i))
            .collect();
        if order.is_empty() {
            return None;
        }
        order.par_sort_unstable();
        let mut values = vec![PixelResidual::default(); height * width];
        for same in order.chunk_by_mut(|a, b| a.0 == b.0) {
            // By residual, so that the order of the observations does not matter.
            same.sort_unstable_by(|a, b| {
                let [a, b] = [a.1 as usize, b.1 as usize];
                let residual = residuals[a].total_cmp(&residuals[b]);
                residual.then(weights[a].total_cmp(&weights[b]))
            });
            let own = || same.iter().map(|&(_, i)| i as usize);
            let total: f64 = own().map(|i| weights[i]).sum();
            let sum: f64 = own().map(|i| weights[i] * residuals[i]).sum();
            if total > 0.0 {
                values[same[0].0 as usize] = PixelResidual {
                    value: (sum / total) as f32,
                    weight: total as f32,
                };
            }
        }
        let near = std::array::from_fn(|square| (-0.5 * square as f32 / (SPREAD * SPREAD)).exp());
        Some(Self {
            values,
            height,
            width,
            near,
        })
    }

    /// Returns the correction of a pixel: a mean of its own residual, by its weight, and of the mean of its neighbours.
    /// Residuals of neighbours in `cell` are `shift` larger.
    fn correction(
        &self,
        upsampling: &Upsampling,
        pixel: usize,
        own: PixelResidual,
        (shift, cell): (f32, Option<&PixelBlock>),
    ) -> f32 {
        let weight = own.weight.min(1.0);
        if weight >= 1.0 {
            return own.value;
        }
        let (mut sum, mut total) = (0.0, NOTHING);
        self.neighbours(upsampling, pixel, |place, value, share| {
            let shifted = cell.is_some_and(|cell| cell.contains(place));
            sum += share * if shifted { value + shift } else { value };
            total += share;
        });
        weight * own.value + (1.0 - weight) * sum / total
    }

    /// Returns, for each pixel of a row, whether the window around it contains residuals.
    fn beside(&self, y: usize) -> impl Iterator<Item = bool> + use<> {
        let rows = y.saturating_sub(REACH)..(y + REACH + 1).min(self.height);
        let mut columns = vec![false; self.width];
        for row in rows {
            let row = &self.values[row * self.width..][..self.width];
            let pairs = columns.iter_mut().zip(row);
            pairs.for_each(|(any, residual)| *any |= residual.weight > 0.0);
        }
        (0..self.width).map(move |x| {
            let end = (x + REACH + 1).min(columns.len());
            columns[x.saturating_sub(REACH)..end].contains(&true)
        })
    }

    /// Returns column and row, residual and share of every other observed pixel around a pixel.
    fn neighbours(
        &self,
        upsampling: &Upsampling,
        pixel: usize,
        mut visit: impl FnMut([usize; 2], f32, f32),
    ) {
        Neighbourhood::new(pixel, self.width, self.height).each(|place, other, square| {
            let residual = self.values[other];
            if residual.weight > 0.0 && other != pixel {
                let alike = upsampling.likeness(pixel, other);
                visit(
                    place,
                    residual.value,
                    self.near[square] * residual.weight.min(1.0) * alike,
                );
            }
        });
    }

    /// Returns the degree to which the map follows observations at a pixel, from 0 (the map of the fit) to 1.
    fn followed(&self, upsampling: &Upsampling, pixel: usize) -> f32 {
        let weight = self.values[pixel].weight.min(1.0);
        let mut total = 0.0;
        self.neighbours(upsampling, pixel, |_, _, share| total += share);
        weight + (1.0 - weight) * total / (total + NOTHING)
    }

    /// Reduces standard deviations of the fit, a map of `size` (height, width), to those of the map that follows observations.
    /// `errors` are leave-one-out errors of that map at the `places` of the observations: a share `SHARE` of them is within the
    /// reduced deviations, as within one standard deviation. Deviations never increase.
    pub(crate) fn reduce(
        &self,
        upsampling: &Upsampling,
        (places, errors): (&[[f64; 2]], &[f64]),
        size: (usize, usize),
        deviations: &mut [f32],
    ) {
        /// The share of a normal distribution within one standard deviation.
        const SHARE: f64 = 0.6827;
        /// Least number of errors for which deviations are reduced.
        const FEW: usize = 100;
        let own = (self.height, self.width);
        // Returns the pixel of the map that contains the centre of a pixel of the image.
        let over = |i: usize, own: usize, size: usize| (2 * i + 1) * size / (2 * own);
        let deviation = |place| {
            let pixel = pixel(place, own);
            let (x, y) = (pixel % own.1, pixel / own.1);
            deviations[over(y, own.0, size.0) * size.1 + over(x, own.1, size.1)]
        };
        let ratio = |(&place, &error): (&[f64; 2], &f64)| {
            let followed = self.values[pixel(place, own)].weight > 0.0;
            let ratio = error.abs() / f64::from(deviation(place));
            (followed && ratio.is_finite()).then_some(ratio)
        };
        let mut ratios: Vec<f64> = places.par_iter().zip(errors).filter_map(ratio).collect();
        if ratios.len() < FEW {
            return;
        }
        let place = (ratios.len() as f64 * SHARE) as usize;
        let factor = *ratios.select_nth_unstable_by(place, f64::total_cmp).1 as f32;
        let less = 1.0 - factor.min(1.0).powi(2);
        let rows = deviations.par_chunks_exact_mut(size.1.max(1)).enumerate();
        rows.for_each(|(y, row)| {
            for (x, deviation) in row.iter_mut().enumerate() {
                let pixel = over(y, size.0, own.0) * own.1 + over(x, size.1, own.1);
                *deviation *= (1.0 - less * self.followed(upsampling, pixel)).sqrt();
            }
        });
    }

    /// Returns the leave-one-out error of the map at an observation at `place` with this residual, weight, and leave-one-out
    /// error of the fit. This is a first-order approximation: only residuals in the same pixel of the grid change, because the
    /// fit follows their mean.
    pub(crate) fn left_out(
        &self,
        upsampling: &Upsampling,
        place: [f64; 2],
        [residual, weight, error]: [f64; 3],
    ) -> f64 {
        let pixel = pixel(place, (self.height, self.width));
        let all = self.values[pixel];
        if all.weight == 0.0 {
            return error;
        }
        // Other observations in the pixel.
        let shift = (error - residual) as f32;
        let weight = weight as f32;
        let others = all.weight - weight;
        let own = if others > 1e-3 * all.weight {
            PixelResidual {
                value: (all.weight * all.value - weight * residual as f32) / others + shift,
                weight: others,
            }
        } else {
            PixelResidual::default()
        };
        let cell = upsampling.cell(pixel);
        error - f64::from(self.correction(upsampling, pixel, own, (shift, Some(&cell))))
    }
}

impl Detail {
    /// Returns the correction of a map that is interpolated with `upsampling`, for observations at `places` with these depths.
    /// A pixel that is observed with weight 1 gets its mean residual.
    pub(crate) fn new(
        upsampling: &Upsampling,
        pixel_residuals: PixelResiduals,
        places: &[[f64; 2]],
        depths: &[f32],
    ) -> Self {
        let size = upsampling.size();
        let mut ranges = vec![[f32::INFINITY, f32::NEG_INFINITY]; size.0 * size.1];
        for (&place, &depth) in places.iter().zip(depths) {
            let range = &mut ranges[pixel(place, size)];
            *range = [range[0].min(depth), range[1].max(depth)];
        }
        let (mut added, mut limits) = (vec![0.0; size.0 * size.1], vec![ANY; size.0 * size.1]);
        let rows = added
            .par_chunks_mut(size.1)
            .zip(limits.par_chunks_mut(size.1));
        rows.enumerate().each(|(y, (added, limits))| {
            let beside = pixel_residuals.beside(y);
            let pixels = added.iter_mut().zip(limits).zip(beside).zip(y * size.1..);
            // Pixels without observations nearby are not corrected.
            for (((added, limits), _), pixel) in pixels.filter(|((_, beside), _)| *beside) {
                let own = pixel_residuals.values[pixel];
                *added = pixel_residuals.correction(upsampling, pixel, own, (0.0, None));
                if own.weight >= 1.0 || *added == 0.0 {
                    continue;
                }
                *limits = ranges[pixel];
                Neighbourhood::new(pixel, size.1, size.0).each(|_, other, _| {
                    if pixel_residuals.values[other].weight > 0.0 {
                        let [low, high] = ranges[other];
                        *limits = [limits[0].min(low), limits[1].max(high)];
                    }
                });
            }
        });
        Self {
            pixel_residuals,
            added: SmoothField::from_values(size, added),
            limits,
        }
    }

    /// The residuals of the observations.
    pub(crate) fn pixel_residuals(&self) -> &PixelResiduals {
        &self.pixel_residuals
    }

    /// Adds the correction to a map of depths of `size` (height, width).
    pub(crate) fn add_to(&self, size: (usize, usize), depths: &mut [f32]) {
        let mut added = vec![0.0; depths.len()];
        self.added.add_to(size, &mut added);
        let own = self.added.size();
        let rows = depths
            .par_chunks_exact_mut(size.1.max(1))
            .zip(added.par_chunks_exact(size.1.max(1)));
        rows.enumerate().for_each(|(y, (depths, added))| {
            let row = (2 * y + 1) * own.0 / (2 * size.0) * own.1;
            for (x, (depth, added)) in depths.iter_mut().zip(added).enumerate() {
                let limits = self.limits[row + (2 * x + 1) * own.1 / (2 * size.1)];
                *depth = limited(*depth, *added, limits);
            }
        });
    }

    /// Returns the corrected depth at a position of the image, where it is `depth` without the correction.
    pub(crate) fn at(&self, place: [f64; 2], depth: f64) -> f64 {
        let size = self.added.size();
        let added = self
            .added
            .read(&InterpolationWeights::new(place, size, size));
        let limits = self.limits[pixel(place, size)];
        f64::from(limited(depth as f32, added as f32, limits))
    }
}

/// Returns the sum, which exceeds the limits only if `depth` does.
fn limited(depth: f32, added: f32, [low, high]: [f32; 2]) -> f32 {
    (depth + added).clamp(low.min(depth), high.max(depth))
}

/// Returns the pixel of an image of `size` (height, width) that contains a position.
fn pixel([u, v]: [f64; 2], (height, width): (usize, usize)) -> usize {
    let within = |place: f64, length: usize| ((place + 0.5).max(0.0) as usize).min(length - 1);
    within(v, height) * width + within(u, width)
}

/// The pixels around a pixel.
struct Neighbourhood {
    pixel: (usize, usize),
    width: usize,
    columns: std::ops::RangeInclusive<usize>,
    rows: std::ops::RangeInclusive<usize>,
}

impl Neighbourhood {
    fn new(pixel: usize, width: usize, height: usize) -> Self {
        let (x, y) = (pixel % width, pixel / width);
        Self {
            pixel: (x, y),
            width,
            columns: x.saturating_sub(REACH)..=(x + REACH).min(width - 1),
            rows: y.saturating_sub(REACH)..=(y + REACH).min(height - 1),
        }
    }

    /// Visits every pixel with its column and row, index and squared distance.
    fn each(&self, mut visit: impl FnMut([usize; 2], usize, usize)) {
        for y in self.rows.clone() {
            for x in self.columns.clone() {
                let square = x.abs_diff(self.pixel.0).pow(2) + y.abs_diff(self.pixel.1).pow(2);
                visit([x, y], y * self.width + x, square);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (20, 30);

    fn upsampling() -> Upsampling {
        let grey =
            |(height, width): (usize, usize)| (vec![90; 3 * height * width], (height, width));
        Upsampling::new(grey(SIZE), grey((10, 15))).unwrap()
    }

    /// Returns residuals that no smooth field can fit, at every `step`th pixel.
    fn observed(step: usize) -> (Vec<[f64; 2]>, Vec<f64>) {
        let pixels = (0..SIZE.0 * SIZE.1).step_by(step);
        let place = |i: usize| [(i % SIZE.1) as f64, (i / SIZE.1) as f64];
        pixels.map(|i| (place(i), (i as f64 * 2.3).sin())).unzip()
    }

    /// Returns the correction of a map of 5 m with these residuals at the observations.
    fn detail(places: &[[f64; 2]], residuals: &[f64], weights: &[f64]) -> Option<Detail> {
        let pixel_residuals = PixelResiduals::new(SIZE, places, residuals, weights)?;
        let depths: Vec<f32> = residuals.iter().map(|r| (5.0 + r) as f32).collect();
        Some(Detail::new(&upsampling(), pixel_residuals, places, &depths))
    }

    fn at(detail: &Detail, place: [f64; 2]) -> f64 {
        detail.at(place, 5.0) - 5.0
    }

    #[test]
    fn dense_observations_are_followed_by_their_weights() {
        for step in [1, 2] {
            let (places, residuals) = observed(step);
            let ones = vec![1.0; places.len()];
            let all = detail(&places, &residuals, &ones).unwrap();
            for (&place, residual) in places.iter().zip(&residuals) {
                assert!((at(&all, place) - residual).abs() < 1e-6);
            }
            assert!(
                detail(&places, &residuals, &vec![0.0; places.len()])
                    .is_none_or(|none| places.iter().all(|&place| at(&none, place) == 0.0))
            );
        }
    }

    #[test]
    fn a_pixel_between_equal_residuals_has_nearly_the_same() {
        let (places, _) = observed(2);
        let residuals = vec![0.4; places.len()];
        let all = detail(&places, &residuals, &vec![1.0; places.len()]).unwrap();
        for y in 3..17 {
            for x in 3..27 {
                let found = at(&all, [f64::from(x), f64::from(y)]);
                assert!((found - 0.4).abs() < 0.02, "{found}");
            }
        }
    }

    /// Shares of the errors, 68.27 %, are within the reduced deviation: for uniform errors up to 1, a deviation of 2 becomes
    /// 0.6827.
    #[test]
    fn deviations_are_those_of_the_errors_where_observations_are_followed() {
        // The left half of the image is observed.
        let pixels = (0..SIZE.0 * SIZE.1).filter(|i| i % SIZE.1 < 15);
        let places: Vec<_> = pixels
            .map(|i| [(i % SIZE.1) as f64, (i / SIZE.1) as f64])
            .collect();
        let (nothing, ones) = (vec![0.1; places.len()], vec![1.0; places.len()]);
        let pixel_residuals = PixelResiduals::new(SIZE, &places, &nothing, &ones).unwrap();
        let count = places.len() as f64;
        let errors = (0..places.len()).map(|i| (i * 7 % places.len()) as f64 / count);
        let errors: Vec<f64> = errors.collect();
        for size in [SIZE, (40, 60)] {
            let mut deviations = vec![2.0; size.0 * size.1];
            pixel_residuals.reduce(&upsampling(), (&places, &errors), size, &mut deviations);
            let at =
                |x: usize, y: usize| deviations[y * size.0 / SIZE.0 * size.1 + x * size.1 / SIZE.1];
            assert!((at(5, 8) - 0.6827).abs() < 0.01, "{}", at(5, 8));
            assert!((at(15, 8) - 0.6827).abs() < 0.05, "{}", at(15, 8));
            assert_eq!(at(25, 8), 2.0);
            // Errors larger than the deviations change nothing.
            let large: Vec<f64> = errors.iter().map(|error| 100.0 + error).collect();
            let before = deviations.clone();
            pixel_residuals.reduce(&upsampling(), (&places, &large), size, &mut deviations);
            assert_eq!(deviations, before);
        }
    }

    #[test]
    fn every_pixel_with_observations_nearby_is_corrected() {
        // Blocks of 3x3 pixels at a corner and within the image.
        let block = |x: usize, y: usize| (0..9).map(move |i| [x + i % 3, y + i / 3]);
        let places = block(0, 0).chain(block(12, 9)).chain(block(27, 17));
        let places: Vec<[f64; 2]> = places.map(|place| place.map(|v| v as f64)).collect();
        let residuals: Vec<f64> = (0..27).map(|i| (f64::from(i) * 2.3).sin()).collect();
        let found = detail(&places, &residuals, &[1.0; 27]).unwrap();
        let pixels = 0..SIZE.0 * SIZE.1;
        let all = pixels.map(|pixel| {
            let own = found.pixel_residuals.values[pixel];
            let all = &found.pixel_residuals;
            all.correction(&upsampling(), pixel, own, (0.0, None))
        });
        let all: Vec<f32> = all.collect();
        assert!(all.iter().filter(|value| **value != 0.0).count() > 27 + 3 * 5);
        assert_eq!(found.added, SmoothField::from_values(SIZE, all));
    }

    #[test]
    fn sparse_observations_are_left_to_the_fit() {
        let (places, residuals) = observed(7);
        assert!(detail(&places, &residuals, &vec![1.0; places.len()]).is_none());
        assert!(detail(&[], &[], &[]).is_none());
    }

    #[test]
    fn the_order_of_observations_changes_no_bit() {
        let (mut places, mut residuals) = observed(1);
        for i in 0..200 {
            // Up to four more observations per pixel.
            places.push([places[i % 50][0] + 0.1 * (i / 50) as f64, places[i % 50][1]]);
            residuals.push((i as f64 * 0.7).cos());
        }
        let ones = vec![1.0; places.len()];
        let one = detail(&places, &residuals, &ones).unwrap();
        places.reverse();
        residuals.reverse();
        let other = detail(&places, &residuals, &ones).unwrap();
        assert_eq!((one.added, one.limits), (other.added, other.limits));
    }
}
