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

/// Where a message is, in the order of the recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// The number of the file.
    pub(crate) file: usize,
    /// In that file: a byte, or the number of a row.
    pub(crate) at: u64,
    /// In the chunk that is there, if it is one.
    pub(crate) within: u64,
}

/// A message as it is stored.
#[derive(Clone, Copy, Debug)]
pub struct Message<'a> {
    /// Where it is.
    pub place: Place,
    /// When it was recorded, in nanoseconds.
    pub log_time: u64,
    /// When it was published.
    pub publish_time: u64,
    /// Its number among those of the topic, or 0.
    pub sequence: u32,
    /// In the encoding of the topic.
    pub data: &'a [u8],
}

/// What is wrong with a file that has been read to its end.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Flaws {
    /// Where and how the file is cut off, if it is.
    pub cut: Option<String>,
    /// Parts that cannot be read.
    pub damaged: usize,
    /// What is wrong with the first of them.
    pub first: Option<String>,
    /// Files that belong to the recording and are not there.
    pub absent: Vec<String>,
}

impl Flaws {
    fn damage(&mut self, what: String) {
        self.damaged += 1;
        self.first.get_or_insert(what);
    }

    /// What should be said of them, a sentence each.
    pub fn lines(&self) -> impl Iterator<Item = String> {
        let cut = self
            .cut
            .as_ref()
            .map(|what| format!("the recording is cut off: {what}"));
        let damaged = self.first.as_ref().map(|what| {
            let count = self.damaged;
            format!("{count} parts of the recording are damaged and left out, the first: {what}")
        });
        let absent = (!self.absent.is_empty()).then(|| {
            format!(
                "files of the recording are missing: {}; those that end in .zstd are unpacked first (zstd -d)",
                self.absent.join(", ")
            )
        });
        cut.into_iter().chain(damaged).chain(absent)
    }

    /// Those of another file too.
    pub(crate) fn and(&mut self, other: Self) {
        self.cut = self.cut.take().or(other.cut);
        self.damaged += other.damaged;
        self.first = self.first.take().or(other.first);
        self.absent.extend(other.absent);
    }
}

/// What is done with each message.
pub(crate) type Each<'a> = dyn FnMut(&Arc<Topic>, &Message<'_>) -> Result<()> + 'a;

/// A file of messages, which is never held whole.
pub(crate) trait Container: Send {
    /// The topics that are known before any message is read: all, or none where the end of the file is missing.
    fn topics(&self) -> Vec<Arc<Topic>>;

    /// Visits the messages of some topics in the order of the file; those of other topics may be skipped unread. `file`
    /// is the number of this file in [`Place`]s.
    fn visit(
        &mut self,
        file: usize,
        wanted: &dyn Fn(&Topic) -> bool,
        each: &mut Each<'_>,
    ) -> Result<Flaws>;

    /// Reads a message that was visited before.
    fn read(&mut self, place: Place) -> Result<Vec<u8>>;
}

/// How messages begin that rosbag2 compressed each by itself (`compression_mode: message`); cdr begins with a zero.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// A message as it was before it was compressed, if it was.
fn unfolded(data: &[u8]) -> std::result::Result<Cow<'_, [u8]>, &'static str> {
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
