//! Portable float maps: a header of three lines, then rows of f32 from the bottom up.

use super::write_atomically;
use crate::DepthMap;
use crate::error::{Error, Result};
use std::path::Path;

/// Reads a grey map (`Pf`) as depth: metres = value x `scale`.
///
/// # Errors
/// A missing or damaged file, or a colour map (`PF`).
pub(crate) fn read_pfm(path: &Path, scale: f64) -> Result<DepthMap> {
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
        // One blank ends a word; after the last it is followed by the values.
        rest = &after[1..];
        std::str::from_utf8(word).ok()
    };
    if next() != Some("Pf") {
        return Err(wrong("is no grey float map"));
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
    let value = |word: [u8; 4]| {
        let value = if order < 0.0 {
            f32::from_le_bytes(word)
        } else {
            f32::from_be_bytes(word)
        };
        (f64::from(value) * scale) as f32
    };
    let rows = words[..width * height].chunks_exact(width).rev();
    let values = rows.flat_map(|row| row.iter().map(|&word| value(word)));
    Ok(DepthMap::new(width, height, values.collect())?)
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
    fn widths_and_heights_are_whole_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pfm");
        let read = |size: &str| {
            let mut file = format!("Pf\n{size}\n-1.0\n").into_bytes();
            file.extend([0; 64]);
            std::fs::write(&path, file).unwrap();
            read_pfm(&path, 1.0)
        };
        assert_eq!(read("2 3").unwrap().values().len(), 6);
        for size in ["2.5 3", "2 3.0", "-2 3", "0 3", "nan 3", "1e1 1"] {
            assert!(read(size).is_err(), "{size}");
        }
    }
}
