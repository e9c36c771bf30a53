//! Image corners, as detected by feature trackers.

use image::RgbImage;

/// Returns the corner pixels, the strongest first: local maxima of the smaller eigenvalue of the structure tensor (Shi and
/// Tomasi 1994), Sobel gradients, summed over 3x3 pixels; borders are mirrored, as in OpenCV's `cornerMinEigenVal`.
pub(super) fn strongest(rgb: &RgbImage) -> Vec<(usize, usize)> {
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let response = smaller_eigenvalues(rgb);
    let at = |x: usize, y: usize| response[y * width + x];
    let mut corners: Vec<(usize, usize)> = (1..height.saturating_sub(1))
        .flat_map(|y| (1..width.saturating_sub(1)).map(move |x| (x, y)))
        .filter(|&(x, y)| {
            let here = at(x, y);
            let highest = (y - 1..=y + 1)
                .flat_map(|v| (x - 1..=x + 1).map(move |u| (u, v)))
                .all(|(u, v)| at(u, v) <= here);
            here > 0.0 && highest
        })
        .collect();
    corners.sort_by(|&a, &b| at(b.0, b.1).total_cmp(&at(a.0, a.1)));
    corners
}

fn smaller_eigenvalues(rgb: &RgbImage) -> Vec<f32> {
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let grey: Vec<f32> = rgb
        .pixels()
        .map(|p| 0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2]))
        .map(f32::round)
        .collect();
    // Row or column `i + offset - 1` with the border mirrored about the outermost pixel.
    let mirrored = |i: usize, offset: usize, length: usize| match (i + offset).checked_sub(1) {
        None => 1.min(length - 1),
        Some(j) if j >= length => length.saturating_sub(2),
        Some(j) => j,
    };
    let window = |values: &[f32], weights: [[f32; 3]; 3]| -> Vec<f32> {
        (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                let mut sum = 0.0;
                for (dy, row) in weights.iter().enumerate() {
                    let v = mirrored(y, dy, height);
                    for (dx, weight) in row.iter().enumerate() {
                        sum += weight * values[v * width + mirrored(x, dx, width)];
                    }
                }
                sum
            })
            .collect()
    };
    let gx = window(
        &grey,
        [[-1.0, 0.0, 1.0], [-2.0, 0.0, 2.0], [-1.0, 0.0, 1.0]],
    );
    let gy = window(
        &grey,
        [[-1.0, -2.0, -1.0], [0.0, 0.0, 0.0], [1.0, 2.0, 1.0]],
    );
    let box_sum = |a: &[f32], b: &[f32]| -> Vec<f32> {
        let products: Vec<f32> = a.iter().zip(b).map(|(a, b)| a * b).collect();
        window(&products, [[1.0; 3]; 3])
    };
    let (xx, xy, yy) = (box_sum(&gx, &gx), box_sum(&gx, &gy), box_sum(&gy, &gy));
    xx.iter()
        .zip(&xy)
        .zip(&yy)
        .map(|((a, b), c)| 0.5 * (a + c) - (0.25 * (a - c).powi(2) + b * b).sqrt())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn a_square_has_four_corners() {
        let square = RgbImage::from_fn(24, 20, |x, y| {
            let inside = (8..16).contains(&x) && (6..14).contains(&y);
            Rgb([if inside { 255 } else { 0 }; 3])
        });
        let found = strongest(&square);
        for (x, y) in [(8, 6), (15, 6), (8, 13), (15, 13)] {
            let near = |p: &&(usize, usize)| p.0.abs_diff(x) <= 1 && p.1.abs_diff(y) <= 1;
            assert!(found.iter().take(16).any(|p| near(&p)), "{x} {y}");
        }
        assert!(found.iter().all(|&(x, y)| {
            (x.abs_diff(8) < 3 || x.abs_diff(15) < 3) && (y.abs_diff(6) < 3 || y.abs_diff(13) < 3)
        }));
    }
}
