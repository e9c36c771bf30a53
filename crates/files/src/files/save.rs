//! Writing files and folders so that none is ever half written or lost.

use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What the names of files begin and end with until they are complete.
const UNFINISHED: (&str, &str) = (".lsdc-", ".tmp");
/// No file takes so long to write.
const LONG_AGO: Duration = Duration::from_mins(10);

/// Writes `path` through a temporary file in the same folder, renamed when complete. On return the
/// file outlives a power failure.
///
/// # Errors
/// The folder cannot be written, or `fill` fails; `path` is then untouched.
pub fn write_atomically(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<()> {
    let mut file = Unfinished::create(path)?;
    let mut buffer = BufWriter::new(&mut file);
    fill(&mut buffer)
        .and_then(|()| buffer.flush())
        .map_err(|e| Error::write(path, e))?;
    drop(buffer);
    file.finish()
}

/// A file on its way to its name: a temporary one in the same folder, which goes if it is not finished.
#[derive(Debug)]
pub struct Unfinished {
    file: tempfile::NamedTempFile,
    path: PathBuf,
}

impl Unfinished {
    /// For a file that will be at `path`.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let file = temporary(parent(path)).map_err(|e| Error::write(path, e))?;
        Ok(Self {
            file,
            path: path.to_owned(),
        })
    }

    /// Puts it in its place, also of a file that is there. On return it outlives a power failure.
    ///
    /// # Errors
    /// The file cannot be written; what was there is then untouched.
    pub fn finish(self) -> Result<()> {
        let Self { file, path } = self;
        let attempt = || {
            file.as_file().sync_all()?;
            file.persist(&path).map_err(|e| e.error)?;
            sync_folder(parent(&path))
        };
        attempt().map_err(|e| Error::write(&path, e))
    }
}

impl Write for Unfinished {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Unfinished {
    fn seek(&mut self, place: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(place)
    }
}

/// Writes the folder `path` through a temporary one beside it, renamed when complete. `fill` gets the
/// temporary folder and writes its files by [`write_atomically`]. A folder that is there is replaced.
///
/// # Errors
/// The folder cannot be written, or `fill` fails.
pub fn write_folder_atomically(path: &Path, fill: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    let temporary = path.with_extension("tmp");
    let remove = |folder: &Path| match std::fs::remove_dir_all(folder) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::write(folder, e)),
        _ => Ok(()),
    };
    remove(&temporary)?;
    std::fs::create_dir_all(&temporary).map_err(|e| Error::write(&temporary, e))?;
    fill(&temporary)?;
    remove(path)?;
    std::fs::rename(&temporary, path)
        .and_then(|()| sync_folder(parent(path)))
        .map_err(|e| Error::write(path, e))
}

/// Checks that files can be written into a folder, or into the nearest folder above it that exists.
/// Nothing is left behind.
///
/// # Errors
/// They cannot.
pub fn check_writable(folder: &Path) -> Result<()> {
    let nearest = folder.ancestors().find(|path| path.exists());
    let nearest = nearest.unwrap_or(Path::new("."));
    temporary(nearest)
        .map(|_| ())
        .map_err(|e| Error::write(folder, e).hint("give another folder with -o"))
}

fn temporary(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    tempfile::Builder::new()
        .prefix(UNFINISHED.0)
        .suffix(UNFINISHED.1)
        .permissions_like_a_new_file()
        .tempfile_in(folder)
}

fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Makes the names in a folder outlive a power failure, where the file system can.
#[cfg(unix)]
fn sync_folder(folder: &Path) -> std::io::Result<()> {
    use std::io::ErrorKind::{InvalidInput, PermissionDenied, Unsupported};
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        // A folder that may be written but not listed cannot be opened.
        Err(e) if matches!(e.kind(), InvalidInput | PermissionDenied | Unsupported) => Ok(()),
        result => result,
    }
}

/// Folders cannot be opened as files here; the system keeps their names by itself.
#[cfg(not(unix))]
fn sync_folder(_: &Path) -> std::io::Result<()> {
    Ok(())
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
            let file = File::create(folder.path().join(name)).unwrap();
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
    fn a_folder_appears_when_it_is_complete() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("00000010");
        let fill = |text: &'static [u8]| {
            move |folder: &Path| write_atomically(&folder.join("a"), |out| out.write_all(text))
        };
        write_folder_atomically(&path, fill(b"old")).unwrap();
        let failed = write_folder_atomically(&path, |folder| {
            fill(b"new")(folder)?;
            Err(Error::config("full"))
        });
        assert!(failed.is_err());
        assert_eq!(std::fs::read(path.join("a")).unwrap(), b"old");
        // What the failure left is in nobody's way.
        write_folder_atomically(&path, fill(b"new")).unwrap();
        assert_eq!(std::fs::read(path.join("a")).unwrap(), b"new");
        assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_file_in_the_place_of_a_folder_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rgb.png");
        std::fs::write(&file, b"image").unwrap();
        check_writable(&folder.path().join("not/yet")).unwrap();
        assert!(check_writable(&file.join("out")).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
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
