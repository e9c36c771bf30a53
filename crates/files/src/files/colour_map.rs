//! Colour maps as PNG, with the depths at the ends of their scale.

use super::depth_png::write_png;
use super::write_atomically;
use crate::error::Result;
use image::RgbImage;
use png::{BitDepth, ColorType};
use std::path::Path;

/// Keyword of the text chunk with the depths of the first and the last colour, as `LOW,HIGH`.
const KEYWORD: &str = "Depths of the colour scale";

/// Writes an 8-bit colour PNG of depths. A text chunk contains the depths of the first and the last colour in metres, or in
/// the unit of the depths.
///
/// # Errors
/// The file cannot be written.
pub fn write_colour_map(path: &Path, image: &RgbImage, (low, high): (f32, f32)) -> Result<()> {
    let (size, colors) = (image.dimensions(), (ColorType::Rgb, BitDepth::Eight));
    let text = (KEYWORD, format!("{low},{high}"));
    write_atomically(path, |out| {
        write_png(out, size, colors, text, image.as_raw())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn the_ends_of_the_colours_are_in_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("colours.png");
        let image = RgbImage::from_fn(7, 5, |x, y| Rgb([40 * x as u8, 60 * y as u8, 9]));
        write_colour_map(&path, &image, (0.5, 8.25)).unwrap();
        assert_eq!(crate::read_rgb(&path).unwrap(), image);
        let file = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
        let reader = png::Decoder::new(file).read_info().unwrap();
        let texts = &reader.info().uncompressed_latin1_text;
        assert_eq!(texts.len(), 1);
        assert_eq!((&*texts[0].keyword, &*texts[0].text), (KEYWORD, "0.5,8.25"));
    }
}
