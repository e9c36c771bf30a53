//! The distance of every pixel to the nearest point.

use lsdc_core::DepthMap;

/// Euclidean distances in pixels, row by row (Felzenszwalb and Huttenlocher 2012: one pass over
/// columns, one over rows); infinite without a point.
pub fn distances(sparse: &DepthMap) -> Vec<f32> {
    let (width, height) = (sparse.width(), sparse.height());
    let mut squares: Vec<f64> = sparse
        .values()
        .iter()
        .map(|&v| if v > 0.0 { 0.0 } else { f64::INFINITY })
        .collect();
    let mut line = vec![0.0; width.max(height)];
    for x in 0..width {
        for y in 0..height {
            line[y] = squares[y * width + x];
        }
        for (y, value) in lower_envelope(&line[..height]).into_iter().enumerate() {
            squares[y * width + x] = value;
        }
    }
    for row in squares.chunks_mut(width) {
        let values = lower_envelope(row);
        row.copy_from_slice(&values);
    }
    squares
        .into_iter()
        .map(|square| square.sqrt() as f32)
        .collect()
}

/// Returns the lower envelope of the parabolas (x - i)^2 + heights[i], at integer x.
fn lower_envelope(heights: &[f64]) -> Vec<f64> {
    // The parabolas of the envelope, and the start of each.
    let mut parts: Vec<(usize, f64)> = Vec::with_capacity(heights.len());
    for (i, &height) in heights.iter().enumerate().filter(|(_, h)| h.is_finite()) {
        let key = height + (i * i) as f64;
        let mut start = f64::NEG_INFINITY;
        while let Some(&(j, begin)) = parts.last() {
            let other = heights[j] + (j * j) as f64;
            start = (key - other) / (2.0 * (i - j) as f64);
            if start > begin {
                break;
            }
            parts.pop();
            start = f64::NEG_INFINITY;
        }
        parts.push((i, start));
    }
    let mut part = 0;
    (0..heights.len())
        .map(|x| {
            while part + 1 < parts.len() && parts[part + 1].1 <= x as f64 {
                part += 1;
            }
            parts.get(part).map_or(f64::INFINITY, |&(i, _)| {
                (x.abs_diff(i) as f64).powi(2) + heights[i]
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;

    #[test]
    fn distances_are_those_of_the_nearest_point() {
        let mut rng = Rng::stream(4, &["distance"]);
        let values: Vec<f32> = (0..50 * 30).map(|_| f32::from(rng.chance(0.01))).collect();
        let sparse = DepthMap::new(50, 30, values).unwrap();
        let found = distances(&sparse);
        for (i, distance) in found.iter().enumerate() {
            let apart =
                |p: lsdc_core::Point| p.x.abs_diff(i % 50).pow(2) + p.y.abs_diff(i / 50).pow(2);
            let expected = sparse.points().map(apart).min().unwrap() as f32;
            assert!((distance - expected.sqrt()).abs() < 1e-5);
        }
        assert!(
            distances(&DepthMap::empty(4, 3))
                .iter()
                .all(|d| d.is_infinite())
        );
    }
}
