//! The tags of TIFF files (TIFF 6.0, section 2; `BigTIFF` has the same fields, wider).

use crate::checks::Warning;
use crate::error::{Error, Result};
use std::ops::Range;
use std::path::Path;

/// Tags of the first directory of a file.
pub(super) struct Tags {
    little: bool,
    /// Number, type, and byte range of the values of each tag.
    found: Vec<(u64, u64, Range<usize>)>,
    /// Number of directories, one for each page.
    pages: usize,
}

/// Positions are in the unit of the resolution, which is in pixels per unit.
const X_POSITION: u64 = 286;
const Y_POSITION: u64 = 287;
const X_RESOLUTION: u64 = 282;
const Y_RESOLUTION: u64 = 283;

/// Largest number of pages that are counted.
const MOST: usize = 10_000;

impl Tags {
    /// Reads the tags. Rejects tags with more numbers than the file has bytes, for which the library would allocate memory.
    pub(super) fn of(path: &Path, bytes: &[u8]) -> Result<Self> {
        let cut_off = || {
            Error::format(path, "is cut off: it has no directory of tags")
                .hint("the file is incomplete; write it again")
        };
        let little = bytes.starts_with(b"II");
        let number = |range: Range<usize>| bytes.get(range).map(|bytes| number(bytes, little));
        let big = number(2..4).ok_or_else(cut_off)? == 43;
        // Lengths of the number of tags, of a tag, of its number of values, and of an offset.
        let (all, tag, count, wide) = if big { (8, 20, 8, 8) } else { (2, 12, 4, 4) };
        let first = if big { 8..16 } else { 4..8 };
        let mut start = number(first).ok_or_else(cut_off)? as usize;
        let mut tags = Self {
            little,
            found: Vec::new(),
            pages: 0,
        };
        while start != 0 && tags.pages < MOST {
            let after = |length: usize| start.saturating_add(length);
            let Some(entries) = number(start..after(all)) else {
                // A later directory may be truncated if the first is complete.
                if tags.pages > 0 {
                    break;
                }
                return Err(cut_off());
            };
            let mut at = after(all);
            for _ in 0..entries {
                let field = |from: usize, length: usize| {
                    let from = at.saturating_add(from);
                    number(from..from.saturating_add(length)).ok_or_else(cut_off)
                };
                let (id, kind, numbers) = (field(0, 2)?, field(2, 2)?, field(4, count)?);
                if numbers > bytes.len() as u64 {
                    let (declared, size) = (numbers, bytes.len());
                    return Err(Error::format(
                        path,
                        format!(
                            "declares {declared} numbers in a tag but is only {size} bytes long"
                        ),
                    ));
                }
                let length = width(kind) * numbers as usize;
                // Values that fit are stored in the tag itself.
                let begin = if length <= wide {
                    at + 4 + count
                } else {
                    field(4 + count, wide)? as usize
                };
                if tags.pages == 0 {
                    tags.found
                        .push((id, kind, begin..begin.saturating_add(length)));
                }
                at += tag;
            }
            tags.pages += 1;
            let next = number(at..at.saturating_add(wide)).unwrap_or(0) as usize;
            // Directories of other programs may be anywhere, but a chain that goes back would never end.
            start = if next > start { next } else { 0 };
        }
        if tags.pages == 0 {
            return Err(cut_off());
        }
        Ok(tags)
    }

    /// Returns a warning if the first of several pages is read.
    pub(super) fn chosen_page(&self) -> Option<Warning> {
        Warning::first("page", self.pages)
    }

    /// Returns the offset of the image in a larger picture in pixels, if it is not 0.
    pub(super) fn offset(&self, bytes: &[u8]) -> Option<[i64; 2]> {
        let along = |position: u64, resolution: u64| {
            let number = |tag| self.number(tag, bytes).filter(|v: &f64| v.is_finite());
            (number(position).unwrap_or(0.0) * number(resolution).unwrap_or(1.0)).round() as i64
        };
        let offset = [
            along(X_POSITION, X_RESOLUTION),
            along(Y_POSITION, Y_RESOLUTION),
        ];
        (offset != [0, 0]).then_some(offset)
    }

    /// Returns the type of a tag and the byte range of its values.
    fn range(&self, id: u64) -> Option<(u64, Range<usize>)> {
        let found = self.found.iter().find(|(other, ..)| *other == id);
        found.map(|(_, kind, range)| (*kind, range.clone()))
    }

    /// Returns the byte range of a 16-bit number.
    pub(super) fn short(&self, id: u64) -> Option<Range<usize>> {
        let (_, range) = self.range(id)?;
        Some(range.start..range.start + 2)
    }

    /// Returns a number, an integer or a fraction.
    pub(super) fn number(&self, id: u64, bytes: &[u8]) -> Option<f64> {
        let (kind, range) = self.range(id)?;
        let value = |range: Range<usize>| {
            bytes
                .get(range)
                .map(|bytes| number(bytes, self.little) as f64)
        };
        // Fractions are pairs of numbers.
        if matches!(kind, 5 | 10) {
            let middle = range.start + 4;
            return Some(value(range.start..middle)? / value(middle..middle + 4)?);
        }
        value(range.start..range.start + width(kind))
    }

    /// Returns a text.
    pub(super) fn text<'a>(&self, id: u64, bytes: &'a [u8]) -> Option<&'a str> {
        let (_, range) = self.range(id)?;
        let text = std::str::from_utf8(bytes.get(range)?).ok()?;
        Some(text.trim_matches(|letter: char| letter == '\0' || letter.is_whitespace()))
    }

    /// Returns the bytes of a 16-bit number.
    pub(super) fn short_bytes(&self, value: u16) -> [u8; 2] {
        if self.little {
            value.to_le_bytes()
        } else {
            value.to_be_bytes()
        }
    }
}

/// Returns the size of each type in bytes.
fn width(kind: u64) -> usize {
    match kind {
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16..=18 => 8,
        _ => 1,
    }
}

fn number(bytes: &[u8], little: bool) -> u64 {
    let add = |value: u64, byte: &u8| value << 8 | u64::from(*byte);
    if little {
        bytes.iter().rev().fold(0, add)
    } else {
        bytes.iter().fold(0, add)
    }
}
