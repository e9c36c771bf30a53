//! Files of recordings: one container format per file.

mod mcap;
mod record;
#[cfg(feature = "rosbag2")]
mod rosbag;

pub(crate) use mcap::Mcap;
#[cfg(feature = "rosbag2")]
pub(crate) use rosbag::Rosbag;

use lsdc_files::error::Result;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Size limit of a message, and of a chunk of messages, in bytes.
const LARGEST: u64 = 1 << 30;

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Name, as in `/camera/image_raw`.
    pub name: String,
    /// Type of its messages, as in `sensor_msgs/msg/Image`.
    pub kind: String,
    /// Encoding of its messages: `cdr` in ROS 2.
    pub encoding: String,
    /// Definition of the type, if it is recorded: its language and its text.
    pub definition: Option<(String, Vec<u8>)>,
    /// Further metadata, such as the quality of service.
    pub metadata: BTreeMap<String, String>,
}

/// The location of a message. Locations are ordered as in the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct MessageLocation {
    /// Index of the file.
    pub(crate) file: usize,
    /// Position in the file: a byte, or the number of a row.
    pub(crate) at: u64,
    /// Offset in the chunk at this position, if it is a chunk.
    pub(crate) within: u64,
}

/// When a message was recorded and published, in nanoseconds.
#[derive(Clone, Copy, Debug)]
pub struct MessageTimes {
    /// When it was recorded.
    pub log: u64,
    /// When it was published.
    pub publish: u64,
}

/// A message as it is stored.
#[derive(Clone, Copy, Debug)]
pub struct Message<'a> {
    /// Location in the recording.
    pub location: MessageLocation,
    /// When it was recorded and published.
    pub times: MessageTimes,
    /// Sequence number within the topic, or 0.
    pub sequence: u32,
    /// Bytes in the encoding of the topic.
    pub data: &'a [u8],
}

/// The defects of a file that was read to its end.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Defects {
    /// Where and how the file is truncated, if it is.
    pub truncated: Option<String>,
    /// Number of parts that cannot be read.
    pub damaged: usize,
    /// Description of the first damage.
    pub first_damage: Option<String>,
    /// Files of the recording that are missing.
    pub missing_files: Vec<String>,
}

impl Defects {
    fn add_damage(&mut self, what: String) {
        self.damaged += 1;
        self.first_damage.get_or_insert(what);
    }

    /// Returns a warning for each kind of defect.
    pub fn lines(&self) -> impl Iterator<Item = String> {
        let truncated = self
            .truncated
            .as_ref()
            .map(|what| format!("the recording is cut off: {what}"));
        let damaged = self.first_damage.as_ref().map(|what| {
            let count = self.damaged;
            format!("{count} parts of the recording are damaged and left out, the first: {what}")
        });
        let missing_files = (!self.missing_files.is_empty()).then(|| {
            format!(
                "files of the recording are missing: {}; those that end in .zstd are unpacked first (zstd -d)",
                self.missing_files.join(", ")
            )
        });
        truncated.into_iter().chain(damaged).chain(missing_files)
    }

    /// Adds the defects of another file.
    pub(crate) fn merge(&mut self, other: Self) {
        self.truncated = self.truncated.take().or(other.truncated);
        self.damaged += other.damaged;
        self.first_damage = self.first_damage.take().or(other.first_damage);
        self.missing_files.extend(other.missing_files);
    }
}

/// Callback for each message.
pub(crate) type Visitor<'a> = dyn FnMut(&Arc<Topic>, &Message<'_>) -> Result<()> + 'a;

/// A file of messages, which is never loaded whole.
pub(crate) trait Container: Send {
    /// Returns the topics that are known before any message is read: all, or none if the end of the file is missing.
    fn topics(&self) -> Vec<Arc<Topic>>;

    /// Visits the messages of the selected topics in the order of the file; other messages may be skipped unread. `file` is
    /// the index of this file in [`MessageLocation`]s.
    fn visit(
        &mut self,
        file: usize,
        is_selected: &dyn Fn(&Topic) -> bool,
        each: &mut Visitor<'_>,
    ) -> Result<Defects>;

    /// Reads a message that was visited before.
    fn read(&mut self, location: MessageLocation) -> Result<Vec<u8>>;
}

/// Magic bytes of messages that rosbag2 compressed one by one (`compression_mode: message`); CDR starts with a zero.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// Returns a message, decompressed if necessary.
fn decompressed(data: &[u8]) -> std::result::Result<Cow<'_, [u8]>, &'static str> {
    if !data.starts_with(&ZSTD) {
        return Ok(data.into());
    }
    let size = zstd::zstd_safe::get_frame_content_size(data).ok().flatten();
    let most = (32 << 20).max(data.len() as u64 * 1100).min(LARGEST);
    let size = size.filter(|size| *size <= most);
    let size = size.ok_or("does not say how large it is before its compression, or too much")?;
    let found = zstd::bulk::decompress(data, size as usize);
    found.map(Into::into).map_err(|_| "cannot be unfolded")
}
