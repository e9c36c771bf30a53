//! Writing files so that none is ever half written.

use crate::error::{Error, Result};
use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::Duration;

/// What the names of files begin and end with until they are complete.
const UNFINISHED: (&str, &str) = (".lsdc-", ".tmp");
/// No file takes so long to write.
const LONG_AGO: Duration = Duration::from_mins(10);

/// Writes `path` through a temporary file in the same folder, renamed when complete.
///
/// # Errors
/// The folder cannot be written, or `fill` fails; `path` is then untouched.
pub fn write_atomically(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<()> {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let attempt = || {
        let mut file = tempfile::Builder::new()
            .prefix(UNFINISHED.0)
            .suffix(UNFINISHED.1)
            .permissions_like_a_new_file()
            .tempfile_in(folder)?;
        let mut buffer = BufWriter::new(file.as_file_mut());
        fill(&mut buffer)?;
        buffer.flush()?;
        drop(buffer);
        file.persist(path).map_err(|e| e.error)?;
        Ok(())
    };
    attempt().map_err(|e| Error::write(path, e))
}

/// Removes from a folder what killed programs have left unfinished. What cannot be removed stays.
pub fn remove_leftovers(folder: &Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let unfinished = name.starts_with(UNFINISHED.0) && name.ends_with(UNFINISHED.1);
        let written = entry.metadata().and_then(|found| found.modified());
        let old = || {
            let age = written.ok().and_then(|time| time.elapsed().ok());
            age.is_some_and(|age| age > LONG_AGO)
        };
        if unfinished && old() {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// A temporary file is private by default; an output should be as readable as any other file.
trait LikeANewFile {
    fn permissions_like_a_new_file(&mut self) -> &mut Self;
}

impl LikeANewFile for tempfile::Builder<'_, '_> {
    #[cfg(unix)]
    fn permissions_like_a_new_file(&mut self) -> &mut Self {
        use std::os::unix::fs::PermissionsExt as _;
        self.permissions(std::fs::Permissions::from_mode(0o666))
    }

    #[cfg(not(unix))]
    fn permissions_like_a_new_file(&mut self) -> &mut Self {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_left_long_ago_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let names = [".lsdc-old.tmp", ".lsdc-new.tmp", "old.npy"];
        for name in names {
            let file = std::fs::File::create(folder.path().join(name)).unwrap();
            if name.contains("old") {
                let before = std::time::SystemTime::now() - 2 * LONG_AGO;
                file.set_modified(before).unwrap();
            }
        }
        remove_leftovers(folder.path());
        let left = names.map(|name| folder.path().join(name).exists());
        assert_eq!(left, [false, true, true]);
    }

    #[test]
    fn a_failure_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.bin");
        std::fs::write(&path, b"old").unwrap();
        let result = write_atomically(&path, |w| {
            w.write_all(b"new")?;
            Err(std::io::Error::other("full"))
        });
        assert!(result.is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        write_atomically(&path, |w| w.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
    }
}
