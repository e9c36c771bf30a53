//! MCAP (<https://mcap.dev/spec>): a sequence of records, most of them in chunks.

use super::record::{Channel, ChunkHeader, MessageRecord, Schema, summary_start};
use super::{Container, Defects, LARGEST, Message, MessageLocation, Topic, Visitor, decompressed};
use lsdc_files::error::{Cause, Error, Result};
use mcap::MAGIC;
use mcap::records::op;
use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read as _, Seek as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Bytes of the operation code and the length before each record.
const HEAD: u64 = 9;
/// Largest size of the fields before the compressed records of a chunk: numbers, and the name of a compression.
const CHUNK_HEAD: u64 = 128;
/// Size of the last record and the magic bytes after it.
const FOOTER: u64 = HEAD + 20 + 8;
/// Value of [`MessageLocation::within`] for messages outside of any chunk.
const OUTSIDE_CHUNKS: u64 = u64::MAX;
/// Number of cached chunks. Image and points of a frame are in different chunks if topics were recorded in turns.
const CACHED_CHUNKS: usize = 3;

/// An MCAP file.
pub(crate) struct Mcap {
    path: PathBuf,
    file: BufReader<File>,
    size: u64,
    channels: Channels,
    /// Whether the file is complete, with its footer.
    ended: bool,
    /// Whether the channels of the whole file are known, so that chunks can be skipped.
    summarised: bool,
    /// The last chunks that were read, the latest first.
    chunks: Vec<(u64, Arc<Vec<u8>>)>,
}

/// Channels and schemas by their identifiers.
#[derive(Default)]
struct Channels {
    schemas: HashMap<u16, Schema>,
    topics: HashMap<u16, Arc<Topic>>,
}

impl Channels {
    /// Adds the schema or channel of a record, if it can be read. The first one with an identifier is kept.
    fn add(&mut self, code: u8, body: &[u8]) -> Option<()> {
        if code == op::SCHEMA {
            let schema = Schema::read(body)?;
            self.schemas.entry(schema.id).or_insert(schema);
        } else if code == op::CHANNEL {
            let channel = Channel::read(body)?;
            let schema = self.schemas.get(&channel.schema);
            self.topics.entry(channel.id).or_insert_with(|| {
                Arc::new(Topic {
                    name: channel.topic,
                    kind: schema.map_or(String::new(), |schema| schema.name.clone()),
                    encoding: channel.encoding,
                    definition: schema.map(|schema| (schema.language.clone(), schema.text.clone())),
                    metadata: channel.metadata,
                })
            });
        }
        Some(())
    }
}

