//! The supported records of MCAP. Damaged records read as `None`, and never allocate more memory than they have bytes.

use super::MessageTimes;
use std::collections::BTreeMap;

/// A message type.
pub(super) struct Schema {
    pub(super) id: u16,
    pub(super) name: String,
    pub(super) language: String,
    pub(super) text: Vec<u8>,
}

/// A topic with an identifier.
pub(super) struct Channel {
    pub(super) id: u16,
    pub(super) schema: u16,
    pub(super) topic: String,
    pub(super) encoding: String,
    pub(super) metadata: BTreeMap<String, String>,
}

/// A message.
pub(super) struct MessageRecord<'a> {
    pub(super) channel: u16,
    pub(super) sequence: u32,
    pub(super) times: MessageTimes,
    pub(super) data: &'a [u8],
}

/// The fields before the compressed records of a chunk.
pub(super) struct ChunkHeader {
    pub(super) decompressed_size: u64,
    pub(super) crc: u32,
    pub(super) compression: String,
    /// Size of the compressed records.
    pub(super) compressed_size: u64,
    /// Size of these fields.
    pub(super) length: u64,
}

impl Schema {
    pub(super) fn read(body: &[u8]) -> Option<Self> {
        let mut fields = Fields(body);
        Some(Self {
            id: fields.u16()?,
            name: fields.text()?,
            language: fields.text()?,
            text: fields.bytes()?.to_vec(),
        })
    }
}

impl Channel {
    pub(super) fn read(body: &[u8]) -> Option<Self> {
        let mut fields = Fields(body);
        Some(Self {
            id: fields.u16()?,
            schema: fields.u16()?,
            topic: fields.text()?,
            encoding: fields.text()?,
            metadata: fields.pairs()?,
        })
    }
}

impl<'a> MessageRecord<'a> {
    pub(super) fn read(body: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(body);
        Some(Self {
            channel: fields.u16()?,
            sequence: fields.u32()?,
            times: MessageTimes {
                log: fields.u64()?,
                publish: fields.u64()?,
            },
            data: fields.0,
        })
    }
}

impl ChunkHeader {
    /// Reads the start of the body of a chunk.
    pub(super) fn read(body: &[u8]) -> Option<Self> {
        let mut fields = Fields(body);
        let _times = (fields.u64()?, fields.u64()?);
        Some(Self {
            decompressed_size: fields.u64()?,
            crc: fields.u32()?,
            compression: fields.text()?,
            compressed_size: fields.u64()?,
            length: (body.len() - fields.0.len()) as u64,
        })
    }
}

/// Returns the start of the summary from the body of a footer; 0 if there is none.
pub(super) fn summary_start(body: &[u8]) -> Option<u64> {
    Fields(body).u64()
}

/// The remaining fields of a record: little-endian numbers, and other fields prefixed by their length.
struct Fields<'a>(&'a [u8]);

macro_rules! numbers {
    ($($kind:ident)*) => {$(
        fn $kind(&mut self) -> Option<$kind> {
            let (bytes, rest) = self.0.split_first_chunk()?;
            self.0 = rest;
            Some($kind::from_le_bytes(*bytes))
        }
    )*};
}

impl<'a> Fields<'a> {
    numbers!(u16 u32 u64);

    fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()? as usize;
        let (bytes, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(bytes)
    }

    fn text(&mut self) -> Option<String> {
        self.bytes()
            .map(|bytes| String::from_utf8_lossy(bytes).into_owned())
    }

    fn pairs(&mut self) -> Option<BTreeMap<String, String>> {
        let mut fields = Self(self.bytes()?);
        let mut pairs = BTreeMap::new();
        while !fields.0.is_empty() {
            pairs.insert(fields.text()?, fields.text()?);
        }
        Some(pairs)
    }
}
