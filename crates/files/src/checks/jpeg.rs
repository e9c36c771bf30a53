//! Detects truncated JPEG files, which decoders fill up with grey.
//!
//! ITU-T T.81: markers (annex B), Huffman codes (annex C and F.2.2). Blocks of sequential images are counted by decoding
//! the lengths of their codes, so that an image without an end marker, which some cameras omit in MJPEG, is complete if its
//! blocks are. Progressive images need their end marker, and scans that refine every coefficient to its last bit (annex G).

use std::collections::HashMap;
use std::fmt::{Display, Formatter};

/// Where a JPEG is truncated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CutOff {
    /// Before its first scan.
    Header,
    /// Within the blocks of a scan, after some rows of pixels.
    Rows {
        /// Number of complete rows.
        rows: usize,
        /// Number of rows of the image.
        of: usize,
    },
    /// Before its last scans, which refine the image.
    Scans,
    /// Before its end marker.
    End,
}

impl Display for CutOff {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Header => write!(f, "the JPEG is cut off within its header"),
            Self::Rows { rows, of } => {
                write!(
                    f,
                    "the JPEG is cut off or damaged after {rows} of its {of} rows"
                )
            }
            Self::Scans => write!(f, "the JPEG is cut off: its last scans are missing"),
            Self::End => write!(f, "the JPEG is cut off: its end marker is missing"),
        }
    }
}

impl std::error::Error for CutOff {}

/// Checks that a JPEG is complete. Bytes after its end, thumbnails in its header, and a missing end marker after complete
/// rows are accepted. Other formats are not checked.
///
/// # Errors
/// The file is truncated.
pub fn check_jpeg(bytes: &[u8]) -> Result<(), CutOff> {
    if !bytes.starts_with(&[0xff, SOI]) {
        return Ok(());
    }
    let mut image = Image::default();
    let mut at = 2;
    loop {
        let Some((marker, body)) = next_marker(bytes, at) else {
            return image.at_end();
        };
        if marker == EOI {
            return image.at_marker();
        }
        if matches!(marker, 0x01 | 0xd0..=SOI) {
            at = body;
            continue;
        }
        let Some(segment) = segment(bytes, body) else {
            return image.at_end();
        };
        at = body + 2 + segment.len();
        match marker {
            0xc4 => image.add_tables(segment),
            0xc0..=0xcf if !matches!(marker, 0xc8 | 0xcc) => {
                image.frame = Frame::of(marker, segment);
            }
            0xdd => {
                image.interval = segment
                    .first_chunk()
                    .map_or(0, |n| usize::from(u16::from_be_bytes(*n)));
            }
            0xda => {
                image.scans += 1;
                image.refine(segment);
                at = image.scan(segment, bytes, at)?;
            }
            _ => {}
        }
    }
}

const SOI: u8 = 0xd8;
const EOI: u8 = 0xd9;

/// Returns the next marker, and the position after it. Fill bytes and any other bytes before it are skipped.
fn next_marker(bytes: &[u8], from: usize) -> Option<(u8, usize)> {
    let rest = bytes.get(from..)?;
    let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0 | 0xff);
    let place = rest.windows(2).position(is_marker)?;
    Some((rest[place + 1], from + place + 2))
}

/// Returns the segment whose length field is at `at`, without the length.
fn segment(bytes: &[u8], at: usize) -> Option<&[u8]> {
    let length = bytes
        .get(at..)?
        .first_chunk()
        .map(|n| usize::from(u16::from_be_bytes(*n)))?;
    bytes.get(at + 2..at + length.max(2))
}

/// The relevant parts of the header.
#[derive(Default)]
struct Image {
    frame: Option<Frame>,
    /// Huffman tables of DC and of AC coefficients.
    tables: [[Option<Table>; 4]; 2],
    /// Units between restart markers; 0 if there are none.
    interval: usize,
    scans: usize,
    /// Identifiers of the components whose blocks are complete.
    complete: Vec<u8>,
    /// Missing bits by coefficient, for each component of a progressive image.
    missing: HashMap<u8, [u8; 64]>,
}

impl Image {
    /// Checks completeness at the end of the file.
    fn at_end(&self) -> Result<(), CutOff> {
        match &self.frame {
            Some(frame) if self.is_complete(frame) => Ok(()),
            Some(_) if self.scans > 0 => Err(CutOff::End),
            _ => Err(CutOff::Header),
        }
    }

    /// Checks completeness at the end marker.
    fn at_marker(&self) -> Result<(), CutOff> {
        match &self.frame {
            _ if self.scans == 0 => Err(CutOff::Header),
            Some(frame) if frame.sequential && self.counts(frame) && !self.is_complete(frame) => {
                Err(CutOff::End)
            }
            Some(frame) if frame.progressive && !self.is_refined(frame) => Err(CutOff::Scans),
            _ => Ok(()),
        }
    }

