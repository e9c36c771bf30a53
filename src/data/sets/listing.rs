//! The files below a folder, as paths with `/` between folders.

use crate::error::{Error, Result};
use std::path::Path;

/// All files below `root`, sorted: exactly `levels` deep, or anywhere without `levels`. Names that
/// are no Unicode are left out.
pub(super) fn files_below(root: &Path, levels: Option<usize>) -> Result<Vec<String>> {
    let mut paths = Vec::new();
    walk(root, "", levels, &mut paths)?;
    paths.sort_unstable();
    Ok(paths)
}

fn walk(root: &Path, below: &str, levels: Option<usize>, paths: &mut Vec<String>) -> Result<()> {
    let folder = root.join(below);
    for entry in std::fs::read_dir(&folder).map_err(|e| Error::read(&folder, e))? {
        let entry = entry.map_err(|e| Error::read(&folder, e))?;
        let Ok(name) = entry.file_name().into_string() else {
            continue;
        };
        let path = if below.is_empty() {
            name
        } else {
            format!("{below}/{name}")
        };
        if entry.path().is_dir() {
            if levels != Some(1) {
                walk(root, &path, levels.map(|n| n - 1), paths)?;
            }
        } else if levels.is_none_or(|n| n == 1) {
            paths.push(path);
        }
    }
    Ok(())
}
