//! Clouds in PCD, the format of the Point Cloud Library: text, binary, and compressed.

use super::{LARGEST, Visit, check_unfolded, plausible};
use crate::error::{Error, Result};
use pcd_rs::{DataKind, DynReader, DynRecord, Field, PcdMeta};
use std::fs::File;
use std::io::{BufRead, BufReader, Seek as _};
use std::path::Path;

/// Visits every point.
pub(super) fn read_pcd(path: &Path, visit: &mut Visit<'_>) -> Result<()> {
    let damaged = |e: pcd_rs::Error| Error::format(path, "is no sound PCD file").because(e);
    let unreadable = |e| Error::read(path, e);
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    let size = file.get_ref().metadata().map_err(unreadable)?.len();
    let meta = PcdMeta::from_reader(&mut file).map_err(damaged)?;
    check(path, &meta, &mut file, size)?;
    let place = ["x", "y", "z"].map(|axis| {
        // Padding is not kept in records.
        let mut fields = meta.field_defs.iter().filter(|field| !field.is_padding());
        fields.position(|field| field.name == axis)
    });
    let [Some(x), Some(y), Some(z)] = place else {
        return Err(Error::format(path, "has points without x, y and z"));
    };
    file.rewind().map_err(unreadable)?;
    for record in DynReader::from_reader(file).map_err(damaged)? {
        let DynRecord(fields) = record.map_err(damaged)?;
        visit([x, y, z].map(|field| fields.get(field).map_or(f64::NAN, first)));
    }
    Ok(())
}

/// Refuses what the library would believe: sizes that the file cannot have.
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
        // A number takes a digit and a blank at least.
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
    let value = match field {
        Field::I8(values) => values.first().map(|&v| v as f64),
        Field::I16(values) => values.first().map(|&v| v as f64),
        Field::I32(values) => values.first().map(|&v| v as f64),
        Field::I64(values) => values.first().map(|&v| v as f64),
        Field::U8(values) => values.first().map(|&v| v as f64),
        Field::U16(values) => values.first().map(|&v| v as f64),
        Field::U32(values) => values.first().map(|&v| v as f64),
        Field::U64(values) => values.first().map(|&v| v as f64),
        Field::F32(values) => values.first().map(|&v| v as f64),
        Field::F64(values) => values.first().copied(),
    };
    value.unwrap_or(f64::NAN)
}