impl Mcap {
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::read(path, e))?;
        let size = file.metadata().map_err(|e| Error::read(path, e))?.len();
        let mut found = Self {
            path: path.to_owned(),
            file: BufReader::with_capacity(1 << 16, file),
            size,
            channels: Channels::default(),
            ended: false,
            summarised: false,
            chunks: Vec::new(),
        };
        if size < MAGIC.len() as u64 || found.bytes(0, MAGIC.len() as u64)? != MAGIC {
            return Err(Error::format(path, "is no MCAP file"));
        }
        if let Some(start) = found.summary()? {
            found.read_summary(start)?;
        }
        Ok(found)
    }

    /// Returns the start of the summary, if the file is complete and has one.
    fn summary(&mut self) -> Result<Option<u64>> {
        let Some(at) = self.footer() else {
            return Ok(None);
        };
        let tail = self.bytes(at, FOOTER)?;
        self.ended = tail.ends_with(MAGIC) && tail[0] == op::FOOTER;
        let body = &tail[HEAD as usize..FOOTER as usize - MAGIC.len()];
        let start = summary_start(body).filter(|start| self.ended && *start > 0);
        Ok(start)
    }

    fn footer(&self) -> Option<u64> {
        self.size
            .checked_sub(FOOTER)
            .filter(|at| *at >= MAGIC.len() as u64)
    }

    /// Reads the channels that the summary lists. A damaged summary is ignored.
    fn read_summary(&mut self, start: u64) -> Result<()> {
        let end = self.footer().unwrap_or(0);
        let mut at = start;
        while at < end {
            let Some((code, length)) = self.head(at)? else {
                return Ok(());
            };
            if matches!(code, op::SCHEMA | op::CHANNEL) {
                let body = self.bytes(at + HEAD, length)?;
                if self.channels.add(code, &body).is_none() {
                    return Ok(());
                }
            }
            at += HEAD + length;
        }
        self.summarised = at == end;
        Ok(())
    }

    /// Reads the operation code and the length of the record at a byte; `None` if the file ends before the record does.
    fn head(&mut self, at: u64) -> Result<Option<(u8, u64)>> {
        let left = self.size.saturating_sub(at);
        if left < HEAD {
            return Ok(None);
        }
        let head = self.bytes(at, HEAD)?;
        let (&code, length) = head.split_first().unwrap_or((&0, &[]));
        let length = u64::from_le_bytes(length.try_into().unwrap_or_default());
        Ok((length <= left - HEAD).then_some((code, length)))
    }

    /// Reads bytes inside the file.
    fn bytes(&mut self, at: u64, length: u64) -> Result<Vec<u8>> {
        let mut bytes = vec![0; length as usize];
        let here = self.file.stream_position();
        let read = here.and_then(|here| {
            // Unlike a plain seek, this keeps the buffer.
            self.file.seek_relative(at as i64 - here as i64)?;
            self.file.read_exact(&mut bytes)
        });
        read.map_err(|e| Error::read(&self.path, e))?;
        Ok(bytes)
    }

    /// Whether a chunk that ends at `end` may contain messages of a selected topic, by the index records after it.
    fn may_contain(&mut self, end: u64, is_selected: &dyn Fn(&Topic) -> bool) -> Result<bool> {
        if !self.summarised {
            return Ok(true);
        }
        let (mut at, mut indexed) = (end, false);
        while let Some((op::MESSAGE_INDEX, length)) = self.head(at)? {
            let number = self.bytes(at + HEAD, length.min(2))?;
            let number = number.try_into().map_or(0, u16::from_le_bytes);
            match self.channels.topics.get(&number) {
                Some(topic) if !is_selected(topic) => {}
                _ => return Ok(true),
            }
            indexed = true;
            at += HEAD + length;
        }
        Ok(!indexed)
    }

    /// Reads the records of the chunk at a byte, with a body of `length` bytes; the inner error describes the damage.
    fn chunk(&mut self, at: u64, length: u64) -> Result<std::result::Result<Vec<u8>, String>> {
        let start = at + HEAD;
        let unreadable = |what: &str| Ok(Err(format!("the chunk at byte {at} {what}")));
        let head = self.bytes(start, length.min(CHUNK_HEAD))?;
        let Some(head) = ChunkHeader::read(&head) else {
            return unreadable("has no sound beginning");
        };
        if head.compressed_size != length - head.length {
            return unreadable("is of another length than it says");
        }
        if !is_plausible(head.decompressed_size, length) {
            let size = head.decompressed_size;
            return unreadable(&format!(
                "says that it unfolds to {size} bytes, more than is read of it"
            ));
        }
        if head.compressed_size > LARGEST {
            return unreadable("is larger than a gigabyte");
        }
        let stored = self.bytes(start + head.length, head.compressed_size)?;
        let decompressed = match head.compression.as_str() {
            "" | "none" => Some(stored),
            "zstd" => zstd::bulk::decompress(&stored, head.decompressed_size as usize).ok(),
            "lz4" => decompress_lz4(&stored, head.decompressed_size),
            other => return unreadable(&format!("is compressed by `{other}`, which is not read")),
        };
        let Some(decompressed) = decompressed else {
            return unreadable("cannot be unfolded");
        };
        let is_valid = decompressed.len() as u64 == head.decompressed_size;
        let crc = head.crc;
        if !is_valid || crc != 0 && crc32fast::hash(&decompressed) != crc {
            return unreadable("does not match its check sum");
        }
        Ok(Ok(decompressed))
    }

    /// Visits the messages among the records of a chunk.
    fn visit_chunk(
        &mut self,
        (file, at): (usize, u64),
        records: &[u8],
        is_selected: &dyn Fn(&Topic) -> bool,
        each: &mut Visitor<'_>,
        defects: &mut Defects,
    ) -> Result<()> {
        let mut within = 0;
        while within < records.len() {
            let Some((code, body)) = record(records, within) else {
                defects.add_damage(format!("the chunk at byte {at} ends within a record"));
                return Ok(());
            };
            let location = MessageLocation {
                file,
                at,
                within: within as u64,
            };
            self.visit_record(location, code, body, is_selected, each, defects)?;
            within += HEAD as usize + body.len();
        }
        Ok(())
    }

    fn visit_record(
        &mut self,
        location: MessageLocation,
        code: u8,
        body: &[u8],
        is_selected: &dyn Fn(&Topic) -> bool,
        each: &mut Visitor<'_>,
        defects: &mut Defects,
    ) -> Result<()> {
        let damaged = || format!("a record at byte {} cannot be read", location.at);
        if code != op::MESSAGE {
            if self.channels.add(code, body).is_none() {
                defects.add_damage(damaged());
            }
            return Ok(());
        }
        let Some(found) = MessageRecord::read(body) else {
            defects.add_damage(damaged());
            return Ok(());
        };
        let Some(topic) = self.channels.topics.get(&found.channel) else {
            defects.add_damage(format!(
                "a message at byte {} is of no known topic",
                location.at
            ));
            return Ok(());
        };
        if !is_selected(topic) {
            return Ok(());
        }
        let data = match decompressed(found.data) {
            Ok(data) => data,
            Err(what) => {
                defects.add_damage(format!("a message at byte {} {what}", location.at));
                return Ok(());
            }
        };
        let message = Message {
            location,
            times: found.times,
            sequence: found.sequence,
            data: &data,
        };
        each(topic, &message)
    }

    /// Returns the records of a chunk from the cache, or reads them again.
    fn cached_chunk(&mut self, at: u64) -> Result<Arc<Vec<u8>>> {
        if let Some(i) = self.chunks.iter().position(|(location, _)| *location == at) {
            let found = self.chunks.remove(i);
            self.chunks.insert(0, found);
        } else {
            let head = self.head(at)?;
            let changed = || Error::format(&self.path, "has become shorter");
            let (_, length) = head.ok_or_else(changed)?;
            let chunk = self.chunk(at, length)?;
            let chunk = chunk.map_err(|what| Error::format(&self.path, what))?;
            self.chunks.truncate(CACHED_CHUNKS - 1);
            self.chunks.insert(0, (at, Arc::new(chunk)));
        }
        Ok(self.chunks[0].1.clone())
    }
}

