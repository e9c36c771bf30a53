//! Journal of measured frames, one record per line, so that an interrupted evaluation can be resumed.

use crate::report::{FrameRecord, Heading};
use lsdc_files::error::{Error, Result};
use lsdc_weights::provenance::differences;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

/// Records by frame and seed.
type Records = BTreeMap<(String, u64), FrameRecord>;

/// A journal file, or a disabled journal. The first line of the file records the inputs of the results. The file is locked
/// while it is open.
#[derive(Debug, Default)]
pub struct Journal {
    file: Option<(PathBuf, File)>,
    records: Records,
}

impl Journal {
    /// Creates a journal that stores nothing.
    pub fn disabled() -> Self {
        Self::default()
    }

    /// Opens or creates the journal at `path`. Existing records are reused only if `heading` and `place` match its first line.
    /// `place` records settings of this machine: the location of the frames, the device. A truncated last line is dropped.
    ///
    /// # Errors
    /// The file cannot be read or written, is open in another evaluation, or belongs to an evaluation with other settings.
    pub fn open(path: &Path, heading: &Heading, place: &Value) -> Result<Self> {
        let (mut file, bytes) = open_locked(path)?;
        let made_from = json!({ "heading": heading, "place": place });
        let end = bytes.iter().rposition(|&byte| byte == b'\n');
        let complete_length = end.map_or(0, |end| end + 1);
        let text = String::from_utf8_lossy(&bytes[..complete_length]);
        let mut lines = text.lines();
        let mut records = Records::new();
        let write = |e: std::io::Error| Error::write(path, e);
        if let Some(first) = lines.next() {
            check(path, first, &made_from)?;
            for record in lines.filter_map(|line| serde_json::from_str::<FrameRecord>(line).ok()) {
                records.insert((record.frame.clone(), record.seed), record);
            }
            file.set_len(complete_length as u64).map_err(write)?;
            file.seek(SeekFrom::End(0)).map_err(write)?;
        } else {
            file.set_len(0).map_err(write)?;
            file.rewind().map_err(write)?;
            let line = format!("{made_from}\n");
            file.write_all(line.as_bytes()).map_err(write)?;
        }
        file.sync_all().map_err(write)?;
        Ok(Self {
            file: Some((path.to_owned(), file)),
            records,
        })
    }

    /// Removes all records of a journal, if it exists.
    ///
    /// # Errors
    /// It cannot be written, or is open in another evaluation.
    pub fn clear(path: &Path) -> Result<()> {
        if !path.exists() {
            return Ok(());
        }
        let (file, _) = open_locked(path)?;
        file.set_len(0).map_err(|e| Error::write(path, e))
    }

    /// Returns the number of records that existed when the journal was opened.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Returns whether no records existed when the journal was opened.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Takes the records that existed when the journal was opened.
    pub(super) fn take_records(&mut self) -> Records {
        std::mem::take(&mut self.records)
    }

    pub(super) fn add(&mut self, record: &FrameRecord) -> Result<()> {
        let Some((path, file)) = &mut self.file else {
            return Ok(());
        };
        let write = |e: std::io::Error| Error::write(path, e);
        let mut line = serde_json::to_vec(record).map_err(|e| write(e.into()))?;
        line.push(b'\n');
        file.write_all(&line).map_err(write)
    }
}

/// Opens a file, locks it until it is closed, and reads it.
fn open_locked(path: &Path) -> Result<(File, Vec<u8>)> {
    let mut options = OpenOptions::new();
    let mut file = options
        .create(true)
        .read(true)
        .write(true)
        .truncate(false)
        .open(path)
        .map_err(|e| Error::write(path, e))?;
    if !file.metadata().is_ok_and(|found| found.is_file()) {
        return Err(Error::write(path, ErrorKind::InvalidInput.into())
            .hint("a journal is a regular file: choose another folder"));
    }
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => {
            return Err(Error::config(format!(
                "another evaluation is writing to `{}`",
                path.display()
            ))
            .hint("wait until it has ended, or choose another folder"));
        }
        // Some file systems have no locks.
        Ok(()) | Err(TryLockError::Error(_)) => {}
    }
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)
        .map_err(|e| Error::read(path, e))?;
    Ok((file, bytes))
}

/// Checks that the first line of a journal matches.
fn check(path: &Path, first: &str, made_from: &Value) -> Result<()> {
    /// Limit of differences listed in the message.
    const LISTED: usize = 3;
    // A line that is not JSON differs as a whole. Numbers are compared after a round trip.
    let before: Value = serde_json::from_str(first).unwrap_or_default();
    let now: Value = serde_json::from_str(&made_from.to_string()).unwrap_or_default();
    let found = differences(&before, &now);
    if found.is_empty() {
        return Ok(());
    }
    let mut words = found[..found.len().min(LISTED)].join("; ");
    if found.len() > LISTED {
        words = format!("{words}; and {} more", found.len() - LISTED);
    }
    Err(Error::config(format!(
        "`{}` belongs to another evaluation: {words}",
        path.display()
    ))
    .hint("choose another folder, or give --force to begin anew"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Environment;

    fn record(frame: &str) -> FrameRecord {
        FrameRecord {
            frame: frame.into(),
            seed: 3,
            points: 5,
            place: Environment::Indoor,
            scene: None,
            outcomes: Vec::new(),
            files: Vec::new(),
        }
    }

    fn open(path: &Path, heading: &Heading) -> Result<Journal> {
        Journal::open(path, heading, &json!({ "root": "/data" }))
    }

    #[test]
    fn a_torn_line_is_dropped_and_the_rest_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.jsonl");
        let heading = Heading::default();
        let mut journal = open(&path, &heading).unwrap();
        journal.add(&record("a")).unwrap();
        journal.add(&record("b")).unwrap();
        drop(journal);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 4]).unwrap();

        let mut journal = open(&path, &heading).unwrap();
        assert_eq!(journal.len(), 1);
        let records = journal.take_records();
        assert_eq!(records[&("a".to_owned(), 3)], record("a"));
        journal.add(&record("b")).unwrap();
        drop(journal);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }

    #[test]
    fn records_made_from_something_else_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.jsonl");
        let heading = Heading {
            made_from: json!({ "fit": { "joint": { "cosines": 2.5 } } }),
            ..Heading::default()
        };
        drop(open(&path, &heading).unwrap());
        drop(open(&path, &heading).unwrap());
        let other = Heading {
            made_from: json!({ "fit": { "joint": { "cosines": 0.0 } } }),
            ..heading.clone()
        };
        let error = open(&path, &other).unwrap_err().to_string();
        assert!(error.contains("fit.joint.cosines: 2.5, now 0.0"), "{error}");
        let error = Journal::open(&path, &heading, &json!({ "root": "/other" }));
        let error = error.unwrap_err().to_string();
        assert!(error.contains("place.root"), "{error}");
        std::fs::write(&path, "nothing that is known\n").unwrap();
        assert!(open(&path, &heading).is_err());
        Journal::clear(&path).unwrap();
        assert!(open(&path, &other).unwrap().is_empty());
    }

    #[test]
    fn two_evaluations_do_not_write_to_one_journal() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.jsonl");
        let heading = Heading::default();
        let mut first = open(&path, &heading).unwrap();
        first.add(&record("a")).unwrap();
        let error = open(&path, &heading).unwrap_err();
        assert!(error.to_string().contains("another evaluation is writing"));
        assert!(Journal::clear(&path).is_err());
        first.add(&record("b")).unwrap();
        drop(first);
        assert_eq!(open(&path, &heading).unwrap().len(), 2);
    }
}
