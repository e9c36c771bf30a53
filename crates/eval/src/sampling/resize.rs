//! Resizing identical to that of other libraries.

use super::Size;
use crate::data::DepthMap;
use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::{F32, U8x3};
use fast_image_resize::{FilterType, PixelTrait, ResizeAlg, ResizeOptions, Resizer};
use image::RgbImage;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// A resampling method, named by the library that implements it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Interpolation {
    /// PIL's `BILINEAR`, which averages over all pixels when it shrinks (antialiased), as torchvision's `Resize` does for
    /// images. Mixes depths at edges.
    #[default]
    #[serde(alias = "bilinear")]
    PilBilinear,
    /// PIL's `NEAREST`: the source pixel under the centre. Keeps measured values.
    PilNearest,
    /// OpenCV's `INTER_LINEAR`, which interpolates between four pixels only.
    CvBilinear,
    /// OpenCV's `INTER_NEAREST`: the source pixel at floor(i x scale). Keeps measured values.
    #[serde(alias = "nearest")]
    CvNearest,
    /// PIL's `NEAREST`, except that if the pixel under the centre has no measurement, the measured pixel nearest to the centre
    /// is used, among those covered by the result: isolated returns are not lost. Keeps measured values.
    NearestMeasured,
}

impl Interpolation {
    /// All methods.
    pub const ALL: [Self; 5] = [
        Self::PilBilinear,
        Self::PilNearest,
        Self::CvBilinear,
        Self::CvNearest,
        Self::NearestMeasured,
    ];

    /// Returns the name in configs and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::PilBilinear => "pil-bilinear",
            Self::PilNearest => "pil-nearest",
            Self::CvBilinear => "cv-bilinear",
            Self::CvNearest => "cv-nearest",
            Self::NearestMeasured => "nearest-measured",
        }
    }

    fn algorithm(self) -> Algorithm {
        match self {
            Self::PilBilinear => Algorithm::Filter(ResizeAlg::Convolution(FilterType::Bilinear)),
            Self::CvBilinear => Algorithm::Filter(ResizeAlg::Interpolation(FilterType::Bilinear)),
            Self::PilNearest => Algorithm::Nearest(pil_sources),
            Self::CvNearest => Algorithm::Nearest(cv_sources),
            Self::NearestMeasured => Algorithm::NearestMeasured,
        }
    }
}

/// The kind of a method: weighted means, or selection of a pixel.
enum Algorithm {
    Filter(ResizeAlg),
    /// Maps the lengths of source and result to the source index of every result pixel.
    Nearest(fn(usize, usize) -> Vec<usize>),
    NearestMeasured,
}

/// Returns the source indices of PIL: repeated addition from half a source pixel on, rounded down.
fn pil_sources(from: usize, to: usize) -> Vec<usize> {
    let step = from as f64 / to as f64;
    std::iter::successors(Some(step * 0.5), |x| Some(x + step))
        .take(to)
        .map(|x| (x as usize).min(from - 1))
        .collect()
}

fn cv_sources(from: usize, to: usize) -> Vec<usize> {
    let step = from as f64 / to as f64;
    (0..to)
        .map(|i| ((i as f64 * step) as usize).min(from - 1))
        .collect()
}

/// Returns the candidate source pixels of each result pixel, ascending, with their squared distances from its centre in source
/// pixels: the one under its centre, and those with centres inside it.
fn covered_sources(from: usize, to: usize) -> Vec<Vec<(usize, f64)>> {
    let of = |i: usize| -> Vec<(usize, f64)> {
        // Positions are multiples of 1 / (2 to) source pixels.
        let (left, centre, right) = (2 * i * from, (2 * i + 1) * from, 2 * (i + 1) * from);
        let under = (centre / (2 * to)).min(from - 1);
        let sources = i * from / to..((i + 1) * from).div_ceil(to).min(from);
        let taken = sources.filter(|&j| j == under || (left..right).contains(&((2 * j + 1) * to)));
        let distance = |j: usize| ((2 * j + 1) * to).abs_diff(centre) as f64 / (2 * to) as f64;
        taken.map(|j| (j, distance(j).powi(2))).collect()
    };
    (0..to).map(of).collect()
}

fn nearest_measured(depth: &DepthMap, from: Size, to: Size) -> Vec<f32> {
    let columns = covered_sources(from.width, to.width);
    let rows = covered_sources(from.height, to.height);
    let value = |rows: &[(usize, f64)], columns: &[(usize, f64)]| {
        let (mut least, mut found) = (f64::INFINITY, 0.0);
        for &(y, down) in rows {
            for &(x, across) in columns {
                let here = depth.at(x, y);
                // On a tie, the later pixel is used, as in PIL.
                if here > 0.0 && down + across <= least {
                    (least, found) = (down + across, here);
                }
            }
        }
        found
    };
    let pixels = rows
        .iter()
        .flat_map(|row| columns.iter().map(|column| value(row, column)));
    pixels.collect()
}

