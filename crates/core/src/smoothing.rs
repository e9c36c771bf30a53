//! Smoothing of dense depths with known standard deviations, such as those of a depth camera with a noise model.
//!
//! The fit follows dense depths pixel by pixel. If their deviations are known, each depth is replaced by the value of a plane
//! through the surrounding depths that agree with it, weighted by precision: a bilateral filter (Tomasi and Manduchi 1998;
//! `KinectFusion` filters its input in the same way, Newcombe et al. 2011) of first order, which preserves slopes at the
//! borders of holes. Depths on the other side of an edge differ by many deviations and have no weight.

use rayon::prelude::*;

/// Pixels on each side of the window's centre.
const REACH: usize = 4;
/// The standard deviation of the window in pixels.
const SPREAD: f32 = 2.0;
/// Depths agree if they differ by no more than about this many standard deviations of their difference.
const AGREE: f32 = 3.0;
/// Least share of observed pixels in the window where depths count as dense.
const DENSE: f32 = 0.25;

/// Depths, and their standard deviations, after smoothing.
#[derive(Clone, Debug)]
pub(crate) struct Smoothed {
    pub(crate) depths: Vec<f32>,
    pub(crate) deviations: Vec<Option<f32>>,
    /// Number of smoothed depths.
    pub(crate) count: usize,
}

/// The mean of the observations in a pixel, and its precision.
#[derive(Clone, Copy, Default)]
struct Pixel {
    depth: f32,
    precision: f32,
}

/// Sums for a plane through depths around a pixel, weighted by w: of w, w x, w y, w x x, w x y, w y y; the same sums multiplied
/// by the depth; and the first six with w^2 times the variance instead of w.
#[derive(Default)]
struct Plane {
    weights: [f32; 6],
    depths: [f32; 3],
    variances: [f32; 6],
}

impl Plane {
    fn add(&mut self, [x, y]: [f32; 2], depth: f32, weight: f32, variance: f32) {
        let terms = [1.0, x, y, x * x, x * y, y * y];
        for (i, term) in terms.into_iter().enumerate() {
            self.weights[i] += weight * term;
            self.variances[i] += variance * term;
        }
        for (sum, term) in self.depths.iter_mut().zip(terms) {
            *sum += weight * depth * term;
        }
    }

    /// Returns the plane at the pixel, and its variance; `None` if the depths are collinear.
    fn at_centre(&self) -> Option<(f32, f32)> {
        /// Least determinant, relative to the product of the diagonal.
        const LEAST: f64 = 1e-3;
        let [s, sx, sy, sxx, sxy, syy] = self.weights.map(f64::from);
        // The first row of the inverse of the normal matrix.
        let cofactors = [
            sxx * syy - sxy * sxy,
            sy * sxy - sx * syy,
            sx * sxy - sy * sxx,
        ];
        let determinant = s * cofactors[0] + sx * cofactors[1] + sy * cofactors[2];
        if determinant.is_nan() || determinant <= LEAST * s * sxx * syy {
            return None;
        }
        let [a, b, c] = cofactors.map(|cofactor| cofactor / determinant);
        let [d, dx, dy] = self.depths.map(f64::from);
        let [v, vx, vy, vxx, vxy, vyy] = self.variances.map(f64::from);
        let variance =
            a * a * v + 2.0 * a * (b * vx + c * vy) + b * b * vxx + 2.0 * b * c * vxy + c * c * vyy;
        Some(((a * d + b * dx + c * dy) as f32, variance as f32))
    }
}