    /// Whether blocks of this image were counted.
    fn counts(&self, frame: &Frame) -> bool {
        frame.sequential && !self.complete.is_empty()
    }

    fn is_complete(&self, frame: &Frame) -> bool {
        let has = |part: &Component| self.complete.contains(&part.id);
        frame.sequential && frame.components.iter().all(has)
    }

    /// Whether every coefficient of a progressive image has all its bits.
    fn is_refined(&self, frame: &Frame) -> bool {
        let whole = |part: &Component| self.missing.get(&part.id).is_some_and(|m| *m == [0; 64]);
        frame.components.iter().all(whole)
    }

    /// Records the progress of a scan of a progressive image. Its header contains the components, the first and last
    /// coefficient and, in the low half of the last byte, the number of bits left for later scans.
    fn refine(&mut self, header: &[u8]) {
        const NEVER: u8 = u8::MAX;
        let Some((&count, parts)) = header.split_first() else {
            return;
        };
        let Some((ids, &[first, last, bits])) = parts.split_at_checked(2 * usize::from(count))
        else {
            return;
        };
        for id in ids.iter().step_by(2) {
            let missing = self.missing.entry(*id).or_insert([NEVER; 64]);
            if let Some(band) = missing.get_mut(usize::from(first)..=usize::from(last)) {
                band.fill(bits & 15);
            }
        }
    }

    fn add_tables(&mut self, mut segment: &[u8]) {
        while let Some((&[class, ref lengths @ ..], rest)) = segment.split_first_chunk::<17>() {
            let count: usize = lengths.iter().map(|&n| usize::from(n)).sum();
            let Some(symbols) = rest.get(..count) else {
                return;
            };
            let places = self.tables.get_mut(usize::from(class >> 4));
            if let Some(place) = places.and_then(|tables| tables.get_mut(usize::from(class & 15))) {
                *place = Some(Table::new(lengths, symbols));
            }
            segment = &rest[count..];
        }
    }

    /// Skips the entropy-coded data of a scan, which starts at `at`, and returns its end. Blocks are counted if the image
    /// is sequential and its tables are known.
    fn scan(&mut self, header: &[u8], bytes: &[u8], at: usize) -> Result<usize, CutOff> {
        let counted = self
            .frame
            .as_ref()
            .and_then(|frame| frame.scan(header, &self.tables));
        let Some(scan) = counted else {
            return Ok(end_of_data(bytes, at));
        };
        let mut bits = Bits::new(bytes, at);
        for unit in 0..scan.units {
            if self.interval > 0 && unit > 0 && unit % self.interval == 0 && !bits.restart() {
                return Err(scan.cut_off(unit));
            }
            for (blocks, dc, ac) in &scan.blocks {
                for _ in 0..*blocks {
                    if bits.block(dc, ac).is_none() {
                        return Err(scan.cut_off(unit));
                    }
                }
            }
        }
        self.complete.extend(&scan.ids);
        Ok(end_of_data(bytes, bits.at))
    }
}

/// Returns the end of entropy-coded data: the first marker that is not a restart.
fn end_of_data(bytes: &[u8], mut at: usize) -> usize {
    while let Some((marker, body)) = next_marker(bytes, at) {
        if !matches!(marker, 0xd0..=0xd7) {
            return body - 2;
        }
        at = body;
    }
    bytes.len()
}

struct Component {
    id: u8,
    /// Number of blocks per unit, across and down.
    across: usize,
    down: usize,
}

struct Frame {
    width: usize,
    height: usize,
    /// Whether codes are Huffman codes, neither progressive nor lossless.
    sequential: bool,
    progressive: bool,
    components: Vec<Component>,
}

/// Parameters for counting the blocks of a scan.
struct Scan<'a> {
    units: usize,
    /// Units per row and, below, rows of pixels per unit.
    across: usize,
    down: usize,
    height: usize,
    /// Number of blocks of each component in a unit, with its tables.
    blocks: Vec<(usize, &'a Table, &'a Table)>,
    ids: Vec<u8>,
}

impl Scan<'_> {
    /// Returns the error of a file that ends in this unit.
    fn cut_off(&self, unit: usize) -> CutOff {
        CutOff::Rows {
            rows: (unit / self.across.max(1) * self.down).min(self.height),
            of: self.height,
        }
    }
}