/// Resizes colours.
///
/// # Errors
/// A size of 0.
pub fn resize_rgb(rgb: &RgbImage, size: Size, interpolation: Interpolation) -> Result<RgbImage> {
    let from = Size {
        height: rgb.height() as usize,
        width: rgb.width() as usize,
    };
    if from == size {
        return Ok(rgb.clone());
    }
    check_sizes(from, size)?;
    match interpolation.algorithm() {
        Algorithm::Filter(algorithm) => {
            let colours = rgb.as_raw().as_chunks().0.iter();
            let colours: Vec<U8x3> = colours.map(|&colour| U8x3::new(colour)).collect();
            let colours = convolve(&colours, from, size, algorithm)?;
            let bytes = colours.into_iter().flat_map(|colour| colour.0).collect();
            RgbImage::from_raw(size.width as u32, size.height as u32, bytes)
                .ok_or_else(|| Error::shape("resized image has the wrong size"))
        }
        // All colours are measured.
        Algorithm::NearestMeasured => resize_rgb(rgb, size, Interpolation::PilNearest),
        Algorithm::Nearest(sources) => {
            let columns = sources(from.width, size.width);
            let rows = sources(from.height, size.height);
            Ok(RgbImage::from_fn(
                size.width as u32,
                size.height as u32,
                |x, y| *rgb.get_pixel(columns[x as usize] as u32, rows[y as usize] as u32),
            ))
        }
    }
}

/// Resizes depths. If a pixel with a nonzero weight has no measurement, the result has none, so that depths are not mixed with
/// holes.
///
/// # Errors
/// A size of 0.
pub fn resize_depth(
    depth: &DepthMap,
    size: Size,
    interpolation: Interpolation,
) -> Result<DepthMap> {
    let from = Size::of(depth);
    if from == size {
        return Ok(depth.clone());
    }
    check_sizes(from, size)?;
    let values = match interpolation.algorithm() {
        Algorithm::Filter(algorithm) => filter_depth(depth, from, size, algorithm)?,
        Algorithm::Nearest(sources) => {
            let columns = sources(from.width, size.width);
            let rows = sources(from.height, size.height);
            rows.iter()
                .flat_map(|&y| columns.iter().map(move |&x| depth.at(x, y)))
                .collect()
        }
        Algorithm::NearestMeasured => nearest_measured(depth, from, size),
    };
    Ok(DepthMap::new(size.width, size.height, values)?)
}

fn filter_depth(depth: &DepthMap, from: Size, to: Size, algorithm: ResizeAlg) -> Result<Vec<f32>> {
    let filter = |values: &[f32]| -> Result<Vec<f32>> {
        let values: Vec<F32> = values.iter().map(|&value| F32::new(value)).collect();
        let resized = convolve(&values, from, to, algorithm)?;
        Ok(resized.into_iter().map(|value| value.0).collect())
    };
    let mut values = filter(depth.values())?;
    if depth.count() < depth.values().len() {
        let holes: Vec<f32> = depth
            .values()
            .iter()
            .map(|&v| f32::from(v == 0.0))
            .collect();
        for (value, hole) in values.iter_mut().zip(filter(&holes)?) {
            if hole > 1e-6 {
                *value = 0.0;
            }
        }
    }
    Ok(values)
}

/// Moves sparse depths to another size: each point to the pixel that contains its centre. Of several, the nearest point is
/// kept.
///
/// # Errors
/// A size of 0.
pub fn move_points(sparse: &DepthMap, size: Size) -> Result<DepthMap> {
    let sources = sources_of_points(sparse, size)?;
    let values = sources.into_iter();
    let values = values.map(|source| source.map_or(0.0, |pixel| sparse.values()[pixel]));
    Ok(DepthMap::new(size.width, size.height, values.collect())?)
}

/// Returns the source pixel of the point in each pixel of another size, as moved by [`move_points`], row by row.
///
/// # Errors
/// A size of 0.
pub(super) fn sources_of_points(sparse: &DepthMap, size: Size) -> Result<Vec<Option<usize>>> {
    let from = Size::of(sparse);
    check_sizes(from, size)?;
    let moved = |i: usize, from: usize, to: usize| (2 * i + 1) * to / (2 * from);
    let mut sources: Vec<Option<usize>> = vec![None; size.width * size.height];
    for point in sparse.points() {
        let x = moved(point.x, from.width, size.width);
        let y = moved(point.y, from.height, size.height);
        let source = &mut sources[y * size.width + x];
        if source.is_none_or(|pixel| point.depth < sparse.values()[pixel]) {
            *source = Some(point.y * from.width + point.x);
        }
    }
    Ok(sources)
}

fn check_sizes(from: Size, to: Size) -> Result<()> {
    if [from.width, from.height, to.width, to.height].contains(&0) {
        return Err(Error::shape(format!("cannot resize {from} to {to}")));
    }
    Ok(())
}

