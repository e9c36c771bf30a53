//! The files below a folder, as paths with `/` between folders.

use lsdc_files::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Returns all files below `root`, sorted: exactly `levels` deep, or at any depth if `None`. Links back to a parent folder are
/// not followed.
///
/// # Errors
/// A folder cannot be read, or a name is not valid Unicode: frames are named by text.
pub(super) fn files_below(root: &Path, levels: Option<usize>) -> Result<Vec<String>> {
    let mut paths = Vec::new();
    walk(root, "", levels, &mut Vec::new(), &mut paths)?;
    paths.sort_unstable();
    Ok(paths)
}

/// `ancestors` holds the real paths of the folders above.
fn walk(
    root: &Path,
    below: &str,
    levels: Option<usize>,
    ancestors: &mut Vec<PathBuf>,
    paths: &mut Vec<String>,
) -> Result<()> {
    let folder = root.join(below);
    let real = folder.canonicalize().map_err(|e| Error::read(&folder, e))?;
    if ancestors.contains(&real) {
        return Ok(());
    }
    ancestors.push(real);
    for entry in std::fs::read_dir(&folder).map_err(|e| Error::read(&folder, e))? {
        let entry = entry.map_err(|e| Error::read(&folder, e))?;
        let name = entry.file_name().into_string().map_err(|_| {
            Error::format(&entry.path(), "has a name that is no Unicode").hint("rename it")
        })?;
        let path = if below.is_empty() {
            name
        } else {
            format!("{below}/{name}")
        };
        if entry.path().is_dir() {
            if levels != Some(1) {
                walk(root, &path, levels.map(|n| n - 1), ancestors, paths)?;
            }
        } else if levels.is_none_or(|n| n == 1) {
            paths.push(path);
        }
    }
    ancestors.pop();
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::data::images_below;
    use std::os::unix::fs::symlink;

    #[test]
    fn links_in_a_circle_end_and_links_aside_are_followed() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        std::fs::create_dir_all(root.join("a/b")).unwrap();
        std::fs::write(root.join("a/b/c.png"), b"").unwrap();
        symlink(root, root.join("a/b/back")).unwrap();
        symlink(root.join("a"), root.join("twin")).unwrap();
        let found = files_below(root, None).unwrap();
        assert_eq!(found, ["a/b/c.png", "twin/b/c.png"]);
        assert_eq!(images_below(root).unwrap().len(), 2);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn names_that_are_no_text_are_not_left_out_silently() {
        use std::os::unix::ffi::OsStrExt as _;
        let folder = tempfile::tempdir().unwrap();
        let name = std::ffi::OsStr::from_bytes(b"caf\xe9.png");
        std::fs::write(folder.path().join(name), b"").unwrap();
        let error = files_below(folder.path(), None).unwrap_err();
        assert!(error.to_string().contains("no Unicode"), "{error}");
    }
}
