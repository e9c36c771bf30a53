//! Colours from luma and two colour differences: YUV, which cameras and video decoders deliver.

use super::raw::Raw;
use crate::cdr::damaged;
use image::RgbImage;
use lsdc_files::error::Result;

/// Byte layout of an image.
#[derive(Clone, Copy, Debug)]
pub(super) enum Layout {
    /// Two pixels in four bytes: offsets of both luma values, and of U and V.
    Packed { y: [usize; 2], uv: [usize; 2] },
    /// A luma plane, followed by pairs of U and V for square blocks of pixels of this side length; offsets of U and V in a
    /// pair.
    Planes { block: usize, uv: [usize; 2] },
}

/// Returns the layout of an encoding.
pub(super) fn layout(encoding: &str) -> Option<Layout> {
    let packed = |y, uv| Layout::Packed { y, uv };
    let planes = |block, uv| Layout::Planes { block, uv };
    Some(match encoding {
        "yuv422" | "uyvy" => packed([1, 3], [0, 2]),
        "yuv422_yuy2" | "yuyv" => packed([0, 2], [1, 3]),
        "nv12" => planes(2, [0, 1]),
        "nv21" => planes(2, [1, 0]),
        "nv24" => planes(1, [0, 1]),
        _ => return None,
    })
}

/// Decodes the colours of an image; pixels share the U and V of their pair or block.
///
/// # Errors
/// There are fewer bytes than the pixels need.
pub(super) fn colours(raw: &Raw<'_>, layout: Layout) -> Result<RgbImage> {
    let (width, height) = raw.size;
    let mut values = Vec::new();
    match layout {
        Layout::Packed { y, uv: [u, v] } => {
            // A pair at the end of a row is complete, though its second pixel may be outside the image.
            let rows = raw.rows_of(width.div_ceil(2), 4)?;
            for row in rows {
                let (pairs, _) = row.as_chunks::<4>();
                let pixels = pairs.iter().flat_map(|pair| y.map(|y| (pair[y], pair)));
                let colours = pixels.map(|(y, pair)| rgb(y, pair[u], pair[v]));
                values.extend(colours.take(width).flatten());
            }
        }
        Layout::Planes { block, uv: [u, v] } => {
            let [brightness, pairs] = planes(raw, block)?;
            for row in 0..height {
                let y = brightness.row(row);
                let (uv, _) = pairs.row(row / block).as_chunks::<2>();
                let uv = uv.iter().flat_map(|pair| std::iter::repeat_n(pair, block));
                let colours = y.iter().zip(uv).map(|(&y, pair)| rgb(y, pair[u], pair[v]));
                values.extend(colours.flatten());
            }
        }
    }
    let image = RgbImage::from_raw(width as u32, height as u32, values);
    image.ok_or_else(|| damaged("is of another size than it says"))
}

/// Rows of bytes.
struct Plane<'a> {
    data: &'a [u8],
    /// Bytes from one row to the next and, below, those in use.
    step: usize,
    long: usize,
}

impl<'a> Plane<'a> {
    fn row(&self, row: usize) -> &'a [u8] {
        let start = row * self.step;
        self.data.get(start..start + self.long).unwrap_or_default()
    }
}

/// Returns the two planes of an image: luma, and pairs of U and V for blocks of pixels. The step of a row of pairs is
/// 2 / `block` times that of a luma row. If the data is too short for the given step but has the exact size without padding,
/// the step is ignored: programs disagree on its meaning for planes.
fn planes<'a>(raw: &Raw<'a>, block: usize) -> Result<[Plane<'a>; 2]> {
    let ((width, height), data) = (raw.size, raw.data);
    let found = |step: usize, pairs_step: usize| {
        let long = 2 * width.div_ceil(block);
        let first = step.checked_mul(height)?;
        let rows = height.div_ceil(block).checked_sub(1)?;
        let last = pairs_step.checked_mul(rows)?.checked_add(long)?;
        let all = first.checked_add(last)?;
        let fits = width > 0 && step >= width && pairs_step >= long && all <= data.len();
        let (brightness, pairs) = data.split_at_checked(first).filter(|_| fits)?;
        let plane = |data, step, long| Plane { data, step, long };
        Some([
            plane(brightness, step, width),
            plane(pairs, pairs_step, long),
        ])
    };
    let narrow = width.div_ceil(block).checked_mul(2);
    let pairs_step = raw.step.checked_mul(2).map(|step| step / block);
    let stepped = pairs_step.and_then(|pairs_step| found(raw.step, pairs_step));
    let tight = || {
        let rows = height.div_ceil(block);
        let all = width
            .checked_mul(height)?
            .checked_add(narrow?.checked_mul(rows)?)?;
        found(width, narrow?).filter(|_| all == data.len())
    };
    stepped.or_else(tight).ok_or_else(|| raw.too_short())
}

