//! A recording: one file, or the folder of a bag with several.

#[cfg(feature = "rosbag2")]
use crate::container::Rosbag;
use crate::container::{Container, Defects, Mcap, Message, MessageLocation, Topic, Visitor};
use lsdc_files::error::{Error, Result};
use lsdc_files::has_ending;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// File extensions of recordings.
const ENDINGS: [&str; 2] = ["mcap", "db3"];
/// Magic bytes of SQLite files.
const SQLITE: &[u8] = b"SQLite format 3\0";
/// Magic bytes of ROS 1 bags.
const ROS_1: &[u8] = b"#ROSBAG V";
/// Extension of files that rosbag2 compressed as a whole.
const PACKED: &str = "zstd";
/// File that describes the folder of a bag.
const METADATA: &str = "metadata.yaml";

/// A recording of ROS 2, which is read message by message and never loaded whole.
pub struct Recording {
    path: PathBuf,
    files: Vec<Box<dyn Container>>,
    /// Size of all files together, in bytes.
    size: u64,
    /// Files that the metadata lists and the folder lacks.
    missing_files: Vec<String>,
}

impl Recording {
    /// Whether a path is a recording: an MCAP or SQLite file by its extension, or a folder that contains one. Also true for
    /// a bag of ROS 1, which [`Self::open`] rejects.
    pub fn is_at(path: &Path) -> bool {
        is_recording(path)
            || has_ending(path, "bag")
            || path.join(METADATA).is_file()
            || path.is_dir() && files_in(path).is_ok_and(|(files, _)| !files.is_empty())
    }

    /// Opens an MCAP file, an SQLite file of rosbag2, or the folder of a bag.
    ///
    /// # Errors
    /// The path cannot be read, or is not a recording.
    pub fn open(path: &Path) -> Result<Self> {
        let (paths, missing_files) = if path.is_dir() {
            files_in(path)?
        } else {
            (vec![path.to_owned()], Vec::new())
        };
        if paths.is_empty() {
            let what = if missing_files.is_empty() {
                "holds no recording".to_owned()
            } else {
                format!(
                    "does not hold the files of its recording: {}",
                    missing_files.join(", ")
                )
            };
            return Err(Error::format(path, what).hint(
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
            missing_files,
        })
    }

    /// Path of the recording.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Size of all files together, in bytes.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// Returns the topics that are known before any message is read, by name: all, or none if the end of a file is missing.
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

    /// Visits the messages of the selected topics in the order of the recording. Other messages may be skipped unread.
    /// Unreadable parts are skipped and returned as defects.
    ///
    /// # Errors
    /// A file cannot be read at all, or `each` returns an error, which ends the visit.
    pub fn visit(
        &mut self,
        is_selected: &dyn Fn(&Topic) -> bool,
        each: &mut dyn FnMut(&Arc<Topic>, &Message<'_>) -> Result<()>,
    ) -> Result<Defects> {
        let each: &mut Visitor<'_> = each;
        let mut defects = Defects {
            missing_files: self.missing_files.clone(),
            ..Defects::default()
        };
        for (number, file) in self.files.iter_mut().enumerate() {
            defects.merge(file.visit(number, is_selected, each)?);
        }
        Ok(defects)
    }

    /// Reads a message that was visited before.
    ///
    /// # Errors
    /// The file cannot be read, or has changed.
    pub fn read(&mut self, location: MessageLocation) -> Result<Vec<u8>> {
        let file = self.files.get_mut(location.file);
        let file = file.ok_or_else(|| Error::format(&self.path, "has fewer files than before"))?;
        file.read(location)
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
    if start.starts_with(ROS_1) {
        return Err(Error::format(path, "is a bag of ROS 1, which is not read")
            .hint("convert it to ROS 2, as by rosbags-convert"));
    }
    if start == SQLITE {
        return bag(path);
    }
    Ok(Box::new(Mcap::open(path)?))
}

#[cfg(feature = "rosbag2")]
fn bag(path: &Path) -> Result<Box<dyn Container>> {
    Ok(Box::new(Rosbag::open(path)?))
}

#[cfg(not(feature = "rosbag2"))]
fn bag(path: &Path) -> Result<Box<dyn Container>> {
    Err(Error::format(
        path,
        "is an SQLite file of rosbag2, which this build does not read",
    )
    .hint("build it with the feature `rosbag2`, or convert the bag to MCAP"))
}

/// Whether a name is that of a file of a recording, compressed or not.
fn is_recording(path: &Path) -> bool {
    let is_one = |path: &Path| ENDINGS.iter().any(|ending| has_ending(path, ending));
    is_one(path) || has_ending(path, PACKED) && is_one(&path.with_extension(""))
}

/// Returns the recordings in the folder of a bag, in the order of its metadata or else by the numbers in their names, and
/// the files that the metadata lists but the folder lacks.
fn files_in(folder: &Path) -> Result<(Vec<PathBuf>, Vec<String>)> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::read(folder, e))?;
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::read(folder, e))?.path();
        if is_recording(&path) && !has_ending(&path, PACKED) {
            found.push(path);
        }
    }
    let text = std::fs::read_to_string(folder.join(METADATA)).unwrap_or_default();
    let listed: Vec<&str> = text
        .lines()
        .filter_map(|line| line.trim().strip_prefix("- "))
        .map(|name| name.trim().trim_matches(['"', '\'']))
        .filter(|name| is_recording(Path::new(name)))
        .collect();
    let position = |path: &Path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        listed.iter().position(|listed| *listed == name)
    };
    found.sort_by_key(|path| {
        let position = position(path).unwrap_or(usize::MAX);
        (position, path.as_os_str().len(), path.clone())
    });
    let missing_files = listed.iter().filter(|name| !folder.join(name).exists());
    let missing_files = missing_files.map(|name| (*name).to_owned()).collect();
    Ok((found, missing_files))
}
