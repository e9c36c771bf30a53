//! Demosaicing of Bayer images.

use image::RgbImage;

/// Colours of a mosaic: RGB channel indices of its first two rows and columns.
pub(super) type BayerPattern = [[usize; 2]; 2];

/// Returns the pattern of an encoding.
pub(super) fn pattern(encoding: &str) -> Option<BayerPattern> {
    Some(match encoding {
        "bayer_rggb8" => [[0, 1], [1, 2]],
        "bayer_bggr8" => [[2, 1], [1, 0]],
        "bayer_gbrg8" => [[1, 2], [0, 1]],
        "bayer_grbg8" => [[1, 0], [2, 1]],
        _ => return None,
    })
}

/// Demosaics bilinearly: each missing colour is the mean of its nearest neighbours inside the image.
pub(super) fn colours(
    mosaic: &[u8],
    (width, height): (usize, usize),
    pattern: BayerPattern,
) -> RgbImage {
    let channel = |x: usize, y: usize| pattern[y % 2][x % 2];
    RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let (x, y) = (x as usize, y as usize);
        let mut sums = [[0_u32; 2]; 3];
        let columns = x.saturating_sub(1)..=(x + 1).min(width - 1);
        for row in y.saturating_sub(1)..=(y + 1).min(height - 1) {
            for column in columns.clone() {
                let [sum, count] = &mut sums[channel(column, row)];
                // Green neighbours are orthogonal, as are the red and blue ones of a green pixel.
                let corner = column != x && row != y;
                let straight = channel(column, row) == 1 || channel(x, y) == 1;
                if !(corner && straight) {
                    *sum += u32::from(mosaic[row * width + column]);
                    *count += 1;
                }
            }
        }
        let own = channel(x, y);
        let mut color = sums.map(|[sum, count]| ((sum + count / 2) / count.max(1)) as u8);
        color[own] = mosaic[y * width + x];
        image::Rgb(color)
    })
}
