//! Portable float maps: a header of three lines, then rows of f32 from bottom to top.

use super::write_atomically;
use crate::DepthMap;
use crate::checks::{NumberType, Warning};
use crate::error::{Error, Result};
use crate::raster::Raster;
use std::path::Path;

/// Reads the numbers of a grey map (`Pf`). The scale factor in its header is reported and not applied, because it varies
/// among files of the same unit.
///
/// # Errors
/// The file is missing, damaged, or a colour map (`PF`).
pub(crate) fn read_pfm(path: &Path) -> Result<Raster> {
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let wrong = |what: &str| {
        Error::format(path, what).hint("grey float maps are read: Pf, width and height, -1.0")
    };
    let mut rest = &bytes[..];
    let mut next = || -> Option<&str> {
        let start = rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let tail = &rest[start..];
        let end = tail.iter().position(u8::is_ascii_whitespace)?;
        let (word, after) = tail.split_at(end);
        // One whitespace character ends a word; after the last word the values follow.
        rest = &after[1..];
        std::str::from_utf8(word).ok()
    };
    match next() {
        Some("Pf") => {}
        Some("PF") => return Err(wrong("is a colour float map")),
        _ => return Err(wrong("is no grey float map")),
    }
    let length = |word: Option<&str>| word?.parse::<usize>().ok();
    let (width, height) = (length(next()), length(next()));
    let order = next().and_then(|word| word.parse::<f64>().ok());
    let (Some(width), Some(height), Some(order)) = (width, height, order) else {
        return Err(wrong("has a damaged header"));
    };
    let bytes = 4.0 * width as f64 * height as f64;
    if width == 0 || height == 0 || bytes > rest.len() as f64 {
        return Err(wrong(&format!(
            "declares {width}x{height} values but holds {} bytes of them",
            rest.len()
        )));
    }
    let (words, _) = rest.as_chunks::<4>();
    let value = |word: [u8; 4], little: bool| {
        if little {
            f32::from_le_bytes(word)
        } else {
            f32::from_be_bytes(word)
        }
    };
    let little = order < 0.0;
    let wild = |little| share_of_wild(words[..width * height].iter().map(|&w| value(w, little)));
    if wild(little) > 0.5 && wild(!little) < 0.01 {
        return Err(Error::format(
            path,
            "has its bytes in the other order than its header says",
        )
        .hint("turn the sign of the scale around: -1.0 is little-endian, 1.0 big-endian"));
    }
    let rows = words[..width * height].chunks_exact(width).rev();
    let values = rows.flat_map(|row| row.iter().map(|&word| value(word, little)));
    let mut raster = Raster::new((width, height), values.collect(), NumberType::Floats);
    if !matches!(order.abs(), 0.0 | 1.0) {
        raster.warnings.push(Warning::Scale(order.abs()));
    }
    Ok(raster)
}

/// Returns the share of non-zero values that are implausible in any unit, as are numbers with the wrong byte order.
fn share_of_wild(values: impl Iterator<Item = f32>) -> f64 {
    let (mut wild, mut all) = (0_usize, 0_usize);
    for value in values.filter(|value| *value != 0.0) {
        all += 1;
        wild += usize::from(!(1e-6..1e12).contains(&value.abs()) && !value.is_infinite());
    }
    wild as f64 / all.max(1) as f64
}

/// Writes a grey map in metres, little-endian.
///
/// # Errors
/// The file cannot be written.
pub fn write_pfm(path: &Path, depth: &DepthMap) -> Result<()> {
    write_atomically(path, |out| {
        write!(out, "Pf\n{} {}\n-1.0\n", depth.width(), depth.height())?;
        for row in depth.values().chunks_exact(depth.width()).rev() {
            for value in row {
                out.write_all(&value.to_le_bytes())?;
            }
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sign_of_the_scale_is_the_order_of_bytes_and_its_size_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pfm");
        for (scale, bytes, warnings) in [
            ("-1.0", 2.5_f32.to_le_bytes(), vec![]),
            ("1", 2.5_f32.to_be_bytes(), vec![]),
            (
                "-0.003922",
                2.5_f32.to_le_bytes(),
                vec![Warning::Scale(0.003_922)],
            ),
        ] {
            let file = [format!("Pf\n1 1\n{scale}\n").as_bytes(), &bytes].concat();
            std::fs::write(&path, file).unwrap();
            let found = read_pfm(&path).unwrap();
            assert_eq!((found.values, found.warnings), (vec![2.5], warnings));
        }
        std::fs::write(&path, b"PF\n1 1\n-1\n000000000000").unwrap();
        let error = read_pfm(&path).unwrap_err().to_string();
        assert!(error.contains("colour"), "{error}");
    }

    /// Reported for libvips (issue 3885): the sign of the scale contradicts the byte order.
    #[test]
    fn a_header_that_contradicts_the_order_of_the_bytes_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pfm");
        let depths = [2.2_f32, 0.0, 3.1, 2.9, 4.7, 0.0];
        let read = |scale: &str, bytes: fn(f32) -> [u8; 4]| {
            let mut file = format!("Pf\n3 2\n{scale}\n").into_bytes();
            file.extend(depths.iter().flat_map(|&depth| bytes(depth)));
            std::fs::write(&path, file).unwrap();
            read_pfm(&path)
        };
        assert!(read("1.0", f32::to_be_bytes).is_ok());
        for (scale, bytes) in [
            ("-1.0", f32::to_be_bytes as fn(f32) -> [u8; 4]),
            ("1.0", f32::to_le_bytes),
        ] {
            let error = read(scale, bytes).unwrap_err().to_string();
            assert!(error.contains("other order"), "{error}");
        }
    }

    #[test]
    fn widths_and_heights_are_whole_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pfm");
        let read = |size: &str| {
            let mut file = format!("Pf\n{size}\n-1.0\n").into_bytes();
            file.extend([0; 64]);
            std::fs::write(&path, file).unwrap();
            read_pfm(&path)
        };
        assert_eq!(read("2 3").unwrap().values.len(), 6);
        for size in ["2.5 3", "2 3.0", "-2 3", "0 3", "nan 3", "1e1 1"] {
            assert!(read(size).is_err(), "{size}");
        }
    }
}
