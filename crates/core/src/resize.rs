//! Resizing of the image to the size at which the network works.

use crate::error::{ImageError, Result};
use fast_image_resize::images::{Image, ImageRef};
use fast_image_resize::{FilterType, PixelType, ResizeAlg, ResizeOptions, Resizer};

/// The colours of an image of size `from` (height, width) at another size, as PIL's `BILINEAR` filter gives
/// them, which averages all pixels when shrinking.
pub(crate) fn resized(rgb: Vec<u8>, from: (usize, usize), to: (usize, usize)) -> Result<Vec<u8>> {
    if from == to {
        return Ok(rgb);
    }
    let failed = || ImageError::Size {
        width: to.1,
        height: to.0,
    };
    let sides = |(height, width): (usize, usize)| [width, height].map(u32::try_from);
    let ([Ok(width), Ok(height)], [Ok(new_width), Ok(new_height)]) = (sides(from), sides(to))
    else {
        return Err(failed().into());
    };
    let pixel = PixelType::U8x3;
    let source = ImageRef::new(width, height, &rgb, pixel).map_err(|_| failed())?;
    let mut target = Image::new(new_width, new_height, pixel);
    let bilinear = ResizeAlg::Convolution(FilterType::Bilinear);
    let options = ResizeOptions::new().resize_alg(bilinear);
    let done = Resizer::new().resize(&source, &mut target, &options);
    done.map_err(|_| failed())?;
    Ok(target.into_vec())
}
