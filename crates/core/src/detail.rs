//! What dense observations say beyond the grid that depth is solved on. Where an image is larger than this grid and
//! many of its pixels are observed, several of them share a pixel of the grid, and a map that is read from it can
//! follow only their mean. Here the map follows each, and their neighbours by likeness.

use crate::fit::Smooth;
use crate::upsampling::Upsampling;
use rayon::prelude::*;

/// Pixels on each side of the window.
const REACH: usize = 2;
/// The share of pixels in the window that are observed where observations are dense.
const DENSE: f64 = 0.25;
/// The standard deviation of the window, in pixels. Of 0.6 to 2 on depth maps of which a tenth or a half was held
/// back.
const SPREAD: f32 = 0.65;
/// What observations count against: a weight with a residual of 0.
const NOTHING: f32 = 0.01;

/// A residual at a pixel, and the weight of the observations there.
#[derive(Clone, Copy, Default)]
struct Rest {
    value: f32,
    weight: f32,
}

/// What is added to a map that is read with `upsampling`, from the residuals and weights (0 to 1) of observations at
/// `places`; `None` if they are nowhere dense. A pixel that is observed with weight 1 gets its mean residual.
pub(crate) fn detail(
    upsampling: &Upsampling,
    places: &[[f64; 2]],
    residuals: &[f64],
    weights: &[f64],
) -> Option<Smooth> {
    let (height, width) = upsampling.size();
    let pixel = |[u, v]: [f64; 2]| {
        let within = |place: f64, length: usize| (place.round().max(0.0) as usize).min(length - 1);
        within(v, height) * width + within(u, width)
    };
    let pixels: Vec<u32> = places
        .par_iter()
        .map(|&place| pixel(place) as u32)
        .collect();
    let mut observed = vec![false; height * width];
    for &pixel in &pixels {
        observed[pixel as usize] = true;
    }
    let dense = |pixel: u32| {
        let (mut count, mut all) = (0_u32, 0_u32);
        Window::new(pixel as usize, width, height).each(|other, _| {
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
    let mut rests = vec![Rest::default(); height * width];
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
            rests[same[0].0 as usize] = Rest {
                value: (sum / total) as f32,
                weight: (total as f32).min(1.0),
            };
        }
    }
    let values = (0..height * width)
        .into_par_iter()
        .map(|pixel| correction(upsampling, &rests, pixel));
    Some(Smooth::from_values((height, width), values.collect()))
}

/// The residual of a pixel by its weight, and that of its neighbours by the rest.
fn correction(upsampling: &Upsampling, rests: &[Rest], pixel: usize) -> f32 {
    let own = rests[pixel];
    if own.weight >= 1.0 {
        return own.value;
    }
    let (height, width) = upsampling.size();
    let (mut sum, mut total) = (0.0, NOTHING);
    Window::new(pixel, width, height).each(|other, square| {
        let rest = rests[other];
        if rest.weight > 0.0 && other != pixel {
            let near = (-0.5 * square / (SPREAD * SPREAD)).exp();
            let share = near * rest.weight * upsampling.likeness(pixel, other);
            sum += share * rest.value;
            total += share;
        }
    });
    own.weight * own.value + (1.0 - own.weight) * sum / total
}

/// The pixels around one.
struct Window {
    pixel: (usize, usize),
    width: usize,
    columns: std::ops::RangeInclusive<usize>,
    rows: std::ops::RangeInclusive<usize>,
}

impl Window {
    fn new(pixel: usize, width: usize, height: usize) -> Self {
        let (x, y) = (pixel % width, pixel / width);
        Self {
            pixel: (x, y),
            width,
            columns: x.saturating_sub(REACH)..=(x + REACH).min(width - 1),
            rows: y.saturating_sub(REACH)..=(y + REACH).min(height - 1),
        }
    }

    /// Every pixel, with the square of its distance.
    fn each(&self, mut visit: impl FnMut(usize, f32)) {
        for y in self.rows.clone() {
            for x in self.columns.clone() {
                let square = x.abs_diff(self.pixel.0).pow(2) + y.abs_diff(self.pixel.1).pow(2);
                visit(y * self.width + x, square as f32);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bilinear::Taps;

    const SIZE: (usize, usize) = (20, 30);

    fn upsampling() -> Upsampling {
        let grey =
            |(height, width): (usize, usize)| (vec![90; 3 * height * width], (height, width));
        Upsampling::new(grey(SIZE), grey((10, 15))).unwrap()
    }

    /// Residuals that no smooth field has, at every `step`th pixel.
    fn observed(step: usize) -> (Vec<[f64; 2]>, Vec<f64>) {
        let pixels = (0..SIZE.0 * SIZE.1).step_by(step);
        let place = |i: usize| [(i % SIZE.1) as f64, (i / SIZE.1) as f64];
        pixels.map(|i| (place(i), (i as f64 * 2.3).sin())).unzip()
    }

    fn at(detail: &Smooth, place: [f64; 2]) -> f64 {
        detail.read(&Taps::new(place, SIZE, SIZE))
    }

    #[test]
    fn dense_observations_are_followed_by_their_weights() {
        for step in [1, 2] {
            let (places, residuals) = observed(step);
            let ones = vec![1.0; places.len()];
            let all = detail(&upsampling(), &places, &residuals, &ones).unwrap();
            for (&place, residual) in places.iter().zip(&residuals) {
                assert!((at(&all, place) - residual).abs() < 1e-6);
            }
            assert!(
                detail(&upsampling(), &places, &residuals, &vec![0.0; places.len()])
                    .is_none_or(|none| places.iter().all(|&place| at(&none, place) == 0.0))
            );
        }
    }

    #[test]
    fn a_pixel_between_equal_residuals_has_nearly_the_same() {
        let (places, _) = observed(2);
        let residuals = vec![0.4; places.len()];
        let all = detail(&upsampling(), &places, &residuals, &vec![1.0; places.len()]).unwrap();
        for y in 3..17 {
            for x in 3..27 {
                let found = at(&all, [f64::from(x), f64::from(y)]);
                assert!((found - 0.4).abs() < 0.02, "{found}");
            }
        }
    }

    #[test]
    fn sparse_observations_are_left_to_the_fit() {
        let (places, residuals) = observed(7);
        assert!(detail(&upsampling(), &places, &residuals, &vec![1.0; places.len()]).is_none());
        assert!(detail(&upsampling(), &[], &[], &[]).is_none());
    }

    #[test]
    fn the_order_of_observations_changes_no_bit() {
        let (mut places, mut residuals) = observed(1);
        for i in 0..200 {
            // Up to four more in a pixel.
            places.push([places[i % 50][0] + 0.1 * (i / 50) as f64, places[i % 50][1]]);
            residuals.push((i as f64 * 0.7).cos());
        }
        let ones = vec![1.0; places.len()];
        let one = detail(&upsampling(), &places, &residuals, &ones).unwrap();
        places.reverse();
        residuals.reverse();
        assert_eq!(
            one,
            detail(&upsampling(), &places, &residuals, &ones).unwrap()
        );
    }
}