impl Smoothed {
    /// Smooths depths at `places` of an image of `size` (height, width); `None` if none has both a standard deviation
    /// and dense surroundings.
    pub(crate) fn new(
        places: &[[f64; 2]],
        depths: &[f32],
        deviations: &[Option<f32>],
        (height, width): (usize, usize),
    ) -> Option<Self> {
        // In units of the mean depth, so that no square overflows.
        let unit = depths.iter().map(|&d| f64::from(d)).sum::<f64>() / depths.len() as f64;
        let unit = unit as f32;
        let within = |place: f64, length: usize| (place.round().max(0.0) as usize).min(length - 1);
        let pixel = |[u, v]: [f64; 2]| (within(u, width), within(v, height));
        let mut pixels = vec![Pixel::default(); height * width];
        for ((&place, depth), deviation) in places.iter().zip(depths).zip(deviations) {
            let Some(deviation) = deviation else { continue };
            let (x, y) = pixel(place);
            let (mean, precision) = (&mut pixels[y * width + x], (deviation / unit).powi(-2));
            if precision.is_finite() {
                let total = mean.precision + precision;
                mean.depth += (depth / unit - mean.depth) * (precision / total);
                mean.precision = total;
            }
        }
        let smooth = |((&place, &depth), &deviation): ((&[f64; 2], &f32), &Option<f32>)| {
            let deviation = deviation?;
            let (depth, variance) = (depth / unit, (deviation / unit).powi(2));
            let (x, y) = pixel(place);
            let mut plane = Plane::default();
            let (mut observed, mut all) = (0.0, 0.0);
            for v in y.saturating_sub(REACH)..(y + REACH + 1).min(height) {
                for u in x.saturating_sub(REACH)..(x + REACH + 1).min(width) {
                    all += 1.0;
                    let other = pixels[v * width + u];
                    if other.precision == 0.0 {
                        continue;
                    }
                    observed += 1.0;
                    let [right, down] = [u as f32 - x as f32, v as f32 - y as f32];
                    let step = other.depth - depth;
                    let square = (right * right + down * down) / (SPREAD * SPREAD)
                        + step * step / (AGREE * AGREE * (variance + other.precision.recip()));
                    let share = (-0.5 * square).exp();
                    plane.add(
                        [right, down],
                        step,
                        share * other.precision,
                        share * share * other.precision,
                    );
                }
            }
            let (step, variance) = plane.at_centre().filter(|_| observed >= DENSE * all)?;
            Some(((depth + step) * unit, variance.sqrt() * unit))
        };
        let all = places.par_iter().zip(depths).zip(deviations);
        let found: Vec<Option<(f32, f32)>> = all.map(smooth).collect();
        let count = found.iter().flatten().count();
        (count > 0).then(|| Self {
            depths: found
                .iter()
                .zip(depths)
                .map(|(found, &depth)| found.map_or(depth, |(depth, _)| depth))
                .collect(),
            deviations: found
                .iter()
                .zip(deviations)
                .map(|(found, &deviation)| found.map(|(_, own)| own).or(deviation))
                .collect(),
            count,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;

    const SIZE: (usize, usize) = (60, 80);

    /// Returns every pixel of a plane with a step of half a metre in the middle, with noise of 1 cm, and the true depths.
    fn noisy() -> (Vec<[f64; 2]>, Vec<f32>, Vec<f32>) {
        let mut rng = Rng::stream(0, &["noise"]);
        let places: Vec<[f64; 2]> = (0..SIZE.0 * SIZE.1)
            .map(|i| [(i % SIZE.1) as f64, (i / SIZE.1) as f64])
            .collect();
        let truth = |[u, v]: &[f64; 2]| {
            let step = if *u < 40.0 { 0.0 } else { 0.5 };
            (1.5 + 0.002 * u + 0.004 * v + step) as f32
        };
        let truth: Vec<f32> = places.iter().map(truth).collect();
        let noisy = truth.iter().map(|d| d + 0.01 * rng.normal()).collect();
        (places, noisy, truth)
    }

    fn rms(one: &[f32], other: &[f32]) -> f32 {
        let squares: f32 = one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum();
        (squares / one.len() as f32).sqrt()
    }

    #[test]
    fn noise_falls_to_what_is_said_of_it_and_edges_stay() {
        let (places, depths, truth) = noisy();
        let known = vec![Some(0.01); depths.len()];
        let found = Smoothed::new(&places, &depths, &known, SIZE).unwrap();
        assert_eq!(found.count, depths.len());
        let error = rms(&found.depths, &truth);
        let said: Vec<f32> = found.deviations.iter().map(|d| d.unwrap()).collect();
        let said = rms(&said, &vec![0.0; said.len()]);
        assert!(error < 0.003, "{error}");
        assert!((error / said - 1.0).abs() < 0.25, "{error} {said}");
        // Also for the pixels next to the step.
        let beside = |values: &[f32]| -> Vec<f32> {
            let pixels = (0..SIZE.0).flat_map(|y| [39, 40].map(|x| y * SIZE.1 + x));
            pixels.map(|i| values[i]).collect()
        };
        assert!(rms(&beside(&found.depths), &beside(&truth)) < 0.005);
    }

    #[test]
    fn a_scene_of_another_size_is_smoothed_alike() {
        let (places, depths, _) = noisy();
        let scaled = |factor: f32| {
            let depths: Vec<f32> = depths.iter().map(|d| factor * d).collect();
            let known = vec![Some(factor * 0.01); depths.len()];
            Smoothed::new(&places, &depths, &known, SIZE)
                .unwrap()
                .depths
        };
        let one = scaled(1.0);
        let pairs = scaled(4.0).into_iter().zip(&one);
        assert!(pairs.into_iter().all(|(four, one)| four == 4.0 * one));
        let pairs = scaled(1e12).into_iter().zip(&one);
        assert!(
            pairs
                .into_iter()
                .all(|(many, one)| (many / 1e12 / one - 1.0).abs() < 1e-5)
        );
    }

    #[test]
    fn sparse_depths_and_those_of_unknown_deviation_stay() {
        let (places, depths, _) = noisy();
        assert!(Smoothed::new(&places, &depths, &vec![None; depths.len()], SIZE).is_none());
        let some = |values: usize| places.iter().step_by(values).copied().collect::<Vec<_>>();
        let sparse: Vec<f32> = depths.iter().step_by(7).copied().collect();
        let known = vec![Some(0.01); sparse.len()];
        assert!(Smoothed::new(&some(7), &sparse, &known, SIZE).is_none());
        let mut known = vec![Some(0.01); depths.len()];
        known[100] = None;
        let found = Smoothed::new(&places, &depths, &known, SIZE).unwrap();
        assert_eq!(
            (found.depths[100], found.deviations[100]),
            (depths[100], None)
        );
        assert_eq!(found.count, depths.len() - 1);
    }
}
