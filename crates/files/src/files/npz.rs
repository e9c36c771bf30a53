//! NumPy `.npz` archives: ZIP files of `.npy` arrays.

use super::npy::{encode, parse};
use super::{LARGEST, check_unfolded, plausible, write_atomically};
use crate::DepthMap;
use crate::doubts::{Doubt, channel_rank, doubt_of_name, quoted};
use crate::error::{Cause, Error, Result};
use crate::raster::Raster;
use std::fs::File;
use std::io::{BufReader, Cursor, Read as _};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// What depths are called in archives, the first that is there counts.
const DEPTHS: [&str; 5] = ["depth", "depths", "sparse", "points", "arr_0"];
/// What standard deviations are called.
const SIGMAS: [&str; 2] = ["sigma", "std"];

/// The depths of an archive, and their standard deviations if it has them. The array is called as in `DEPTHS`, or its
/// name says depth otherwise; a single array may be called anything.
pub(crate) fn read_npz(path: &Path) -> Result<(Raster, Option<Raster>)> {
    let damaged =
        |e: zip::result::ZipError| Error::format(path, "is no sound npz archive").because(e);
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let size = file.metadata().map_err(|e| Error::read(path, e))?.len();
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(damaged)?;
    let names: Vec<String> = archive
        .file_names()
        .filter_map(|name| Some(name.ok()?.strip_suffix(".npy")?.to_owned()))
        .collect();
    let find = |known: &[&str]| {
        let mut known = known.iter();
        known.find_map(|name| names.iter().find(|n| n == name).cloned())
    };
    let only = || names.first().filter(|_| names.len() == 1).cloned();
    let named = || {
        let ranked = names
            .iter()
            .filter_map(|name| Some((channel_rank(name)?, name)));
        ranked.min().map(|(_, name)| name.clone())
    };
    let depths = find(&DEPTHS).or_else(named).or_else(only).ok_or_else(|| {
        let what = format!("has no array of depths. Arrays: {}", quoted(&names));
        Error::format(path, what).hint("save the depths as `depth`, their deviations as `sigma`")
    })?;
    let mut read = |name: &str| -> Result<Raster> {
        let entry = archive.by_name(&format!("{name}.npy")).map_err(damaged)?;
        let length = entry.size();
        if !plausible(length, size) {
            return Err(Error::format(
                path,
                format!("`{name}` declares {length} bytes, the file has {size}"),
            ));
        }
        check_unfolded(path, &format!("the values of `{name}`"), length, LARGEST)?;
        let mut bytes = Vec::new();
        entry
            .take(length)
            .read_to_end(&mut bytes)
            .map_err(|e| damaged(e.into()))?;
        parse(path, &bytes)
    };
    let mut array = read(&depths)?;
    let deviations = find(&SIGMAS);
    let sigma = deviations.as_deref().map(&mut read).transpose()?;
    let doubt = doubt_of_name(&depths, || format!("an array called `{depths}`"));
    array.doubts.extend(doubt);
    let used = |name: &String| *name == depths || deviations.as_ref() == Some(name);
    let others: Vec<String> = names.iter().filter(|name| !used(name)).cloned().collect();
    if !others.is_empty() {
        array.doubts.push(Doubt::Chosen {
            what: "array",
            name: format!("`{depths}`"),
            others,
        });
    }
    Ok((array, sigma))
}

/// Writes maps of one size by their names, as float32 of shape `(height, width)`, compressed.
///
/// # Errors
/// The file cannot be written.
pub fn write_npz(path: &Path, maps: &[(&str, &DepthMap)]) -> Result<()> {
    let bytes = encode_npz(maps)?;
    write_atomically(path, |out| out.write_all(&bytes))
}

/// The bytes of the file that [`write_npz`] writes.
///
/// # Errors
/// Two maps of one name.
pub fn encode_npz(maps: &[(&str, &DepthMap)]) -> Result<Vec<u8>> {
    let archive = || -> std::io::Result<Vec<u8>> {
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, map) in maps {
            let options =
                SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
            archive.start_file(format!("{name}.npy"), options)?;
            encode(&mut archive, map)?;
        }
        Ok(archive.finish()?.into_inner())
    };
    archive().map_err(|e| Error::new(Cause::Write, "cannot make an npz archive").because(e))
}
