//! Writer of recordings: MCAP files, which appear under their names once complete.

use crate::container::{Message, MessageTimes, Topic};
use crate::definitions::{LANGUAGE, definition};
use crate::message::MessageType;
use lsdc_files::error::{Error, Result};
use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions};
use std::collections::{BTreeMap, HashMap};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A recording that is being written.
pub struct Writer {
    path: PathBuf,
    output: mcap::Writer<BufWriter<lsdc_files::AtomicFile>>,
    /// Channels by topic name, type and encoding.
    channels: HashMap<(String, String, String), u16>,
    /// Number of messages of each channel.
    counts: HashMap<u16, u32>,
    /// Number of topics without a definition, neither recorded nor known to this crate.
    undefined: usize,
}

impl Writer {
    /// Starts a recording at `path`, which appears only on [`Self::finish`].
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let file = lsdc_files::AtomicFile::create(path)?;
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("lsdc ", env!("CARGO_PKG_VERSION")))
            .chunk_size(Some(4 << 20))
            // Depths hardly compress better with more effort.
            .compression(Some(Compression::Lz4));
        let output = options
            .create(BufWriter::new(file))
            .map_err(|e| unwritten(path, e))?;
        Ok(Self {
            path: path.to_owned(),
            output,
            channels: HashMap::new(),
            counts: HashMap::new(),
            undefined: 0,
        })
    }

    /// Writes a message of a supported type.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(
        &mut self,
        topic: &str,
        kind: MessageType,
        times: MessageTimes,
        data: &[u8],
    ) -> Result<()> {
        let topic = Topic {
            name: topic.to_owned(),
            kind: kind.name().to_owned(),
            encoding: "cdr".to_owned(),
            definition: None,
            metadata: BTreeMap::new(),
        };
        self.put(&topic, None, times, data)
    }

    /// Copies a message of another recording unchanged.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn copy(&mut self, topic: &Arc<Topic>, message: &Message<'_>) -> Result<()> {
        self.put(topic, Some(message.sequence), message.times, message.data)
    }

    fn put(
        &mut self,
        topic: &Topic,
        number: Option<u32>,
        times: MessageTimes,
        data: &[u8],
    ) -> Result<()> {
        let channel_id = self.channel(topic)?;
        let count = self.counts.entry(channel_id).or_default();
        *count = count.wrapping_add(1);
        let header = MessageHeader {
            channel_id,
            sequence: number.unwrap_or(*count),
            log_time: times.log,
            publish_time: times.publish,
        };
        let written = self.output.write_to_known_channel(&header, data);
        written.map_err(|e| unwritten(&self.path, e))
    }

    fn channel(&mut self, topic: &Topic) -> Result<u16> {
        let key = (
            topic.name.clone(),
            topic.kind.clone(),
            topic.encoding.clone(),
        );
        if let Some(channel) = self.channels.get(&key) {
            return Ok(*channel);
        }
        let usable = topic
            .definition
            .as_ref()
            .filter(|(_, text)| !text.is_empty());
        let (language, text) = match (usable, MessageType::of(&topic.kind)) {
            (Some((language, text)), _) => (language.clone(), text.clone()),
            (None, Some(kind)) => (LANGUAGE.to_owned(), definition(kind).into_bytes()),
            (None, None) => {
                self.undefined += 1;
                (String::new(), Vec::new())
            }
        };
        // A channel without a type has no schema.
        let schema = if topic.kind.is_empty() {
            0
        } else {
            self.output
                .add_schema(&topic.kind, &language, &text)
                .map_err(|e| unwritten(&self.path, e))?
        };
        let (name, encoding) = (&topic.name, &topic.encoding);
        let channel = self
            .output
            .add_channel(schema, name, encoding, &topic.metadata);
        let channel = channel.map_err(|e| unwritten(&self.path, e))?;
        self.channels.insert(key, channel);
        Ok(channel)
    }

    /// Number of topics that other programs may be unable to decode, because the definition of their type is missing.
    pub fn undefined(&self) -> usize {
        self.undefined
    }

    /// Completes the recording and moves it to its path. On return it is safe from a power failure.
    ///
    /// # Errors
    /// The file cannot be written; then no file appears.
    pub fn finish(mut self) -> Result<()> {
        self.output.finish().map_err(|e| unwritten(&self.path, e))?;
        let file = self.output.into_inner().into_inner();
        let file = file.map_err(|e| Error::write(&self.path, e.into_error()))?;
        file.finish()
    }
}

fn unwritten(path: &Path, error: McapError) -> Error {
    match error {
        McapError::Io(error) => Error::write(path, error),
        other => Error::write(path, std::io::Error::other(other)),
    }
}
