//! NumPy `.npz` archives.

use super::npy::parse;
use super::{Array, plausible, write_atomically};
use crate::data::DepthMap;
use crate::error::{Cause, Error, Result};
use npyz::WriterBuilder as _;
use npyz::npz::{NpzArchive, NpzWriter};
use std::io::{Cursor, Read as _};
use std::path::Path;

/// What depths are called in archives, the first that is there counts.
const DEPTHS: [&str; 5] = ["depth", "depths", "sparse", "points", "arr_0"];
/// What standard deviations are called.
const SIGMAS: [&str; 2] = ["sigma", "std"];

/// The depths of an archive, and their standard deviations if it has them. An archive of a single
/// array may call it anything.
pub(crate) fn read_npz(path: &Path) -> Result<(Array, Option<Array>)> {
    let damaged = |e: std::io::Error| Error::format(path, "is no sound npz archive").because(e);
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    let size = bytes.len() as u64;
    let mut archive = NpzArchive::new(Cursor::new(bytes)).map_err(damaged)?;
    let names: Vec<String> = archive.array_names().map(str::to_owned).collect();
    let find = |known: &[&str]| {
        let mut known = known.iter();
        known.find_map(|name| names.iter().find(|n| n == name).cloned())
    };
    let only = || names.first().filter(|_| names.len() == 1).cloned();
    let depths = find(&DEPTHS).or_else(only).ok_or_else(|| {
        Error::format(path, format!("holds {names:?}, none of which says depth"))
            .hint("save the depths as `depth`, their deviations as `sigma`")
    })?;
    let mut read = |name: &str| -> Result<Array> {
        let file = npyz::npz::file_name_from_array_name(name);
        let entry = archive.zip_archive().by_name(&file);
        let entry = entry.map_err(|e| damaged(e.into()))?;
        let length = entry.size();
        if !plausible(length, size) {
            return Err(Error::format(
                path,
                format!("`{name}` declares {length} bytes, the file has {size}"),
            ));
        }
        let mut bytes = Vec::new();
        entry
            .take(length)
            .read_to_end(&mut bytes)
            .map_err(damaged)?;
        parse(path, &bytes)
    };
    let array = read(&depths)?;
    let sigma = find(&SIGMAS).map(|name| read(&name)).transpose()?;
    Ok((array, sigma))
}

/// Writes maps of one size by their names, as float32 of shape `(height, width)`, compressed.
///
/// # Errors
/// The file cannot be written.
pub fn write_npz(path: &Path, maps: &[(&str, &DepthMap)]) -> Result<()> {
    let mut bytes = Cursor::new(Vec::new());
    let encode = || -> std::io::Result<()> {
        let mut archive = NpzWriter::new(&mut bytes);
        for (name, map) in maps {
            let shape = [map.height() as u64, map.width() as u64];
            let mut array = archive
                .array(name, npyz::zip::write::FileOptions::default())?
                .default_dtype()
                .shape(&shape)
                .begin_nd()?;
            array.extend(map.values().iter().copied())?;
            array.finish()?;
        }
        Ok(())
    };
    let mut encode = encode;
    encode().map_err(|e| {
        Error::new(Cause::Write, format!("cannot encode `{}`", path.display())).because(e)
    })?;
    write_atomically(path, |out| out.write_all(bytes.get_ref()))
}