fn convolve<P: PixelTrait>(
    pixels: &[P],
    from: Size,
    to: Size,
    algorithm: ResizeAlg,
) -> Result<Vec<P>> {
    let resize_error =
        |e: &dyn std::fmt::Display| Error::shape(format!("cannot resize {from} to {to}: {e}"));
    let source = TypedImageRef::new(from.width as u32, from.height as u32, pixels)
        .map_err(|e| resize_error(&e))?;
    let mut resized = vec![P::default(); to.width * to.height];
    let (width, height) = (to.width as u32, to.height as u32);
    let mut target =
        TypedImage::from_pixels_slice(width, height, &mut resized).map_err(|e| resize_error(&e))?;
    let options = ResizeOptions::new().resize_alg(algorithm);
    // Not `resize`, which is compiled for every pixel type.
    Resizer::new()
        .resize_typed(&source, &mut target, &options)
        .map_err(|e| resize_error(&e))?;
    Ok(resized)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn size(height: usize, width: usize) -> Size {
        Size { height, width }
    }

    #[test]
    fn halving_is_the_triangle_filter() {
        // PIL halves with the weights 1, 3, 3, 1 over 8 (a triangle of half-width 2 output-scaled).
        let depth = DepthMap::new(8, 1, vec![1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0]).unwrap();
        let half = resize_depth(&depth, size(1, 4), Interpolation::PilBilinear).unwrap();
        let expected = (2.0 + 3.0 * 4.0 + 3.0 * 8.0 + 16.0) / 8.0;
        assert!((half.at(1, 0) - expected).abs() < 1e-5, "{}", half.at(1, 0));
    }

    #[test]
    fn bilinear_never_mixes_a_hole() {
        let mut values = vec![2.0; 64];
        values[27] = 0.0;
        let depth = DepthMap::new(8, 8, values).unwrap();
        for interpolation in [Interpolation::PilBilinear, Interpolation::CvBilinear] {
            let half = resize_depth(&depth, size(4, 4), interpolation).unwrap();
            let sound = |v: &f32| *v == 0.0 || (*v - 2.0).abs() < 1e-5;
            assert!(half.values().iter().all(sound));
            assert!(half.count() < 16 && half.count() >= 7);
        }
    }

    #[test]
    fn the_two_nearests_differ_where_they_should() {
        let depth = DepthMap::new(4, 4, (1..=16).map(|v| v as f32).collect()).unwrap();
        let half = |interpolation| resize_depth(&depth, size(2, 2), interpolation).unwrap();
        assert_eq!(
            half(Interpolation::CvNearest).values(),
            [1.0, 3.0, 9.0, 11.0]
        );
        assert_eq!(
            half(Interpolation::PilNearest).values(),
            [6.0, 8.0, 14.0, 16.0]
        );
    }

    #[test]
    fn no_measurement_is_lost_where_there_is_a_single_one() {
        // A dense map is resized as by PIL at all sizes.
        let dense = DepthMap::new(7, 6, (1..=42).map(|v| v as f32).collect()).unwrap();
        for to in [size(3, 3), size(4, 5), size(6, 7), size(13, 9), size(1, 1)] {
            let resized = |interpolation| resize_depth(&dense, to, interpolation).unwrap();
            let (ours, pil) = (
                resized(Interpolation::NearestMeasured),
                resized(Interpolation::PilNearest),
            );
            assert_eq!(ours, pil, "{to}");
        }
        // 6x6 pixels in blocks of 3x3: one return in a corner; two returns, the one beside the centre nearer to it than the one
        // in the corner; the centre itself, and a nearer surface beside it; no return.
        let mut values = vec![0.0; 36];
        (values[0], values[6 + 5], values[5]) = (9.0, 7.0, 2.0);
        (values[4 * 6 + 1], values[4 * 6]) = (8.0, 1.0);
        let sparse = DepthMap::new(6, 6, values).unwrap();
        let third = resize_depth(&sparse, size(2, 2), Interpolation::NearestMeasured).unwrap();
        assert_eq!(third.values(), [9.0, 7.0, 8.0, 0.0]);
        // All isolated returns are kept; PIL keeps 4 of them.
        let mut values = vec![0.0; 35 * 24];
        for i in (3..35 * 24).step_by(31) {
            values[i] = 1.0 + i as f32;
        }
        let sparse = DepthMap::new(35, 24, values).unwrap();
        let small = resize_depth(&sparse, size(12, 17), Interpolation::NearestMeasured).unwrap();
        assert_eq!(small.count(), sparse.count());
        let lost = resize_depth(&sparse, size(12, 17), Interpolation::PilNearest).unwrap();
        assert_eq!((sparse.count(), lost.count()), (27, 4));
    }

    #[test]
    fn points_move_to_the_pixel_that_holds_them() {
        let mut values = vec![0.0; 16];
        (values[5], values[0], values[15]) = (2.0, 3.0, 7.0);
        let sparse = DepthMap::new(4, 4, values).unwrap();
        let half = move_points(&sparse, size(2, 2)).unwrap();
        assert_eq!(half.values(), [2.0, 0.0, 0.0, 7.0]);
        let double = move_points(&sparse, size(8, 8)).unwrap();
        assert_eq!(
            (double.at(1, 1), double.at(3, 3), double.at(7, 7)),
            (3.0, 2.0, 7.0)
        );
        assert_eq!(double.count(), 3);
    }
}
