//! Files of `PyTorch`: an archive of a pickle, which describes the tensors, and of their values.

use super::pickle::{Value, run};
use super::stored::StoredTensor;
use lsdc_core::weights::Tensor;
use lsdc_files::error::{Error, Result};
use std::collections::BTreeMap;
use std::io::{Cursor, Read as _};
use std::path::Path;
use std::rc::Rc;
use zip::ZipArchive;

/// Size limit of a description; a few hundred tensors need less.
const MAX_BYTES: u64 = 1 << 26;

/// Reads the tensors of a file by their names.
///
/// # Errors
/// The file is damaged, or does not describe tensors by name.
pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<BTreeMap<String, Tensor>> {
    let damaged =
        |e: zip::result::ZipError| Error::format(path, "is no sound archive of PyTorch").because(e);
    let mut archive = ZipArchive::new(Cursor::new(bytes)).map_err(damaged)?;
    let folder = archive
        .file_names()
        .find_map(|name| Some(name.ok()?.strip_suffix("data.pkl")?.to_owned()))
        .ok_or_else(|| Error::format(path, "is an archive without `data.pkl`"))?;
    let mut entry = |name: &str, limit: u64| -> Result<Vec<u8>> {
        let entry = archive
            .by_name(&format!("{folder}{name}"))
            .map_err(damaged)?;
        let length = entry.size();
        if length > limit {
            let what = format!("`{name}` declares {length} bytes, more than {limit}");
            return Err(Error::format(path, what));
        }
        let mut bytes = Vec::new();
        let read = entry.take(limit).read_to_end(&mut bytes);
        read.map_err(|e| damaged(e.into()))?;
        Ok(bytes)
    };
    let program = entry("data.pkl", MAX_BYTES)?;
    let found = run(&program).map_err(|what| Error::format(path, what))?;
    let mut stored = Vec::new();
    collect(found, &mut stored);
    // Storages are uncompressed, and few tensors share one, so memory is bounded by the file, whatever is declared.
    let (mut file_bytes_left, mut tensor_bytes_left) = (bytes.len() as u64, 2 * bytes.len());
    let mut storages: BTreeMap<Rc<str>, Vec<u8>> = BTreeMap::new();
    let mut tensors = BTreeMap::new();
    for (name, layout) in stored {
        let Some(kind) = layout.kind else { continue };
        if !storages.contains_key(&layout.storage) {
            let values = entry(&format!("data/{}", layout.storage), file_bytes_left)?;
            file_bytes_left -= values.len() as u64;
            storages.insert(layout.storage.clone(), values);
        }
        let values = storages.get(&layout.storage).map_or(&[][..], Vec::as_slice);
        let bytes_after = layout
            .bytes(kind)
            .and_then(|size| tensor_bytes_left.checked_sub(size));
        tensor_bytes_left = bytes_after.ok_or_else(|| {
            Error::format(
                path,
                format!("`{name}` declares more values than the file has"),
            )
        })?;
        let tensor = layout.tensor(kind, values).ok_or_else(|| {
            Error::format(path, format!("`{name}` has fewer values than it should"))
        })?;
        tensors.insert(name, tensor);
    }
    Ok(tensors)
}

/// Collects the tensors of a dictionary, and of nested ones that training files have.
pub(super) fn collect(value: Value, found: &mut Vec<(String, Rc<StoredTensor>)>) {
    let Value::Dict(entries) = value else { return };
    for (key, value) in entries {
        match (key, value) {
            (Value::Text(name), Value::Tensor(tensor)) => found.push((name.to_string(), tensor)),
            (Value::Text(name), inner @ Value::Dict(_))
                if ["state_dict", "model", "teacher"].contains(&&*name) =>
            {
                collect(inner, found);
            }
            _ => {}
        }
    }
}
