//! Depths as 16-bit PNG, and the unit stored in such a file.

use super::{encoded, write_atomically};
use crate::error::{Error, Result};
use crate::{DepthMap, Unit};
use png::{BitDepth, ColorType, Compression, Encoder, Filter};
use std::fs::File;
use std::io::{BufReader, Write};
use std::path::Path;

/// Keyword of the text chunk with the number of stored units per metre.
const KEYWORD: &str = "Depth units per metre";

/// Candidate units per metre, the finest first; 256 is KITTI's.
const UNITS: [f64; 8] = [1e6, 1e5, 1e4, 1e3, 256.0, 100.0, 10.0, 1.0];

/// Largest 16-bit value.
const MOST: f64 = u16::MAX as f64;

/// Chooses the unit for a map: millimetres if all depths are between 0.5 mm and 65.535 m, else the finest candidate that
/// fits the farthest depth.
///
/// # Errors
/// A depth is beyond 65535 m.
pub fn png_unit(depth: &DepthMap) -> Result<Unit> {
    let (nearest, farthest) = depth.range().unwrap_or((1.0, 1.0));
    let (nearest, farthest) = (f64::from(nearest), f64::from(farthest));
    let holds = |per_metre: f64| (farthest * per_metre).round() <= MOST;
    let millimetre = 1.0 / Unit::MILLIMETRE.metres();
    if holds(millimetre) && nearest * millimetre >= 0.5 {
        return Ok(Unit::MILLIMETRE);
    }
    let finest = UNITS.into_iter().find(|&per_metre| holds(per_metre));
    finest.and_then(Unit::per_metre).ok_or_else(|| {
        Error::shape(format!(
            "a depth of {farthest} m does not fit into a 16-bit PNG"
        ))
        .hint("write npy, TIFF, EXR or PFM")
    })
}

/// Whether a depth is less than half a unit of `scale` metres and would be rounded to 0, no depth.
fn is_raised(depth: f32, scale: f64) -> bool {
    depth > 0.0 && (f64::from(depth) / scale).round() < 1.0
}

/// Counts the depths that [`write_depth_png`] raises to one unit, because they are less than half of it.
pub fn raised_in_png(depth: &DepthMap, scale: f64) -> usize {
    let depths = depth.values().iter();
    depths.filter(|&&depth| is_raised(depth, scale)).count()
}

/// Writes depths as a 16-bit grey PNG, value = metres / `scale` rounded, 0 = no depth. A depth below half a unit is written
/// as one unit. A text chunk stores the unit.
///
/// # Errors
/// A depth does not fit, or the file cannot be written.
pub fn write_depth_png(path: &Path, depth: &DepthMap, scale: f64) -> Result<()> {
    let values = stored(depth, scale)
        .map_err(|e| Error::shape(format!("`{}`: {e}", path.display())).hint(COARSER))?;
    write_atomically(path, |out| encode(out, depth, &values, scale))
}

/// Returns the bytes of the file that [`write_depth_png`] writes.
///
/// # Errors
/// A depth does not fit.
pub fn encode_depth_png(depth: &DepthMap, scale: f64) -> Result<Vec<u8>> {
    let values = stored(depth, scale).map_err(|e| Error::shape(e).hint(COARSER))?;
    encoded("a PNG", |bytes| encode(bytes, depth, &values, scale))
}

/// Hint for a depth that does not fit.
const COARSER: &str = "choose a coarser unit, or write npy, TIFF, EXR or PFM";

/// Returns the stored values of depths.
fn stored(depth: &DepthMap, scale: f64) -> std::result::Result<Vec<u8>, String> {
    let farthest = depth
        .range()
        .map_or(0.0, |(_, farthest)| f64::from(farthest));
    if (farthest / scale).round() > MOST {
        return Err(format!(
            "a depth of {farthest} m does not fit into 16 bits of {scale} m"
        ));
    }
    let stored = |&depth: &f32| {
        if is_raised(depth, scale) {
            1
        } else {
            (f64::from(depth) / scale).round() as u16
        }
    };
    let values = depth.values().iter().map(stored);
    Ok(values.flat_map(u16::to_be_bytes).collect())
}