impl Frame {
    fn of(marker: u8, segment: &[u8]) -> Option<Self> {
        let (&[_, h, eight, w, idth, _], parts) = segment.split_first_chunk()?;
        let part = |&[id, sampling, _]: &[u8; 3]| Component {
            id,
            across: usize::from(sampling >> 4).max(1),
            down: usize::from(sampling & 15).max(1),
        };
        Some(Self {
            width: usize::from(u16::from_be_bytes([w, idth])),
            height: usize::from(u16::from_be_bytes([h, eight])),
            sequential: matches!(marker, 0xc0 | 0xc1),
            progressive: matches!(marker, 0xc2 | 0xca),
            components: parts.as_chunks().0.iter().map(part).collect(),
        })
    }

    /// Reads the header of a scan; `None` if its blocks cannot be counted.
    fn scan<'a>(&self, header: &[u8], tables: &'a [[Option<Table>; 4]; 2]) -> Option<Scan<'a>> {
        let (&count, parts) = header.split_first()?;
        let parts = parts.as_chunks::<2>().0.get(..usize::from(count))?;
        if !self.sequential || self.height == 0 || parts.is_empty() {
            return None;
        }
        let most = |side: fn(&Component) -> usize| self.components.iter().map(side).max();
        let (across, down) = (most(|part| part.across)?, most(|part| part.down)?);
        let mut blocks = Vec::new();
        let mut ids = Vec::new();
        // A scan of a single component has one block per unit, and only as many units as its own samples need.
        let alone = parts.len() == 1;
        let mut unit = (8 * across, 8 * down);
        for &[id, selector] in parts {
            let part = self.components.iter().find(|part| part.id == id)?;
            let table = |class: usize, number: u8| tables[class].get(usize::from(number))?.as_ref();
            let (dc, ac) = (table(0, selector >> 4)?, table(1, selector & 15)?);
            let here = if alone { 1 } else { part.across * part.down };
            if alone {
                unit = (8 * across / part.across, 8 * down / part.down);
            }
            blocks.push((here, dc, ac));
            ids.push(id);
        }
        let (columns, rows) = (self.width.div_ceil(unit.0), self.height.div_ceil(unit.1));
        Some(Scan {
            units: columns * rows,
            across: columns,
            down: unit.1,
            height: self.height,
            blocks,
            ids,
        })
    }
}

/// Code length and symbol for each 16-bit prefix; a length of 0 is not a code.
struct Table(Vec<(u8, u8)>);

impl Table {
    fn new(lengths: &[u8], symbols: &[u8]) -> Self {
        let mut table = vec![(0, 0); 1 << 16];
        let mut symbols = symbols.iter();
        let mut start = 0_usize;
        for (length, &count) in (1_u8..).zip(lengths) {
            for &symbol in symbols.by_ref().take(usize::from(count)) {
                let end = start + (1 << (16 - length));
                // The table is damaged, with more codes than there are bits for; the rest is ignored.
                let Some(places) = table.get_mut(start..end) else {
                    return Self(table);
                };
                places.fill((length, symbol));
                start = end;
            }
        }
        Self(table)
    }
}

