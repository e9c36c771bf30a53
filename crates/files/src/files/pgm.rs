//! Portable grey maps: P2 in text, P5 in binary (netpbm, `pgm(5)`). The numbers are depths, so the maximum grey value in
//! the header does not scale them.

use super::check_pixels;
use crate::checks::NumberType;
use crate::error::{Error, Result};
use crate::raster::Raster;
use std::path::Path;

/// Reads the numbers of a grey map.
pub(super) fn read_pgm(path: &Path, bytes: &[u8]) -> Result<Raster> {
    let damaged = || {
        Error::format(path, "has a damaged header")
            .hint("a grey map begins with P5 or P2, width, height and the largest grey value")
    };
    let text = match &bytes[..bytes.len().min(2)] {
        b"P2" => true,
        b"P5" => false,
        b"P3" | b"P6" => return Err(colour(path)),
        _ => {
            return Err(Error::format(
                path,
                "is a bitmap or another kind of PNM, expected a grey map",
            )
            .hint("write a PGM: P5 or P2"));
        }
    };
    let mut words = Words { rest: &bytes[2..] };
    let mut next = || words.number().ok_or_else(damaged);
    let (width, height, largest) = (next()?, next()?, next()?);
    if width == 0 || height == 0 || !(1..=65535).contains(&largest) {
        return Err(damaged());
    }
    let pixels = u64::from(width) * u64::from(height);
    let each = if largest < 256 { 1 } else { 2 };
    check_pixels(path, (width, height), 4 * pixels, bytes.len() as u64)?;
    let cut_off = |found: usize| {
        let what = format!("declares {width}x{height} pixels but holds {found}");
        Error::format(path, what).hint("the file is cut off; write it again")
    };
    let count = pixels as usize;
    let values: Vec<f32> = if text {
        let mut values = Vec::new();
        while values.len() < count {
            let value = words.number().ok_or_else(|| cut_off(values.len()))?;
            values.push(value as f32);
        }
        values
    } else {
        // One whitespace character ends the header.
        let data = words.rest.get(1..).unwrap_or_default();
        if data.len() / each < count {
            return Err(cut_off(data.len() / each));
        }
        if each == 1 {
            data[..count].iter().map(|&v| f32::from(v)).collect()
        } else {
            let numbers = data.as_chunks::<2>().0[..count].iter();
            numbers
                .map(|&word| f32::from(u16::from_be_bytes(word)))
                .collect()
        }
    };
    if let Some(over) = values.iter().find(|v| **v > largest as f32) {
        let what = format!("holds {over}, more than its largest grey value, {largest}");
        return Err(Error::format(path, what).hint("the file is damaged; write it again"));
    }
    let size = (width as usize, height as usize);
    let numbers = NumberType::unsigned(8 * each as u32);
    Ok(Raster::new(size, values, numbers))
}

/// Error of a colour image in place of depths.
pub(super) fn colour(path: &Path) -> Error {
    Error::format(path, "is a colour image, expected grey depths")
        .hint("depth images are grey and have 16 bits: PNG, TIFF or PGM")
}

/// Numbers separated by whitespace; comments from `#` to the end of a line are skipped.
struct Words<'a> {
    rest: &'a [u8],
}

impl Words<'_> {
    fn number(&mut self) -> Option<u32> {
        loop {
            self.rest = self.rest.trim_ascii_start();
            if !self.rest.starts_with(b"#") {
                break;
            }
            let end = self
                .rest
                .iter()
                .position(|byte| matches!(byte, b'\n' | b'\r'))?;
            self.rest = &self.rest[end..];
        }
        let length = self
            .rest
            .iter()
            .take_while(|byte| byte.is_ascii_digit())
            .count();
        let (digits, rest) = self.rest.split_at(length);
        self.rest = rest;
        std::str::from_utf8(digits).ok()?.parse().ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<Raster> {
        read_pgm(Path::new("depth.pgm"), bytes)
    }

    #[test]
    fn the_largest_grey_value_scales_nothing() {
        for largest in [300, 8191, 10_000, 65535] {
            let head = format!("P5\n# millimetres\n3 1 {largest}\n");
            let body = [0, 0, 1, 44, 0, 7];
            let found = read(&[head.as_bytes(), &body].concat()).unwrap();
            assert_eq!(found.values, [0.0, 300.0, 7.0], "{largest}");
            assert_eq!(found.numbers, NumberType::unsigned(16));
        }
        let found = read(b"P5 3 1 100\n\x00\x64\x07").unwrap();
        assert_eq!(
            (&found.values[..], found.numbers),
            (&[0.0, 100.0, 7.0][..], NumberType::unsigned(8))
        );
        let found = read(b"P2\n2 2 # a remark\n4000\n0 1234\r\n7 4000").unwrap();
        assert_eq!(found.values, [0.0, 1234.0, 7.0, 4000.0]);
    }

    #[test]
    fn what_is_cut_off_damaged_or_coloured_is_refused() {
        for (bytes, what) in [
            (&b"P5 2 2 255\n\x01\x02\x03"[..], "holds 3"),
            (b"P2 2 2 255\n1 2 3", "holds 3"),
            (b"P5 2 2 70000\n\x01\x02\x03\x04", "damaged header"),
            (b"P5 2 0 255\n", "damaged header"),
            (b"P5 2", "damaged header"),
            (b"P5 2 1 100\n\x65\x01", "more than its largest"),
            (b"P6 1 1 255\n\x01\x02\x03", "colour image"),
            (b"P4 8 1\n\x01", "bitmap"),
            (b"P5 40000 40000 65535\n\x01\x02", "declares"),
        ] {
            let error = read(bytes).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
    }
}