fn encode(out: &mut dyn Write, depth: &DepthMap, values: &[u8], scale: f64) -> std::io::Result<()> {
    let text = (KEYWORD, format!("{}", 1.0 / scale));
    write_grey16(out, (depth.width(), depth.height()), values, text)
}

/// Returns the bytes of a 16-bit grey PNG of this width and height, with a text chunk of a keyword and a text. `values` are
/// row by row.
pub(crate) fn encode_grey16(
    size: (usize, usize),
    values: &[u16],
    text: (&str, String),
) -> Result<Vec<u8>> {
    let values: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
    encoded("a PNG", |bytes| write_grey16(bytes, size, &values, text))
}

fn write_grey16(
    out: &mut dyn Write,
    (width, height): (usize, usize),
    values: &[u8],
    text: (&str, String),
) -> std::io::Result<()> {
    let kind = (ColorType::Grayscale, BitDepth::Sixteen);
    write_png(out, (width as u32, height as u32), kind, text, values)
}

/// Writes a PNG with a text chunk of a keyword and a text.
pub(super) fn write_png(
    out: &mut dyn Write,
    (width, height): (u32, u32),
    (color, depth): (ColorType, BitDepth),
    (keyword, text): (&str, String),
    pixels: &[u8],
) -> std::io::Result<()> {
    let mut encoder = Encoder::new(out, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    // Trying every filter on each row saves too little for its time.
    encoder.set_compression(Compression::Fast);
    encoder.set_filter(Filter::Up);
    encoder.add_text_chunk(keyword.into(), text)?;
    let mut writer = encoder.write_header()?;
    writer.write_image_data(pixels)?;
    Ok(writer.finish()?)
}

/// Reads the unit that [`write_depth_png`] stored in a PNG. `None` for files of other programs or formats, and damaged
/// ones.
pub fn stored_unit(path: &Path) -> Option<Unit> {
    let file = BufReader::new(File::open(path).ok()?);
    let reader = png::Decoder::new(file).read_info().ok()?;
    declared_unit(reader.info())
}

/// Returns the unit in a text chunk before the pixels.
pub(super) fn declared_unit(info: &png::Info<'_>) -> Option<Unit> {
    let mut texts = info.uncompressed_latin1_text.iter();
    let unit = texts.find(|text| text.keyword == KEYWORD)?;
    Unit::per_metre(unit.text.parse().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::read_depth_png;

    fn map(values: &[f32]) -> DepthMap {
        DepthMap::new(values.len(), 1, values.to_vec()).unwrap()
    }

    #[test]
    fn no_depth_becomes_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.png");
        // The farthest depth of each unit, and one step beyond it.
        for (values, per_metre) in [
            ([0.5, 65.535], 1000.0),
            ([0.5, 65.536], 256.0),
            ([80.0, 255.996], 256.0),
            ([80.0, 256.0], 100.0),
            ([80.0, 655.36], 10.0),
            ([80.0, 65535.0], 1.0),
            ([0.0004, 0.065], 1e6),
            ([0.0004, 6.5], 1e4),
        ] {
            let depth = map(&values);
            let unit = png_unit(&depth).unwrap();
            assert_eq!(Some(unit), Unit::per_metre(per_metre), "{values:?}");
            write_depth_png(&path, &depth, unit.metres()).unwrap();
            assert_eq!(stored_unit(&path), Some(unit));
            let found = read_depth_png(&path, unit.metres()).unwrap();
            for (a, b) in found.values().iter().zip(values) {
                assert!(f64::from((a - b).abs()) <= 0.5001 / per_metre, "{a} {b}");
            }
        }
        // No unit fits such a wide range; near depths are at least not lost.
        let wide = map(&[0.0001, 60.0, 0.0]);
        assert_eq!(raised_in_png(&wide, 0.001), 1);
        write_depth_png(&path, &wide, png_unit(&wide).unwrap().metres()).unwrap();
        let found = read_depth_png(&path, 0.001).unwrap();
        assert_eq!(found.values(), [0.001, 60.0, 0.0]);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.png");
        assert!(png_unit(&map(&[65536.0])).is_err());
        assert!(write_depth_png(&path, &map(&[80.0]), 0.001).is_err());
        assert!(!path.exists());
        assert_eq!(stored_unit(&path), None);
    }
}
