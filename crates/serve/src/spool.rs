//! Folders for uploads, which are removed with their request, or by the next service if this one was killed.

use std::fs::{self, File};
use std::io;
use std::path::Path;
use tempfile::TempDir;

/// Prefix of the folder name, in the temporary folder of the system.
const PREFIX: &str = "lsdc-upload-";
/// A file of a folder that is locked for as long as its service lives: the system releases the lock of a killed one.
const LOCK: &str = ".lock";

/// The folder of one upload.
pub(crate) struct Spool {
    folder: TempDir,
    _lock: File,
}

impl Spool {
    /// Creates a folder.
    ///
    /// # Errors
    /// The temporary folder cannot be written to.
    pub(crate) fn new() -> io::Result<Self> {
        Self::within(&std::env::temp_dir())
    }

    fn within(parent: &Path) -> io::Result<Self> {
        let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(parent)?;
        let unlocked = folder.path().join(".lock.new");
        let lock = File::create_new(&unlocked)?;
        // The lock is taken before the file has its name: one that can be found is locked. Where files cannot be
        // locked there is none, and no other service removes the folder.
        if lock.lock().is_ok() {
            fs::rename(&unlocked, folder.path().join(LOCK))?;
        }
        Ok(Self {
            folder,
            _lock: lock,
        })
    }

    /// Path of the folder.
    pub(crate) fn path(&self) -> &Path {
        self.folder.path()
    }
}

/// Removes the folders that services left behind when they were killed. Those of services that run are locked.
pub(crate) fn sweep() {
    sweep_within(&std::env::temp_dir());
}

fn sweep_within(parent: &Path) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let named = entry.file_name().to_string_lossy().starts_with(PREFIX);
        if named && is_abandoned(&entry.path()) {
            // Another service that starts may do the same.
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// Whether a folder has a lock that nobody holds. Links are not followed.
fn is_abandoned(folder: &Path) -> bool {
    let lock = folder.join(LOCK);
    let is_plain = |path: &Path, what: fn(&fs::Metadata) -> bool| {
        fs::symlink_metadata(path).is_ok_and(|found| what(&found))
    };
    is_plain(folder, fs::Metadata::is_dir)
        && is_plain(&lock, fs::Metadata::is_file)
        && File::open(&lock).is_ok_and(|lock| lock.try_lock().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates what a killed process leaves behind: its folder, without the lock.
    fn left_by(killed: Spool) -> std::path::PathBuf {
        killed.folder.keep()
    }

    #[test]
    fn only_folders_without_a_living_owner_are_swept() {
        let parent = tempfile::tempdir().unwrap();
        let alive = Spool::within(parent.path()).unwrap();
        let killed = Spool::within(parent.path()).unwrap();
        fs::write(killed.path().join("image.png"), "of somebody").unwrap();
        let left = left_by(killed);
        // Folders that are no uploads, or do not have their lock yet.
        let other = parent.path().join("lsdc-upload-new");
        fs::create_dir(&other).unwrap();
        fs::write(parent.path().join("lsdc-upload-file"), "").unwrap();
        sweep_within(parent.path());
        assert!(!left.exists());
        assert!(alive.path().exists() && other.exists());
        let path = alive.path().to_owned();
        drop(alive);
        assert!(!path.exists());
    }

    #[cfg(unix)]
    #[test]
    fn links_are_not_followed() {
        let parent = tempfile::tempdir().unwrap();
        let elsewhere = tempfile::tempdir().unwrap();
        fs::write(elsewhere.path().join(LOCK), "").unwrap();
        let link = parent.path().join("lsdc-upload-link");
        std::os::unix::fs::symlink(elsewhere.path(), &link).unwrap();
        let folder = parent.path().join("lsdc-upload-real");
        fs::create_dir(&folder).unwrap();
        std::os::unix::fs::symlink(elsewhere.path().join(LOCK), folder.join(LOCK)).unwrap();
        sweep_within(parent.path());
        assert!(elsewhere.path().join(LOCK).exists() && folder.exists());
    }
}