impl Container for Mcap {
    fn topics(&self) -> Vec<Arc<Topic>> {
        if !self.summarised {
            return Vec::new();
        }
        self.channels.topics.values().cloned().collect()
    }

    fn visit(
        &mut self,
        file: usize,
        is_selected: &dyn Fn(&Topic) -> bool,
        each: &mut Visitor<'_>,
    ) -> Result<Defects> {
        let mut defects = Defects::default();
        let mut at = MAGIC.len() as u64;
        loop {
            let Some((code, length)) = self.head(at)? else {
                defects.truncated = Some(format!(
                    "the record at byte {at} of {} is incomplete, and the end of the file is missing",
                    self.size
                ));
                return Ok(defects);
            };
            match code {
                op::CHUNK if !self.may_contain(at + HEAD + length, is_selected)? => {}
                op::CHUNK => match self.chunk(at, length)? {
                    Ok(records) => {
                        self.visit_chunk((file, at), &records, is_selected, each, &mut defects)?;
                    }
                    Err(what) => defects.add_damage(what),
                },
                op::SCHEMA | op::CHANNEL | op::MESSAGE if length > LARGEST => {
                    defects
                        .add_damage(format!("the record at byte {at} is larger than a gigabyte"));
                }
                op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                    let body = self.bytes(at + HEAD, length)?;
                    let location = MessageLocation {
                        file,
                        at,
                        within: OUTSIDE_CHUNKS,
                    };
                    self.visit_record(location, code, &body, is_selected, each, &mut defects)?;
                }
                op::DATA_END | op::FOOTER => {
                    let truncated =
                        || "all messages are there, but the end of the file is missing".to_owned();
                    defects.truncated = (!self.ended).then(truncated);
                    return Ok(defects);
                }
                _ => {}
            }
            at += HEAD + length;
        }
    }

    fn read(&mut self, location: MessageLocation) -> Result<Vec<u8>> {
        let (chunk, alone);
        let body = if location.within == OUTSIDE_CHUNKS {
            let length = self.head(location.at)?.map_or(0, |(_, length)| length);
            alone = self.bytes(location.at + HEAD, length)?;
            Some(&alone[..])
        } else {
            chunk = self.cached_chunk(location.at)?;
            record(&chunk, location.within as usize).map(|(_, body)| body)
        };
        let found = body.and_then(MessageRecord::read);
        match found.and_then(|found| decompressed(found.data).ok()) {
            Some(data) => Ok(data.into_owned()),
            None => Err(Error::new(
                Cause::Read,
                format!("`{}` has changed while it was read", self.path.display()),
            )),
        }
    }
}

/// Returns the operation code and the body of the record at an offset.
fn record(records: &[u8], at: usize) -> Option<(u8, &[u8])> {
    let (head, rest) = records.get(at..)?.split_at_checked(HEAD as usize)?;
    let (code, length) = head.split_first()?;
    let length = u64::from_le_bytes(length.try_into().ok()?);
    Some((*code, rest.get(..usize::try_from(length).ok()?)?))
}

/// Whether a chunk of this size can decompress to that size; damaged ones claim much more.
fn is_plausible(decompressed: u64, length: u64) -> bool {
    decompressed <= LARGEST.min((32 << 20).max(length.saturating_mul(1100)))
}

fn decompress_lz4(stored: &[u8], size: u64) -> Option<Vec<u8>> {
    let mut decompressed = Vec::with_capacity(size as usize);
    let mut decoder = lz4::Decoder::new(stored).ok()?;
    decoder
        .by_ref()
        .take(size + 1)
        .read_to_end(&mut decompressed)
        .ok()?;
    Some(decompressed)
}
