//! Resizing of images to the working size of the network.

use crate::error::{ImageError, Result};
use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::{F32x3, U8x3};
use fast_image_resize::{FilterType, PixelTrait, ResizeAlg, ResizeOptions, Resizer};

/// Returns the colours of an image of size `from` (height, width) at another size, like PIL's `BILINEAR` filter, which averages
/// all pixels when shrinking.
pub(crate) fn resized(rgb: &[u8], from: (usize, usize), to: (usize, usize)) -> Result<Vec<u8>> {
    if from == to {
        return Ok(rgb.to_vec());
    }
    resampled_colours(rgb, from, to, FilterType::Bilinear)
}

/// Like [`resized`], with PIL's `BICUBIC` filter: cubic convolution, which averages all pixels when shrinking.
pub(crate) fn resized_colours_cubic(
    rgb: &[u8],
    from: (usize, usize),
    to: (usize, usize),
) -> Result<Vec<u8>> {
    if from == to {
        return Ok(rgb.to_vec());
    }
    resampled_colours(rgb, from, to, FilterType::CatmullRom)
}

fn resampled_colours(
    rgb: &[u8],
    from: (usize, usize),
    to: (usize, usize),
    filter: FilterType,
) -> Result<Vec<u8>> {
    let [width, height] = sides(from)?;
    let source = TypedImageRef::<U8x3>::from_buffer(width, height, rgb);
    let found = resampled(&source.map_err(|_| failed(from))?, to, filter)?;
    Ok(found.iter().flat_map(|pixel| pixel.0).collect())
}

/// Resizes a normalised image `[height, width, 3]` by cubic convolution, which averages all pixels when shrinking.
pub(crate) fn resized_cubic(
    image: &[f32],
    from: (usize, usize),
    to: (usize, usize),
) -> Result<Vec<f32>> {
    if from == to {
        return Ok(image.to_vec());
    }
    let (pixels, _) = image.as_chunks::<3>();
    let pixels: Vec<F32x3> = pixels.iter().map(|pixel| F32x3::new(*pixel)).collect();
    let [width, height] = sides(from)?;
    let source = TypedImageRef::new(width, height, &pixels).map_err(|_| failed(from))?;
    let found = resampled(&source, to, FilterType::CatmullRom)?;
    Ok(found.iter().flat_map(|pixel| pixel.0).collect())
}

fn resampled<P: PixelTrait>(
    source: &TypedImageRef<'_, P>,
    to: (usize, usize),
    filter: FilterType,
) -> Result<Vec<P>> {
    let [width, height] = sides(to)?;
    let mut target = TypedImage::<P>::new(width, height);
    let options = ResizeOptions::new().resize_alg(ResizeAlg::Convolution(filter));
    // Not `resize`, which would be compiled for every type of pixel.
    let done = Resizer::new().resize_typed(source, &mut target, &options);
    done.map_err(|_| failed(to))?;
    Ok(target.pixels().to_vec())
}

/// Width and height.
fn sides((height, width): (usize, usize)) -> Result<[u32; 2]> {
    let side = |length: usize| u32::try_from(length).map_err(|_| failed((height, width)));
    Ok([side(width)?, side(height)?])
}

fn failed((height, width): (usize, usize)) -> ImageError {
    ImageError::Size { width, height }
}
