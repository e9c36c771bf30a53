//! Files of recordings: one container a file.

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

/// No message, and no chunk of messages, is larger.
const LARGEST: u64 = 1 << 30;

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// As in `/camera/image_raw`.
    pub name: String,
    /// The type of its messages, as in `sensor_msgs/msg/Image`.
    pub kind: String,
    /// What messages are written in: `cdr` in ROS 2.
    pub encoding: String,
    /// What the type is made of, where the recording says it: the language of the text, and the text.
    pub definition: Option<(String, Vec<u8>)>,
    /// What else is known of it, such as its quality of service.
    pub metadata: BTreeMap<String, String>,
}

/// The location of a message, in the order of the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct MessageLocation {
    /// The number of the file.
    pub(crate) file: usize,
    /// In that file: a byte, or the number of a row.
    pub(crate) at: u64,
    /// In the chunk that is there, if it is one.
    pub(crate) within: u64,
}

/// When a message is recorded and published, in nanoseconds.
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
    /// Where it is.
    pub location: MessageLocation,
    /// When it was recorded and published.
    pub times: MessageTimes,
    /// Its number among those of the topic, or 0.
    pub sequence: u32,
    /// In the encoding of the topic.
    pub data: &'a [u8],
}

/// The defects of a file that was read to its end.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Defects {
    /// Where and how the file is cut off, if it is.
    pub truncated: Option<String>,
    /// Parts that cannot be read.
    pub damaged: usize,
    /// What is wrong with the first of them.
    pub first_damage: Option<String>,
    /// Files that belong to the recording and are not there.
    pub missing_files: Vec<String>,
}

impl Defects {
    fn add_damage(&mut self, what: String) {
        self.damaged += 1;
        self.first_damage.get_or_insert(what);
    }

    /// A warning for each kind of defect.
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

/// Visits a message.
pub(crate) type Visitor<'a> = dyn FnMut(&Arc<Topic>, &Message<'_>) -> Result<()> + 'a;

/// A file of messages, which is never held whole.
pub(crate) trait Container: Send {
    /// The topics that are known before any message is read: all, or none where the end of the file is missing.
    fn topics(&self) -> Vec<Arc<Topic>>;

    /// Visits the messages of some topics in the order of the file; those of other topics may be skipped unread. `file`
    /// is the number of this file in [`MessageLocation`]s.
    fn visit(
        &mut self,
        file: usize,
        is_selected: &dyn Fn(&Topic) -> bool,
        each: &mut Visitor<'_>,
    ) -> Result<Defects>;

    /// Reads a message that was visited before.
    fn read(&mut self, location: MessageLocation) -> Result<Vec<u8>>;
}

/// How messages begin that rosbag2 compressed each by itself (`compression_mode: message`); cdr begins with a zero.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// A message as it was before it was compressed, if it was.
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
