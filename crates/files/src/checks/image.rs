//! Images that use a small part of their value range.

use super::Warning;
use image::{DynamicImage, Rgb, RgbImage};

/// Upper limit of 14-bit values: a sensor of 10, 12 or 14 bits, stored in 16.
const DEEP: u16 = 1 << 14;
/// Smallest range of values with sufficient contrast, wherever it lies.
const NARROW: u16 = u16::MAX / 16;
/// [`NARROW`] for 8 bits.
const LEVELS: u8 = 16;

/// Converts an image to 8-bit RGB, with a warning about it.
///
/// Images of 16 bits are divided by 257, as usual, if they use more than a quarter of the range. Otherwise they are
/// stretched: by the number of bits of the largest value, or, if all values are close together far from 0 as the counts of
/// a thermal camera are, from the 0.1th to the 99.9th percentile. Images of 8 bits keep their values.
pub fn to_rgb8(image: DynamicImage) -> (RgbImage, Option<Warning>) {
    let image: DynamicImage = match image {
        DynamicImage::ImageLumaA16(_) => image.into_luma16().into(),
        DynamicImage::ImageRgba16(_) => image.into_rgb16().into(),
        DynamicImage::ImageRgba32F(_) => image.into_rgb32f().into(),
        image => image,
    };
    let size = (image.width(), image.height());
    let (stretched, warning) = match &image {
        DynamicImage::ImageLuma16(grey) => stretched(grey, size),
        DynamicImage::ImageRgb16(rgb) => stretched(rgb, size),
        DynamicImage::ImageRgb32F(rgb) => (None, clamped(rgb)),
        _ => {
            let rgb = image.into_rgb8();
            let warning = dark(&rgb);
            return (rgb, warning);
        }
    };
    (stretched.unwrap_or_else(|| image.into_rgb8()), warning)
}

/// Returns the 0.1th and 99.9th percentiles of a histogram.
fn percentiles(counts: &[u32]) -> (usize, usize) {
    let all: u64 = counts.iter().map(|&count| u64::from(count)).sum();
    let few = all / 1000;
    let first = |counts: &mut dyn Iterator<Item = (usize, &u32)>| {
        let mut sum = 0;
        let mut counts = counts.map(|(value, &count)| {
            sum += u64::from(count);
            (value, sum)
        });
        counts
            .find(|(_, sum)| *sum > few)
            .map_or(0, |(value, _)| value)
    };
    let low = first(&mut counts.iter().enumerate());
    let high = first(&mut counts.iter().enumerate().rev());
    (low, high)
}

/// Stretches 16-bit values, grey or in colour, if they use a small part of their range.
fn stretched(values: &[u16], (width, height): (u32, u32)) -> (Option<RgbImage>, Option<Warning>) {
    let mut counts = vec![0_u32; 1 << 16];
    for &v in values {
        counts[usize::from(v)] += 1;
    }
    let (low, high) = percentiles(&counts);
    let (low, high) = (low as u16, high as u16);
    let narrow = high - low < NARROW;
    if (high >= DEEP && !narrow) || high == low {
        return (None, None);
    }
    // Counts that are close together far from 0 have no black level.
    let (low, high) = if narrow && low > high / 2 {
        (low, high)
    } else {
        (
            0,
            (u32::from(high) + 1)
                .next_power_of_two()
                .saturating_sub(1)
                .min(u32::from(u16::MAX)) as u16,
        )
    };
    let range = f32::from(high - low);
    let table: Vec<u8> = (0..=u16::MAX)
        .map(|v| {
            (f32::from(v.saturating_sub(low)) / range * 255.0)
                .round()
                .min(255.0) as u8
        })
        .collect();
    let pixels = width as usize * height as usize;
    let channels = values.len() / pixels;
    let rgb = RgbImage::from_fn(width, height, |x, y| {
        let first = (y as usize * width as usize + x as usize) * channels;
        let value = |channel: usize| table[usize::from(values[first + channel.min(channels - 1)])];
        Rgb([value(0), value(1), value(2)])
    });
    (Some(rgb), Some(Warning::Stretched { low, high }))
}

fn dark(image: &RgbImage) -> Option<Warning> {
    let mut counts = [0_u32; 256];
    image
        .as_raw()
        .iter()
        .for_each(|&v| counts[usize::from(v)] += 1);
    let (low, high) = percentiles(&counts);
    let levels = (high - low) as u8;
    (levels < LEVELS).then_some(Warning::Dark { levels })
}

fn clamped(image: &image::Rgb32FImage) -> Option<Warning> {
    /// Isolated highlights above white are usual.
    const MANY: f64 = 0.01;
    let values = image.as_raw();
    let outside = values.iter().filter(|v| !(0.0..=1.0).contains(*v)).count();
    let share = outside as f64 / values.len().max(1) as f64;
    let highest = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    if share > MANY {
        return Some(Warning::Clamped { highest, share });
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{ImageBuffer, Luma};

    fn grey(value: impl Fn(u32) -> u16) -> DynamicImage {
        ImageBuffer::<Luma<u16>, _>::from_fn(100, 40, |x, _| Luma([value(x)])).into()
    }

    #[test]
    fn ten_and_twelve_bits_become_all_of_the_range() {
        for bits in [10, 12, 14] {
            let most = (1_u32 << bits) - 1;
            let (rgb, warning) = to_rgb8(grey(|x| (x * most / 99) as u16));
            assert_eq!(
                warning,
                Some(Warning::Stretched {
                    low: 0,
                    high: most as u16
                })
            );
            assert_eq!(rgb.get_pixel(0, 0).0, [0; 3]);
            assert_eq!(rgb.get_pixel(99, 0).0, [255; 3]);
            let expected = (f64::from(50 * most / 99) / f64::from(most) * 255.0).round();
            assert_eq!(f64::from(rgb.get_pixel(50, 0).0[1]), expected);
        }
    }

    #[test]
    fn thermal_counts_far_from_zero_are_stretched_between_their_ends() {
        let (rgb, warning) = to_rgb8(grey(|x| 29_000 + 10 * x as u16));
        assert_eq!(
            warning,
            Some(Warning::Stretched {
                low: 29_000,
                high: 29_990
            })
        );
        assert_eq!(
            (rgb.get_pixel(0, 0).0[0], rgb.get_pixel(99, 0).0[0]),
            (0, 255)
        );
    }

    #[test]
    fn images_that_use_their_range_keep_their_bits() {
        let image = grey(|x| 650 * x as u16);
        assert_eq!(to_rgb8(image.clone()), (image.into_rgb8(), None));
        // A few saturated pixels do not hide a 10-bit range.
        let (_, warning) = to_rgb8(grey(|x| (x * 10) as u16));
        assert!(warning.is_some());
        let colour = RgbImage::from_fn(100, 10, |x, y| Rgb([x as u8, y as u8, 99]));
        assert_eq!(to_rgb8(colour.clone().into()), (colour, None));
    }

    #[test]
    fn a_dark_image_of_8_bits_is_doubted_and_kept() {
        let dark = RgbImage::from_fn(100, 10, |x, _| Rgb([(x / 10) as u8; 3]));
        assert_eq!(
            to_rgb8(dark.clone().into()),
            (dark, Some(Warning::Dark { levels: 9 }))
        );
    }

    #[test]
    fn floats_beyond_one_are_reported() {
        let image = image::Rgb32FImage::from_fn(10, 10, |x, _| Rgb([x as f32; 3]));
        let (_, warning) = to_rgb8(image.into());
        assert!(
            matches!(warning, Some(Warning::Clamped { highest: 9.0, .. })),
            "{warning:?}"
        );
    }
}
