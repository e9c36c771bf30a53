//! A recording: one file, or the folder of a bag with several.

use crate::container::{Container, Each, Flaws, Mcap, Message, Place, Rosbag, SQLITE, Topic};
use lsdc_files::error::{Error, Result};
use lsdc_files::has_ending;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The endings of recordings.
const ENDINGS: [&str; 2] = ["mcap", "db3"];
/// What describes the folder of a bag.
const METADATA: &str = "metadata.yaml";

/// A recording of ROS 2, which is read message by message and never held whole.
pub struct Recording {
    path: PathBuf,
    files: Vec<Box<dyn Container>>,
    /// Of all files together.
    size: u64,
}

impl Recording {
    /// Whether a path is that of a recording: a file of MCAP or SQLite by its ending, or a folder that holds any.
    pub fn is_at(path: &Path) -> bool {
        ENDINGS.iter().any(|ending| has_ending(path, ending))
            || path.join(METADATA).is_file()
            || path.is_dir() && files_in(path).is_ok_and(|files| !files.is_empty())
    }

    /// Opens an MCAP file, an SQLite file of rosbag2, or the folder of a bag.
    ///
    /// # Errors
    /// A path that cannot be read or holds no recording.
    pub fn open(path: &Path) -> Result<Self> {
        let paths = if path.is_dir() {
            files_in(path)?
        } else {
            vec![path.to_owned()]
        };
        if paths.is_empty() {
            return Err(Error::format(path, "holds no recording").hint(
                "a bag is a folder with files of MCAP or SQLite (db3); unpack those that end in .zstd: zstd -d",
            ));
        }
        let sizes = paths.iter().map(|path| {
            let found = std::fs::metadata(path).map_err(|e| Error::read(path, e));
            found.map(|found| found.len())
        });
        Ok(Self {
            path: path.to_owned(),
            size: sizes.sum::<Result<u64>>()?,
            files: paths.iter().map(|path| open(path)).collect::<Result<_>>()?,
        })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Of all its files, in bytes.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// The topics that are known before any message is read, by name: all, or none where the end of a file is missing.
    pub fn topics(&self) -> Vec<Arc<Topic>> {
        let mut topics = BTreeMap::new();
        for file in &self.files {
            let found = file.topics();
            if found.is_empty() {
                return Vec::new();
            }
            for topic in found {
                topics.entry(topic.name.clone()).or_insert(topic);
            }
        }
        topics.into_values().collect()
    }

    /// Visits the messages of some topics in the order of the recording. Those of other topics may be skipped unread.
    /// What cannot be read is passed over, and said with the result.
    ///
    /// # Errors
    /// A file that cannot be read at all, and what `each` returns, which ends the visit.
    pub fn visit(
        &mut self,
        wanted: &dyn Fn(&Topic) -> bool,
        each: &mut dyn FnMut(&Arc<Topic>, &Message<'_>) -> Result<()>,
    ) -> Result<Flaws> {
        let each: &mut Each<'_> = each;
        let mut flaws = Flaws::default();
        for (number, file) in self.files.iter_mut().enumerate() {
            flaws.and(file.visit(number, wanted, each)?);
        }
        Ok(flaws)
    }

    /// Reads a message that was visited before.
    ///
    /// # Errors
    /// A file that cannot be read, or has changed.
    pub fn read(&mut self, place: Place) -> Result<Vec<u8>> {
        let file = self.files.get_mut(place.file);
        let file = file.ok_or_else(|| Error::format(&self.path, "has fewer files than before"))?;
        file.read(place)
    }
}

fn open(path: &Path) -> Result<Box<dyn Container>> {
    let mut start = Vec::new();
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let read = file.take(SQLITE.len() as u64).read_to_end(&mut start);
    read.map_err(|e| Error::read(path, e))?;
    if start.is_empty() {
        return Err(Error::format(path, "is empty"));
    }
    Ok(if start == SQLITE {
        Box::new(Rosbag::open(path)?)
    } else {
        Box::new(Mcap::open(path)?)
    })
}

/// The recordings in the folder of a bag, in the order that it describes; else by the numbers in their names.
fn files_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::read(folder, e))?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::read(folder, e))?.path();
        if ENDINGS.iter().any(|ending| has_ending(&path, ending)) {
            found.push(path);
        }
    }
    let text = std::fs::read_to_string(folder.join(METADATA)).unwrap_or_default();
    let listed = |path: &Path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let mut lines = text.lines();
        lines.position(|line| line.trim().trim_start_matches("- ").trim_matches('"') == name)
    };
    found.sort_by_key(|path| {
        let place = listed(path).unwrap_or(usize::MAX);
        (place, path.as_os_str().len(), path.clone())
    });
    Ok(found)
}
