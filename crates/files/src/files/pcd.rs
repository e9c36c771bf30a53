//! Point clouds in PCD, the format of the Point Cloud Library: text, binary, and compressed.

use super::{LARGEST, PointVisitor, check_unfolded, plausible};
use crate::error::{Error, Result};
use pcd_rs::{DataKind, DynReader, DynRecord, Field, PcdMeta};
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read as _, Seek as _, SeekFrom};
use std::path::Path;

/// Visits every point.
pub(super) fn read_pcd(path: &Path, visit: &mut PointVisitor<'_>) -> Result<()> {
    let damaged = |e: pcd_rs::Error| Error::format(path, "is no sound PCD file").because(e);
    let unreadable = |e| Error::read(path, e);
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    let size = file.get_ref().metadata().map_err(unreadable)?.len();
    let header = read_header(&mut file).map_err(unreadable)?;
    let start = file.stream_position().map_err(unreadable)?;
    let meta = PcdMeta::from_reader(&header[..]).map_err(damaged)?;
    check(path, &meta, &mut file, size)?;
    let position = ["x", "y", "z"].map(|axis| {
        // Records omit padding.
        let mut fields = meta.field_defs.iter().filter(|field| !field.is_padding());
        fields.position(|field| field.name == axis)
    });
    let [Some(x), Some(y), Some(z)] = position else {
        return Err(Error::format(path, "has points without x, y and z"));
    };
    file.seek(SeekFrom::Start(start)).map_err(unreadable)?;
    let file = Cursor::new(header).chain(file);
    for record in DynReader::from_reader(file).map_err(damaged)? {
        let DynRecord(fields) = record.map_err(damaged)?;
        visit([x, y, z].map(|field| fields.get(field).map_or(f64::NAN, first)));
    }
    Ok(())
}

/// Returns the header without fields of count 0, which take no bytes: `pcl_ros` writes them as padding of Ouster scans. The
/// library would read one number for each.
fn read_header(file: &mut impl BufRead) -> std::io::Result<Vec<u8>> {
    /// Header lines with a word for each field.
    const BY_FIELD: [&[u8]; 5] = [b"FIELDS", b"COLUMNS", b"SIZE", b"TYPE", b"COUNT"];
    /// Largest header. Headers have a dozen lines; anything else is not PCD, which is detected later.
    const MOST: u64 = 1 << 16;
    let mut lines: Vec<Vec<u8>> = Vec::new();
    let mut read = 0;
    while read < MOST {
        let mut line = Vec::new();
        let length = file.take(MOST).read_until(b'\n', &mut line)?;
        read += length as u64;
        let last = length == 0 || line.trim_ascii_start().starts_with(b"DATA");
        lines.push(line);
        if last {
            break;
        }
    }
    let words = |line: &[u8]| -> Vec<Vec<u8>> {
        let words = line
            .split(u8::is_ascii_whitespace)
            .filter(|word| !word.is_empty());
        words.map(<[u8]>::to_vec).collect()
    };
    let named = |line: &[u8], name: &[u8]| words(line).first().is_some_and(|word| word == name);
    let counts = lines
        .iter()
        .find(|line| named(line, b"COUNT"))
        .map(|line| words(line));
    let empty = |field: usize| {
        counts
            .as_ref()
            .and_then(|counts| counts.get(field))
            .is_some_and(|count| count == b"0")
    };
    let mut header = Vec::new();
    for line in &lines {
        if BY_FIELD.iter().any(|name| named(line, name)) {
            let words = words(line);
            let nonempty = words.iter().enumerate().filter(|(field, _)| !empty(*field));
            let nonempty: Vec<&[u8]> = nonempty.map(|(_, word)| &word[..]).collect();
            header.extend(nonempty.join(&b' '));
            header.push(b'\n');
        } else {
            header.extend(line);
        }
    }
    Ok(header)
}

/// Rejects declared sizes that the file cannot have, which the library would trust.
fn check(path: &Path, meta: &PcdMeta, data: &mut impl BufRead, size: u64) -> Result<()> {
    let declared = || {
        let fields = meta.field_defs.iter();
        let mut bytes =
            fields.map(|field| (field.kind.byte_size() as u64).checked_mul(field.count));
        let record = bytes.try_fold(0_u64, |sum, bytes| sum.checked_add(bytes?))?;
        record.checked_mul(meta.num_points)
    };
    let wrong = |what: String| Err(Error::format(path, what));
    let promised = |bytes: u64| wrong(format!("declares {bytes} bytes, the file has {size}"));
    let Some(bytes) = declared() else {
        return promised(u64::MAX);
    };
    match meta.data {
        // A number takes at least a digit and a space.
        DataKind::Ascii if bytes > size.saturating_mul(4) => promised(bytes),
        DataKind::Binary if bytes > size => promised(bytes),
        DataKind::BinaryCompressed => {
            let mut lengths = [0; 8];
            std::io::Read::read_exact(data, &mut lengths).map_err(|e| Error::read(path, e))?;
            let [packed, whole] = [&lengths[..4], &lengths[4..]].map(|bytes| {
                bytes
                    .iter()
                    .rev()
                    .fold(0_u64, |value, &byte| value << 8 | u64::from(byte))
            });
            if packed > size || !plausible(whole, size) {
                return promised(packed.max(whole));
            }
            check_unfolded(path, "its points", whole, LARGEST)?;
            if whole != bytes {
                return wrong(format!(
                    "holds {whole} bytes of points, its header says {bytes}"
                ));
            }
            Ok(())
        }
        _ => Ok(()),
    }
}

fn first(field: &Field) -> f64 {
    macro_rules! first {
        ($($type:ident)*) => {
            match field {
                $(Field::$type(values) => values.first().map(|&v| v as f64),)*
                Field::F64(values) => values.first().copied(),
            }
        };
    }
    first!(I8 I16 I32 I64 U8 U16 U32 U64 F32).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<Vec<[f64; 3]>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.pcd");
        std::fs::write(&path, bytes).unwrap();
        let mut points = Vec::new();
        read_pcd(&path, &mut |point| points.push(point)).map(|()| points)
    }

    #[test]
    fn fields_that_count_zero_take_no_bytes() {
        let head = "# .PCD v0.7\nVERSION .7\nFIELDS x _ y z _ ring _\nSIZE 4 1 4 4 1 2 1\nTYPE F U F F U U U\n\
            COUNT 1 0 1 1 3 1 0\nWIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA binary\n";
        let point = |first: f32| {
            let position = [first, first + 1.0, first + 2.0].map(f32::to_le_bytes);
            [position.as_flattened(), &[9, 9, 9, 7, 0]].concat()
        };
        let bytes = [head.as_bytes(), &point(1.0), &point(10.0)].concat();
        assert_eq!(read(&bytes).unwrap(), [[1.0, 2.0, 3.0], [10.0, 11.0, 12.0]]);
        assert!(read(&bytes[..bytes.len() - 4]).is_err(), "cut off");
    }

    #[test]
    fn headers_of_other_programs_are_read() {
        let head = "VERSION 0.7\r\nCOLUMNS x y z\r\nSIZE 8 8 8\r\nTYPE F F F\r\nWIDTH 1\r\nHEIGHT 1\r\nPOINTS 1\r\n\
            DATA ascii\r\n1.5 nan -2\r\n";
        let found = read(head.as_bytes()).unwrap();
        assert!(found[0][0] == 1.5 && found[0][1].is_nan() && found[0][2] == -2.0);
        assert!(read(b"").is_err() && read(b"VERSION 0.7\n").is_err());
    }
}
