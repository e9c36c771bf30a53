//! A partially downloaded file.

use crate::KnownEncoder;
use lsdc_files::error::{Cause, Error, Result};
use lsdc_files::write_atomically;
use serde::{Deserialize, Serialize};
use std::fs::{File, TryLockError};
use std::io::{Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

const ENDING: &str = ".part";

/// The origin of a partial download.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Origin {
    #[serde(rename = "place")]
    pub(super) url: String,
    /// Version of the file at that address. Without it, a partial download cannot be resumed.
    pub(super) version: Option<String>,
    /// Size of the full file in bytes.
    pub(super) total: Option<u64>,
}

/// The start of a file, with a record of its origin beside it. It is locked against other programs.
#[derive(Debug)]
pub(super) struct PartialDownload {
    path: PathBuf,
    file: File,
    length: u64,
    origin: Origin,
}

impl PartialDownload {
    /// Opens the partial download of the file at `url`, if there is one.
    ///
    /// # Errors
    /// The folder cannot be written, or another program uses the file.
    pub(super) fn open(folder: &Path, known: &KnownEncoder, url: &str) -> Result<Self> {
        let path = part(folder, known, url);
        let unwritable = |e| Error::write(&path, e);
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        let mut options = File::options();
        options.read(true).write(true).create(true).truncate(false);
        let file = options.open(&path).map_err(unwritable)?;
        // Some network file systems have no locks.
        if let Err(TryLockError::WouldBlock) = file.try_lock() {
            let what = format!("another program is downloading `{}`", path.display());
            return Err(Error::new(Cause::Write, what).hint("wait for it, or end it"));
        }
        let length = file.metadata().map_err(unwritable)?.len();
        let mut part = Self {
            origin: read_record(&path).unwrap_or_default(),
            path,
            file,
            length,
        };
        let usable = part.origin.url == url
            && (part.is_whole() || part.origin.version.is_some())
            && part.origin.total.is_none_or(|total| part.length <= total);
        if !usable {
            part.begin(Origin::default())?;
        }
        Ok(part)
    }

    /// Discards the data, and starts a file of another origin.
    pub(super) fn begin(&mut self, origin: Origin) -> Result<()> {
        let emptied = self.file.set_len(0).and_then(|()| self.file.rewind());
        emptied.map_err(|e| Error::write(&self.path, e))?;
        self.length = 0;
        self.origin = origin;
        write_atomically(&record(&self.path), |out| {
            Ok(serde_json::to_writer(out, &self.origin)?)
        })
    }

    pub(super) fn append(&mut self, bytes: &[u8]) -> Result<()> {
        let end = SeekFrom::Start(self.length);
        let mut write = || {
            self.file.seek(end)?;
            self.file.write_all(bytes)
        };
        write().map_err(|e| Error::write(&self.path, e))?;
        self.length += bytes.len() as u64;
        Ok(())
    }

    /// Syncs the file, which is then safe from a power failure.
    pub(super) fn sync(&self) -> Result<()> {
        let synced = self.file.sync_all();
        synced.map_err(|e| Error::write(&self.path, e))
    }

    pub(super) fn length(&self) -> u64 {
        self.length
    }

    pub(super) fn version(&self) -> Option<&str> {
        self.origin.version.as_deref()
    }

    pub(super) fn total(&self) -> Option<u64> {
        self.origin.total
    }

    pub(super) fn is_whole(&self) -> bool {
        self.origin.total == Some(self.length) && self.length > 0
    }

    /// Unlocks the file.
    pub(super) fn close(self) -> PathBuf {
        self.path
    }

    /// Removes the file and its record.
    pub(super) fn remove(self) {
        remove(&self.close());
    }
}

/// Removes all partial downloads of an encoder that no other program uses.
pub(super) fn remove_parts(folder: &Path, known: &KnownEncoder) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let is_part = name.starts_with(&format!("{}-", known.weights)) && name.ends_with(ENDING);
        let is_free = || File::open(&path).is_ok_and(|file| file.try_lock().is_ok());
        if is_part && is_free() {
            remove(&path);
        }
    }
}

/// Files that cannot be removed do no harm.
pub(super) fn remove(part: &Path) {
    let _ = std::fs::remove_file(record(part));
    let _ = std::fs::remove_file(part);
}

/// Returns the path of the partial download of the file at `url`; each address has its own.
fn part(folder: &Path, known: &KnownEncoder, url: &str) -> PathBuf {
    let hash = lsdc_rng::hash(&[url]);
    folder.join(format!("{}-{hash:016x}{ENDING}", known.weights))
}

fn record(part: &Path) -> PathBuf {
    part.with_extension("part.json")
}

/// Returns `None` without a record, or if it is damaged; the partial download is then useless.
fn read_record(part: &Path) -> Option<Origin> {
    let bytes = std::fs::read(record(part)).ok()?;
    serde_json::from_slice(&bytes).ok()
}