/// Bit reader of entropy-coded data.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    /// The next bits, the first in the highest bit.
    buffer: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    fn new(bytes: &'a [u8], at: usize) -> Self {
        Self {
            bytes,
            at,
            buffer: 0,
            count: 0,
        }
    }

    /// Fills the buffer to at least 48 bits, unless the data end before.
    fn fill(&mut self) {
        while self.count <= 48 {
            let Some(&byte) = self.bytes.get(self.at) else {
                return;
            };
            if byte == 0xff {
                match self.bytes.get(self.at + 1) {
                    Some(0) => self.at += 1,
                    // A marker, or the end of the data.
                    _ => return,
                }
            }
            self.at += 1;
            self.buffer |= u64::from(byte) << (56 - self.count);
            self.count += 8;
        }
    }

    /// Skips bits; `None` if there are too few.
    fn skip(&mut self, bits: u32) -> Option<()> {
        self.count = self.count.checked_sub(bits)?;
        self.buffer = self.buffer.checked_shl(bits).unwrap_or(0);
        Some(())
    }

    /// Returns the next symbol, whose low 4 bits are the length of the number after it, and skips that number.
    fn symbol(&mut self, table: &Table) -> Option<u8> {
        if self.count < 32 {
            self.fill();
        }
        let (length, symbol) = table.0[(self.buffer >> 48) as usize];
        if length == 0 {
            return None;
        }
        self.skip(u32::from(length) + u32::from(symbol & 15))?;
        Some(symbol)
    }

    /// Skips a block of 64 coefficients.
    fn block(&mut self, dc: &Table, ac: &Table) -> Option<()> {
        self.symbol(dc)?;
        let mut coefficient = 1;
        while coefficient < 64 {
            match self.symbol(ac)? {
                0 => return Some(()),
                symbol => coefficient += usize::from(symbol >> 4) + 1,
            }
        }
        Some(())
    }

    /// Skips a restart marker. Returns whether there was one.
    fn restart(&mut self) -> bool {
        match next_marker(self.bytes, self.at) {
            Some((0xd0..=0xd7, body)) => {
                *self = Self::new(self.bytes, body);
                true
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;
    use image::{DynamicImage, ExtendedColorType, ImageEncoder as _, Rgb, RgbImage};

    fn picture() -> RgbImage {
        RgbImage::from_fn(83, 61, |x, y| {
            let noise = (x * 7919 + y * 104_729) % 97;
            Rgb([(x * 3) as u8, (y * 4) as u8, noise as u8])
        })
    }

    /// A sequential JPEG, grey or in colour with subsampled chroma.
    fn jpeg(grey: bool) -> Vec<u8> {
        let mut bytes = Vec::new();
        let encoder = JpegEncoder::new_with_quality(&mut bytes, 85);
        let image = DynamicImage::ImageRgb8(picture());
        if grey {
            let image = image.into_luma8();
            encoder.write_image(&image, 83, 61, ExtendedColorType::L8)
        } else {
            encoder.write_image(&image.into_rgb8(), 83, 61, ExtendedColorType::Rgb8)
        }
        .unwrap();
        bytes
    }

    #[test]
    fn a_jpeg_is_whole_with_its_blocks_and_cut_off_anywhere_before() {
        for bytes in [jpeg(false), jpeg(true)] {
            assert_eq!(check_jpeg(&bytes), Ok(()));
            let length = bytes.len();
            // Without the end marker, as some cameras omit it, and with other data after it.
            assert_eq!(check_jpeg(&bytes[..length - 2]), Ok(()));
            assert_eq!(check_jpeg(&[&bytes[..], b"motion photo"].concat()), Ok(()));
            for end in (2..length - 3).step_by(7) {
                assert!(check_jpeg(&bytes[..end]).is_err(), "{end} of {length}");
                // Truncated, with an end marker appended by a program.
                let closed = [&bytes[..end], &[0xff, EOI]].concat();
                assert!(check_jpeg(&closed).is_err(), "{end} of {length}, closed");
            }
        }
    }

    /// Headers of scans, as written by libjpeg in its simplest script, with a few bytes of data.
    #[test]
    fn a_progressive_jpeg_is_whole_if_every_coefficient_has_all_its_bits() {
        let scan = |ids: &[u8], [first, last, bits]: [u8; 3]| {
            let parts = ids.iter().flat_map(|id| [*id, 0]);
            let length = [0, 6 + 2 * ids.len() as u8, ids.len() as u8];
            let header = [0xff, 0xda].into_iter().chain(length).chain(parts);
            header
                .chain([first, last, bits, 1, 2, 3])
                .collect::<Vec<u8>>()
        };
        let start = [
            0xff, SOI, 0xff, 0xc2, 0, 17, 8, 0, 8, 0, 8, 3, 1, 0x11, 0, 2, 0x11, 0, 3, 0x11, 0,
        ];
        let scans = [
            scan(&[1, 2, 3], [0, 0, 1]),
            scan(&[1], [1, 5, 2]),
            scan(&[3], [1, 63, 1]),
            scan(&[2], [1, 63, 1]),
            scan(&[1], [6, 63, 2]),
            scan(&[1], [1, 63, 0x21]),
            scan(&[1, 2, 3], [0, 0, 0x10]),
            scan(&[3], [1, 63, 0x10]),
            scan(&[2], [1, 63, 0x10]),
            scan(&[1], [1, 63, 0x10]),
        ];
        let file = |count: usize| {
            let end = [0xff, EOI].to_vec();
            let parts = scans[..count].iter().cloned().chain([end]).flatten();
            start.into_iter().chain(parts).collect::<Vec<u8>>()
        };
        assert_eq!(check_jpeg(&file(10)), Ok(()));
        for count in 1..10 {
            assert_eq!(
                check_jpeg(&file(count)),
                Err(CutOff::Scans),
                "{count} scans"
            );
        }
    }

    #[test]
    fn rows_that_are_there_are_counted() {
        let bytes = jpeg(false);
        let Err(CutOff::Rows { rows, of: 61 }) = check_jpeg(&bytes[..bytes.len() / 2 + 300]) else {
            panic!("not cut off");
        };
        assert!((8..48).contains(&rows), "{rows}");
    }

    #[test]
    fn bytes_of_other_formats_and_noise_do_no_harm() {
        assert_eq!(check_jpeg(b"\x89PNG"), Ok(()));
        assert_eq!(check_jpeg(&[0xff, SOI]), Err(CutOff::Header));
        let intact = jpeg(false);
        for i in 0..2000 {
            let mut bytes = intact.clone();
            let at = i * 31 % bytes.len();
            bytes[at] ^= 1 << (i % 8);
            let _ = check_jpeg(&bytes);
        }
    }
}
