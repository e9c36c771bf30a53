//! Pixel grids of the same view. Positions count from the centre of the first pixel, as in OpenCV: a grid covers
//! `-0.5..length - 0.5`.

pub(super) use lsdc_core::cloud::pixel;

/// Largest number of pixels of an image: 1 GiB of depths.
const MOST: usize = 1 << 28;

/// Converts a position on `from` pixels to one on `to` pixels of the same view.
pub(super) fn rescaled(position: f64, from: usize, to: usize) -> f64 {
    (position + 0.5) * (to as f64 / from.max(1) as f64) - 0.5
}

/// Whether two sizes (width, height) have the same shape, up to rounding to whole pixels.
pub(super) fn same_shape(a: (usize, usize), b: (usize, usize)) -> bool {
    /// Tolerance for the rounding of the division.
    const ROUNDING: f64 = 1e-9;
    let factors = [b.0 as f64 / a.0 as f64, b.1 as f64 / a.1 as f64];
    let least = a.0.min(a.1).min(b.0).min(b.1) as f64;
    (factors[0] / factors[1] - 1.0).abs() * least <= 1.0 + ROUNDING
}

/// Whether an image of this size can be processed.
pub(super) fn is_plausible((width, height): (usize, usize)) -> bool {
    width.checked_mul(height).is_some_and(|area| area <= MOST)
}

/// Returns the pixels whose centres are nearest to a position on the grid: several if it is equally far from them, as the
/// centre of a larger pixel is, so that none is preferred.
pub(super) fn nearest_pixels(
    [u, v]: [f64; 2],
    (width, height): (usize, usize),
) -> impl Iterator<Item = usize> {
    let nearest = |position: f64, length: usize| {
        let last = length.saturating_sub(1) as f64;
        let low = (position - 0.5).ceil().clamp(0.0, last) as usize;
        let high = (position + 0.5).floor().clamp(0.0, last) as usize;
        low.min(high)..=high
    };
    let columns = nearest(u, width);
    nearest(v, height).flat_map(move |y| columns.clone().map(move |x| y * width + x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shapes_may_differ_by_one_pixel() {
        for (a, b, same) in [
            ((640, 480), (4032, 3024), true),
            ((640, 480), (640, 479), true),
            ((640, 479), (640, 480), true),
            ((640, 480), (640, 477), false),
            ((640, 480), (480, 640), false),
            ((1000, 751), (640, 480), true),
        ] {
            assert_eq!(same_shape(a, b), same, "{a:?} {b:?}");
        }
    }

    #[test]
    fn a_place_between_pixels_belongs_to_all_of_them() {
        let found = |position| nearest_pixels(position, (4, 3)).collect::<Vec<_>>();
        assert_eq!(found([1.2, 0.6]), [5]);
        assert_eq!(found([1.5, 0.0]), [1, 2]);
        assert_eq!(found([1.5, 0.5]), [1, 2, 5, 6]);
        assert_eq!(found([-0.5, -0.5]), [0]);
        assert_eq!(found([3.49, 2.49]), [11]);
    }
}
