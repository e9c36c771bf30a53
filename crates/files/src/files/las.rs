//! Point clouds of laser scanners in LAS and LAZ.

use super::{PointVisitor, check_unfolded, quiet};
use crate::error::{Error, Result};
use las::raw::Header;
use laz::LazItemType;
use laz::laszip::{ChunkTable, LazItem};
use std::fs::File;
use std::io::{BufReader, Read as _, Seek as _, SeekFrom};
use std::path::Path;

/// Bytes of points in memory at a time.
const CHUNK: u64 = 1 << 20;

/// Bytes of the header of an extended record, and of the fields before its length (LAS 1.4 R15, section 2.7).
const HEAD: u64 = 60;
const BEFORE: u64 = 20;

/// Visits every point.
pub(super) fn read_las(path: &Path, visit: &mut PointVisitor<'_>) -> Result<()> {
    let damaged = |e| Error::format(path, "is no sound LAS file").because(e);
    let unreadable = |e| Error::read(path, e);
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    let size = file.get_ref().metadata().map_err(unreadable)?.len();
    let header = Header::read_from(&mut file).map_err(damaged)?;
    check_records(path, &header, &mut file, size)?;
    check_chunks(path, &header, &mut file, size)?;
    file.rewind().map_err(unreadable)?;
    let read = || -> Result<()> {
        let mut reader = las::Reader::new(file).map_err(damaged)?;
        check_layers(path, &header, reader.header(), size)?;
        let record = u64::from(reader.header().point_format().len()).max(1);
        let bytes = record.saturating_mul(reader.header().number_of_points());
        check_unfolded(path, "its points", bytes, u64::MAX)?;
        loop {
            let points = reader
                .read_points((CHUNK / record).max(1))
                .map_err(damaged)?;
            if points.is_empty() {
                return Ok(());
            }
            for ((x, y), z) in points.x().zip(points.y()).zip(points.z()) {
                visit([x, y, z]);
            }
        }
    };
    // The library panics on damaged compression records.
    quiet::catch(read).ok_or_else(|| Error::format(path, "is no sound LAS file"))?
}

/// Rejects extended records longer than the file, for which the library would allocate memory.
fn check_records(
    path: &Path,
    header: &Header,
    file: &mut BufReader<File>,
    size: u64,
) -> Result<()> {
    let Some(records) = &header.evlr else {
        return Ok(());
    };
    let mut start = records.start_of_first_evlr;
    for _ in 0..records.number_of_evlrs {
        let length = number_at(path, file, start.saturating_add(BEFORE))?;
        start = start.saturating_add(HEAD).saturating_add(length);
        if start > size {
            return Err(Error::format(
                path,
                format!("declares a record of {length} bytes, the file has {size}"),
            ));
        }
    }
    Ok(())
}

/// Reads the 8 bytes at an offset as a number.
fn number_at(path: &Path, file: &mut BufReader<File>, offset: u64) -> Result<u64> {
    let mut bytes = [0; 8];
    file.seek(SeekFrom::Start(offset))
        .and_then(|_| file.read_exact(&mut bytes))
        .map_err(|e| Error::read(path, e))?;
    Ok(u64::from_le_bytes(bytes))
}

/// Rejects a table of more chunks than the file has bytes, for which the library would allocate memory (the specification
/// of `LASzip`, "Chunk table").
fn check_chunks(path: &Path, header: &Header, file: &mut BufReader<File>, size: u64) -> Result<()> {
    /// Flag in the number of the point format.
    const COMPRESSED: u8 = 0x80;
    if header.point_data_record_format & COMPRESSED == 0 {
        return Ok(());
    }
    let start = u64::from(header.offset_to_point_data);
    let mut table = number_at(path, file, start)?;
    // Written without seeking: the offset is at the end.
    if table.cast_signed() <= start.cast_signed() {
        table = number_at(path, file, size.saturating_sub(8))?;
    }
    // The version precedes the count.
    let chunks = number_at(path, file, table)? >> 32;
    if chunks > size {
        return Err(Error::format(
            path,
            format!("declares {chunks} chunks of points but is only {size} bytes long"),
        ));
    }
    Ok(())
}

/// Rejects layers longer than the file, for which the library would allocate memory, and more points than the chunks
/// contain, for which it would read beyond them (the specification of `LAZ` 1.4, "Layered chunks": an uncompressed point,
/// the number of points, the length of each layer, the layers).
fn check_layers(path: &Path, raw: &Header, header: &las::Header, size: u64) -> Result<()> {
    let Ok(compression) = header.laz_vlr() else {
        return Ok(());
    };
    if compression.items().iter().all(|item| item.version() < 3) {
        return Ok(());
    }
    let damaged = |e| Error::format(path, "is no sound LAZ file").because(e);
    let unreadable = |e| Error::read(path, e);
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    let start = u64::from(raw.offset_to_point_data);
    file.seek(SeekFrom::Start(start)).map_err(unreadable)?;
    let table = ChunkTable::read_from(&mut file, &compression).map_err(damaged)?;
    let layers: u64 = compression.items().iter().copied().map(layers_of).sum();
    let head = compression.items_size() + 4;
    let mut offset = start + ChunkTable::OFFSET_SIZE as u64;
    let mut points = 0_u64;
    for chunk in &table {
        file.seek(SeekFrom::Start(offset + head))
            .map_err(unreadable)?;
        offset += head + 4 * layers;
        for _ in 0..layers {
            let mut length = [0; 4];
            file.read_exact(&mut length).map_err(unreadable)?;
            offset += u64::from(u32::from_le_bytes(length));
        }
        if offset > size {
            return Err(Error::format(
                path,
                format!("declares points up to byte {offset}, the file has {size}"),
            ));
        }
        points = points.saturating_add(chunk.point_count);
    }
    let declared = header.number_of_points();
    if declared > points {
        return Err(Error::format(
            path,
            format!("declares {declared} points, its chunks hold {points}"),
        ));
    }
    Ok(())
}

/// Returns the number of layers of a part of a point.
fn layers_of(item: LazItem) -> u64 {
    match item.item_type() {
        LazItemType::Point14 => 9,
        LazItemType::RGBNIR14 => 2,
        LazItemType::Byte14(count) => u64::from(count),
        _ => 1,
    }
}
