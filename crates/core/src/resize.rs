//! Resizing of the image to the size at which the network works.

use crate::error::{ImageError, Result};
use fast_image_resize::images::{TypedImage, TypedImageRef};
use fast_image_resize::pixels::U8x3;
use fast_image_resize::{FilterType, ResizeAlg, ResizeOptions, Resizer};

/// The colours of an image of size `from` (height, width) at another size, as PIL's `BILINEAR` filter gives
/// them, which averages all pixels when shrinking.
pub(crate) fn resized(rgb: &[u8], from: (usize, usize), to: (usize, usize)) -> Result<Vec<u8>> {
    if from == to {
        return Ok(rgb.to_vec());
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
    let source = TypedImageRef::<U8x3>::from_buffer(width, height, rgb).map_err(|_| failed())?;
    let mut colours = vec![0; 3 * to.0 * to.1];
    let mut target = TypedImage::<U8x3>::from_buffer(new_width, new_height, &mut colours)
        .map_err(|_| failed())?;
    let bilinear = ResizeAlg::Convolution(FilterType::Bilinear);
    let options = ResizeOptions::new().resize_alg(bilinear);
    // Not `resize`, which is compiled for every type of pixel.
    let done = Resizer::new().resize_typed(&source, &mut target, &options);
    done.map_err(|_| failed())?;
    Ok(colours)
}