/// Converts ITU-R BT.601 with luma from 16 to 235, in 20-bit fixed point as in OpenCV.
fn rgb(y: u8, u: u8, v: u8) -> [u8; 3] {
    const BITS: u32 = 20;
    let y = (i32::from(y) - 16).max(0) * 1_220_542 + (1 << (BITS - 1));
    let [u, v] = [u, v].map(|value| i32::from(value) - 128);
    let red = y + 1_673_527 * v;
    let green = y - 852_492 * v - 409_993 * u;
    let blue = y + 2_116_026 * u;
    [red, green, blue].map(|value| (value >> BITS).clamp(0, 255) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(encoding: &str, size: (usize, usize), step: usize, data: &[u8]) -> Result<Vec<u8>> {
        let raw = Raw {
            size,
            encoding: encoding.to_owned(),
            big_endian: false,
            step,
            data,
        };
        colours(&raw, layout(encoding).unwrap()).map(RgbImage::into_raw)
    }

    #[test]
    fn black_white_and_grey() {
        assert_eq!(rgb(16, 128, 128), [0; 3]);
        assert_eq!(rgb(235, 128, 128), [255; 3]);
        assert_eq!(rgb(0, 128, 128), [0; 3]);
        assert_eq!(rgb(255, 128, 128), [255; 3]);
        // 1.164 (126 - 16).
        assert_eq!(rgb(126, 128, 128), [128; 3]);
    }

    /// Luma rows with padding, an odd width and height; the same without padding, whatever the step.
    #[test]
    fn planes_may_have_gaps() {
        let [a, b] = [rgb(100, 50, 200), rgb(200, 90, 30)];
        let gaps = [
            100, 100, 200, 9, //
            100, 100, 200, 9, //
            100, 100, 200, 9, //
            200, 50, 30, 90, //
            200, 50, 30, 90,
        ];
        let expected: Vec<u8> = [a, a, b].concat().repeat(3);
        assert_eq!(read("nv21", (3, 3), 4, &gaps).unwrap(), expected);
        let tight: Vec<u8> =
            [&[100, 100, 200].repeat(3)[..], &[200, 50, 30, 90].repeat(2)].concat();
        for step in [3, 6] {
            assert_eq!(read("nv21", (3, 3), step, &tight).unwrap(), expected);
        }
        assert!(read("nv21", (3, 3), 4, &gaps[..19]).is_err());
        assert!(read("nv21", (3, 3), 2, &tight[..16]).is_err());
        let full = [100, 200, 9, 50, 200, 90, 30, 9];
        assert_eq!(read("nv24", (2, 1), 3, &full).unwrap(), [a, b].concat());
        assert!(read("nv24", (2, 1), 3, &full[..5]).is_err());
    }

    #[test]
    fn what_is_too_short_is_refused() {
        let all = usize::MAX;
        for encoding in ["uyvy", "yuyv", "nv12", "nv21", "nv24"] {
            for (size, step) in [
                ((4, 4), 8),
                ((all, all), all),
                ((0, 4), 8),
                ((4, 0), 8),
                ((4, 4), all),
            ] {
                assert!(read(encoding, size, step, &[0; 8]).is_err(), "{encoding}");
            }
        }
        assert!(read("uyvy", (3, 1), 8, &[0; 8]).is_ok());
        assert!(read("uyvy", (3, 1), 6, &[0; 6]).is_err());
    }
}
