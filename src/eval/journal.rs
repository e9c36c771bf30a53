//! What has been measured, one line a record, so that an evaluation can go on where it stopped.

use crate::data::write_atomically;
use crate::error::{Error, Result};
use crate::report::{Heading, Record};
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Records by frame and seed.
type Records = BTreeMap<(String, u64), Record>;

/// A file of records under a heading, or nothing.
#[derive(Debug, Default)]
pub struct Journal {
    file: Option<(PathBuf, File)>,
    records: Records,
}

impl Journal {
    /// Keeps nothing.
    pub fn none() -> Self {
        Self::default()
    }

    /// Opens the journal at `path`, or begins it. A line that was cut off when the last evaluation
    /// ended is dropped.
    ///
    /// # Errors
    /// The file cannot be read or written, or belongs to another evaluation.
    pub fn open(path: &Path, heading: &Heading) -> Result<Self> {
        let encode = |e: serde_json::Error| Error::write(path, e.into());
        let first = serde_json::to_string(heading).map_err(encode)?;
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(e) => return Err(Error::read(path, e)),
        };
        let mut lines = text
            .split_inclusive('\n')
            .filter(|line| line.ends_with('\n'));
        let mut kept = vec![first.clone()];
        let mut records = Records::new();
        if let Some(line) = lines.next() {
            if line.trim_end() != first {
                return Err(Error::config(format!(
                    "`{}` belongs to another evaluation",
                    path.display()
                ))
                .hint("choose another folder, or give --force to begin anew"));
            }
            for line in lines {
                let Ok(record) = serde_json::from_str::<Record>(line) else {
                    continue;
                };
                kept.push(line.trim_end().to_owned());
                records.insert((record.frame.clone(), record.seed), record);
            }
        }
        write_atomically(path, |out| {
            kept.iter().try_for_each(|line| writeln!(out, "{line}"))
        })?;
        let file = OpenOptions::new()
            .append(true)
            .open(path)
            .map_err(|e| Error::write(path, e))?;
        Ok(Self {
            file: Some((path.to_owned(), file)),
            records,
        })
    }

    /// The records that were there when the journal was opened.
    pub(super) fn take(&mut self) -> Records {
        std::mem::take(&mut self.records)
    }

    pub(super) fn add(&mut self, record: &Record) -> Result<()> {
        let Some((path, file)) = &mut self.file else {
            return Ok(());
        };
        let write = |e: std::io::Error| Error::write(path, e);
        let mut line = serde_json::to_vec(record).map_err(|e| write(e.into()))?;
        line.push(b'\n');
        file.write_all(&line).map_err(write)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Place;

    #[test]
    fn a_torn_line_is_dropped_and_the_rest_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.jsonl");
        let heading = Heading::default();
        let record = |frame: &str| Record {
            frame: frame.into(),
            seed: 3,
            points: 5,
            place: Place::Indoor,
            outcomes: Vec::new(),
        };
        let mut journal = Journal::open(&path, &heading).unwrap();
        journal.add(&record("a")).unwrap();
        journal.add(&record("b")).unwrap();
        drop(journal);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 4]).unwrap();

        let mut journal = Journal::open(&path, &heading).unwrap();
        let records = journal.take();
        assert_eq!(records.len(), 1);
        assert_eq!(records[&("a".to_owned(), 3)], record("a"));
        journal.add(&record("b")).unwrap();
        drop(journal);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);

        let other = Heading {
            points: "other".into(),
            ..heading
        };
        assert!(Journal::open(&path, &other).is_err());
    }
}
