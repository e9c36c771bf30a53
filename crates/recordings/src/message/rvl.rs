//! RVL: 16-bit depths as runs of zeros and of differences (Wilson 2017, "Fast lossless depth image compression").

use crate::cdr::damaged;
use lsdc_files::error::Result;

/// Decodes `count` pixels. Memory is allocated only for values that are present, except for runs of zeros.
///
/// # Errors
/// The bytes end too early, a run is longer than the image, or a value does not fit in 16 bits.
pub(super) fn decode(bytes: &[u8], count: usize) -> Result<Vec<u16>> {
    let (words, _) = bytes.as_chunks();
    let mut numbers = Numbers { words, at: 0 };
    let mut values = Vec::new();
    // Each run of zeros is followed by a run of other values, each stored as its difference from the previous one.
    let mut last = 0_i64;
    while values.len() < count {
        let zeros = numbers.next()? as usize;
        let long = || damaged("of RVL has a run of pixels beyond its image");
        let left = count - values.len();
        let left = left.checked_sub(zeros).ok_or_else(long)?;
        values.resize(values.len() + zeros, 0);
        if left == 0 {
            break;
        }
        let others = numbers.next()? as usize;
        if others > left {
            return Err(long());
        }
        for _ in 0..others {
            let difference = i64::from(numbers.next()?);
            // The lowest bit is the sign.
            last += (difference >> 1) ^ -(difference & 1);
            let value = last.try_into();
            values.push(value.map_err(|_| damaged("of RVL has a value beyond 16 bits"))?);
        }
    }
    Ok(values)
}

/// Numbers of variable length, in nibbles of three bits, the lowest first, and a flag for more nibbles. A word is eight
/// nibbles, the first in its highest bits; words are little-endian.
struct Numbers<'a> {
    words: &'a [[u8; 4]],
    /// Position in nibbles.
    at: usize,
}

impl Numbers<'_> {
    fn next(&mut self) -> Result<u32> {
        /// Flag of a nibble that is followed by another one.
        const MORE: u32 = 8;
        let mut value = 0;
        // No number has more than 31 bits.
        for shift in (0..33).step_by(3) {
            let word = self.words.get(self.at / 8);
            let word = u32::from_le_bytes(*word.ok_or_else(|| damaged("of RVL ends too early"))?);
            let half = word >> (28 - 4 * (self.at % 8));
            self.at += 1;
            value |= u64::from(half % MORE) << shift;
            if half & MORE == 0 {
                return u32::try_from(value)
                    .map_err(|_| damaged("of RVL has a number beyond 32 bits"));
            }
        }
        Err(damaged("of RVL has a number without an end"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Words written as hexadecimal digits.
    fn words(text: &str) -> Vec<u8> {
        let words = text.split(' ');
        let words = words.map(|word| u32::from_str_radix(word, 16).unwrap());
        words.flat_map(u32::to_le_bytes).collect()
    }

    /// Bytes as written by the program of the publication.
    #[test]
    fn runs_and_differences() {
        let bytes = words("33a12212 8efff3bf fff31000");
        let values = [0, 0, 0, 5, 6, 7, 0, 65_535, 1, 0];
        assert_eq!(decode(&bytes, 10).unwrap(), values);
        assert_eq!(decode(&bytes, 6).unwrap(), values[..6]);
        assert!(decode(&bytes, 8).is_err());
        assert!(decode(&bytes[..8], 10).is_err());
        assert_eq!(decode(&words("40000000"), 4).unwrap(), [0; 4]);
        assert_eq!(decode(&[], 0).unwrap(), [0_u16; 0]);
    }

    #[test]
    fn what_is_no_rvl_is_refused() {
        for (text, count) in [
            ("50000000", 4),          // five zeros in four pixels
            ("05200000", 4),          // five values in four pixels
            ("01100000", 4),          // a value of -1
            ("01fffff7 00000000", 4), // a value beyond 16 bits
            ("ffffffff ffffffff", 4), // a number without an end
            ("ffffffff ff700000", 4), // a number beyond 32 bits
            ("00000000", 4),          // empty runs
        ] {
            assert!(decode(&words(text), count).is_err(), "{text}");
        }
    }
}
