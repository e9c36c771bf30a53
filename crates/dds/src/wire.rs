//! Reading and writing of RTPS datagrams and their submessages (OMG DDSI-RTPS 2.5, chapter 9.4).
//!
//! Written little-endian; read in both byte orders.

use std::fmt;

/// The first 12 bytes of all identifiers of a participant.
pub(crate) type Prefix = [u8; 12];

/// A reader or a writer of a participant.
pub(crate) type EntityId = [u8; 4];

pub(crate) const UNKNOWN: EntityId = [0; 4];
pub(crate) const PARTICIPANT: EntityId = [0, 0, 1, 0xc1];
pub(crate) const SPDP_WRITER: EntityId = [0, 1, 0, 0xc2];
pub(crate) const SPDP_READER: EntityId = [0, 1, 0, 0xc7];
pub(crate) const PUBLICATIONS_WRITER: EntityId = [0, 0, 3, 0xc2];
pub(crate) const PUBLICATIONS_READER: EntityId = [0, 0, 3, 0xc7];
pub(crate) const SUBSCRIPTIONS_WRITER: EntityId = [0, 0, 4, 0xc2];
pub(crate) const SUBSCRIPTIONS_READER: EntityId = [0, 0, 4, 0xc7];

/// The identifier of a participant, a reader or a writer.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Guid {
    pub(crate) prefix: Prefix,
    pub(crate) entity: EntityId,
}

impl Guid {
    pub(crate) fn new(prefix: Prefix, entity: EntityId) -> Self {
        Self { prefix, entity }
    }

    pub(crate) fn from_bytes(bytes: [u8; 16]) -> Self {
        let mut guid = Self::new([0; 12], [0; 4]);
        guid.prefix.copy_from_slice(&bytes[..12]);
        guid.entity.copy_from_slice(&bytes[12..]);
        guid
    }

    pub(crate) fn to_bytes(self) -> [u8; 16] {
        let mut bytes = [0; 16];
        bytes[..12].copy_from_slice(&self.prefix);
        bytes[12..].copy_from_slice(&self.entity);
        bytes
    }
}

impl fmt::Debug for Guid {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.to_bytes()
            .iter()
            .try_for_each(|byte| write!(formatter, "{byte:02x}"))
    }
}

/// A datagram, or a list of parameters in it, is inconsistent with its lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Malformed;

/// A cursor over bytes; reading beyond their end is an error.
#[derive(Clone, Copy)]
pub(crate) struct Input<'a> {
    bytes: &'a [u8],
    at: usize,
    pub(crate) little: bool,
}

impl<'a> Input<'a> {
    pub(crate) fn new(bytes: &'a [u8], little: bool) -> Self {
        Self {
            bytes,
            at: 0,
            little,
        }
    }

    pub(crate) fn take(&mut self, count: usize) -> Result<&'a [u8], Malformed> {
        let end = self.at.checked_add(count).ok_or(Malformed)?;
        let taken = self.bytes.get(self.at..end).ok_or(Malformed)?;
        self.at = end;
        Ok(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        self.take(N)?.try_into().map_err(|_| Malformed)
    }

    pub(crate) fn rest(self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }

    pub(crate) fn u16(&mut self) -> Result<u16, Malformed> {
        let bytes = self.array()?;
        Ok(if self.little {
            u16::from_le_bytes(bytes)
        } else {
            u16::from_be_bytes(bytes)
        })
    }

    pub(crate) fn u32(&mut self) -> Result<u32, Malformed> {
        let bytes = self.array()?;
        Ok(if self.little {
            u32::from_le_bytes(bytes)
        } else {
            u32::from_be_bytes(bytes)
        })
    }

    /// Reads a sequence number: upper half first in either byte order. Sequence numbers begin at 1.
    fn number(&mut self) -> Result<u64, Malformed> {
        let (high, low) = (self.u32()?, self.u32()?);
        if high >> 31 == 1 {
            return Err(Malformed);
        }
        Ok(u64::from(high) << 32 | u64::from(low))
    }

    /// Reads a set of at most 256 numbers from `base` on.
    fn set(&mut self, base: u64) -> Result<Vec<u64>, Malformed> {
        let count = self.u32()?;
        if count > 256 {
            return Err(Malformed);
        }
        let mut numbers = Vec::new();
        for word in 0..count.div_ceil(32) {
            let bits = self.u32()?;
            let of_word = (count - 32 * word).min(32);
            numbers.extend(
                (0..of_word)
                    .filter(|bit| bits >> (31 - bit) & 1 == 1)
                    .map(|bit| base + u64::from(32 * word + bit)),
            );
        }
        Ok(numbers)
    }
}

/// A submessage of a datagram.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Submessage<'a> {
    /// The following submessages are for this participant; for all if zero.
    Destination(Prefix),
    /// The following submessages are from another participant.
    Source(Prefix),
    Data {
        writer: EntityId,
        reader: EntityId,
        number: u64,
        /// Inline parameters, and whether they are little-endian.
        parameters: Option<(&'a [u8], bool)>,
        payload: &'a [u8],
        /// The payload is the key of an endpoint that is gone.
        is_key: bool,
    },
    Fragments(Fragments<'a>),
    Heartbeat {
        writer: EntityId,
        reader: EntityId,
        first: u64,
        last: u64,
        count: u32,
        /// No answer is needed.
        is_final: bool,
    },
    /// All fragments up to this one were sent.
    FragmentHeartbeat {
        writer: EntityId,
        reader: EntityId,
        number: u64,
    },
    Gap {
        writer: EntityId,
        reader: EntityId,
        /// Numbers not meant for this reader: from the first up to but excluding the second, and those listed.
        range: (u64, u64),
        listed: Vec<u64>,
    },
    Acknowledge {
        writer: EntityId,
        reader: EntityId,
        /// Everything below is acknowledged or not wanted.
        base: u64,
        missing: Vec<u64>,
        count: u32,
        is_final: bool,
    },
    MissingFragments {
        writer: EntityId,
        reader: EntityId,
        number: u64,
        /// Counted from 1.
        missing: Vec<u64>,
        count: u32,
    },
    Other,
}

/// Consecutive fragments of a message.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Fragments<'a> {
    pub(crate) writer: EntityId,
    pub(crate) reader: EntityId,
    pub(crate) number: u64,
    /// Counted from 1.
    pub(crate) start: u32,
    pub(crate) count: u16,
    /// Size of each fragment but the last, in bytes.
    pub(crate) size: u16,
    /// Size of the message, in bytes.
    pub(crate) total: u32,
    pub(crate) payload: &'a [u8],
}

const PAD: u8 = 0x01;
const ACKNACK: u8 = 0x06;
const HEARTBEAT: u8 = 0x07;
const GAP: u8 = 0x08;
const INFO_TS: u8 = 0x09;
const INFO_SRC: u8 = 0x0c;
const INFO_DST: u8 = 0x0e;
const NACK_FRAG: u8 = 0x12;
const HEARTBEAT_FRAG: u8 = 0x13;
const DATA: u8 = 0x15;
const DATA_FRAG: u8 = 0x16;

const HEADER: usize = 20;

/// Returns the sender of a datagram and its submessages.
pub(crate) fn parse(datagram: &[u8]) -> Result<(Prefix, Submessages<'_>), Malformed> {
    let mut input = Input::new(datagram, true);
    let [b'R', b'T', b'P', b'S', 2, _, _, _] = input.array()? else {
        return Err(Malformed);
    };
    let prefix = input.array()?;
    Ok((prefix, Submessages { rest: input.rest() }))
}

pub(crate) struct Submessages<'a> {
    rest: &'a [u8],
}

impl<'a> Iterator for Submessages<'a> {
    type Item = Result<Submessage<'a>, Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        let (&[kind, flags, a, b], rest) = self.rest.split_first_chunk::<4>()?;
        let little = flags & 1 == 1;
        let length = if little {
            u16::from_le_bytes([a, b])
        } else {
            u16::from_be_bytes([a, b])
        };
        // Length 0 means up to the end of the datagram, except for submessages without content.
        let length = match length {
            0 if kind != PAD && kind != INFO_TS => rest.len(),
            length => length.into(),
        };
        if length > rest.len() {
            self.rest = &[];
            return Some(Err(Malformed));
        }
        let (body, rest) = rest.split_at(length);
        self.rest = rest;
        Some(submessage(kind, flags, Input::new(body, little)))
    }
}

fn submessage(kind: u8, flags: u8, mut input: Input<'_>) -> Result<Submessage<'_>, Malformed> {
    Ok(match kind {
        INFO_DST => Submessage::Destination(input.array()?),
        INFO_SRC => {
            input.take(8)?;
            Submessage::Source(input.array()?)
        }
        DATA => {
            let (reader, writer, number, parameters) = data_head(flags, &mut input)?;
            let has_payload = flags & 0b1100 != 0;
            Submessage::Data {
                writer,
                reader,
                number,
                parameters,
                payload: if has_payload { input.rest() } else { &[] },
                is_key: flags & 0b1000 != 0,
            }
        }
        DATA_FRAG => {
            input.take(2)?;
            let to_parameters = input.u16()?;
            let (reader, writer, number) = (input.array()?, input.array()?, input.number()?);
            let (start, count, size) = (input.u32()?, input.u16()?, input.u16()?);
            let total = input.u32()?;
            input.take(
                usize::from(to_parameters)
                    .checked_sub(28)
                    .ok_or(Malformed)?,
            )?;
            if flags & 2 != 0 {
                skip_parameters(&mut input)?;
            }
            Submessage::Fragments(Fragments {
                writer,
                reader,
                number,
                start,
                count,
                size,
                total,
                payload: input.rest(),
            })
        }
        HEARTBEAT => Submessage::Heartbeat {
            reader: input.array()?,
            writer: input.array()?,
            first: input.number()?,
            last: input.number()?,
            count: input.u32()?,
            is_final: flags & 2 != 0,
        },
        HEARTBEAT_FRAG => Submessage::FragmentHeartbeat {
            reader: input.array()?,
            writer: input.array()?,
            number: input.number()?,
        },
        GAP => {
            let (reader, writer) = (input.array()?, input.array()?);
            let (start, base) = (input.number()?, input.number()?);
            Submessage::Gap {
                reader,
                writer,
                range: (start, base),
                listed: input.set(base)?,
            }
        }
        ACKNACK => {
            let (reader, writer, base) = (input.array()?, input.array()?, input.number()?);
            Submessage::Acknowledge {
                reader,
                writer,
                base,
                missing: input.set(base)?,
                count: input.u32()?,
                is_final: flags & 2 != 0,
            }
        }
        NACK_FRAG => {
            let (reader, writer, number) = (input.array()?, input.array()?, input.number()?);
            let base = input.u32()?.into();
            Submessage::MissingFragments {
                reader,
                writer,
                number,
                missing: input.set(base)?,
                count: input.u32()?,
            }
        }
        _ => Submessage::Other,
    })
}

/// Returns a message without its padding.
pub(crate) fn unpadded(payload: &[u8]) -> Vec<u8> {
    let mut message = payload.to_vec();
    if let Some(&[_, _, _, options]) = message.first_chunk::<4>() {
        let padding = usize::from(options & 3);
        if message.len() >= 4 + padding {
            message[3] = options & !3;
            message.truncate(message.len() - padding);
        }
    }
    message
}

type DataHead<'a> = (EntityId, EntityId, u64, Option<(&'a [u8], bool)>);

fn data_head<'a>(flags: u8, input: &mut Input<'a>) -> Result<DataHead<'a>, Malformed> {
    input.take(2)?;
    let to_parameters = input.u16()?;
    let head = (input.array()?, input.array()?, input.number()?);
    input.take(
        usize::from(to_parameters)
            .checked_sub(16)
            .ok_or(Malformed)?,
    )?;
    let parameters = if flags & 2 != 0 {
        let list = input.rest();
        let length = skip_parameters(input)?;
        list.get(..length).map(|list| (list, input.little))
    } else {
        None
    };
    Ok((head.0, head.1, head.2, parameters))
}

/// Returns the number of bytes skipped.
fn skip_parameters(input: &mut Input<'_>) -> Result<usize, Malformed> {
    let mut length = 0;
    loop {
        let (parameter, size) = (input.u16()?, input.u16()?);
        if parameter == 1 {
            return Ok(length + 4);
        }
        input.take(size.into())?;
        length += 4 + usize::from(size);
    }
}

/// Writer of one datagram.
pub(crate) struct Output {
    bytes: Vec<u8>,
}

impl Output {
    /// Starts a datagram with the header and, unless it is for everyone, the destination.
    pub(crate) fn new(from: Prefix, to: Option<Prefix>) -> Self {
        // Version 2.3; no vendor, because the OMG assigns vendor identifiers.
        let mut bytes = b"RTPS\x02\x03\x00\x00".to_vec();
        bytes.extend(from);
        debug_assert_eq!(bytes.len(), HEADER);
        let mut output = Self { bytes };
        if let Some(to) = to {
            output.submessage(INFO_DST, 0, |bytes| bytes.extend(to));
        }
        output
    }

    pub(crate) fn len(&self) -> usize {
        self.bytes.len()
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.bytes
    }

    fn submessage(&mut self, kind: u8, flags: u8, body: impl FnOnce(&mut Vec<u8>)) {
        self.bytes.extend([kind, flags | 1, 0, 0]);
        let start = self.bytes.len();
        body(&mut self.bytes);
        while !self.bytes.len().is_multiple_of(4) {
            self.bytes.push(0);
        }
        let length = (self.bytes.len() - start) as u16;
        self.bytes[start - 2..start].copy_from_slice(&length.to_le_bytes());
    }

    /// Source time of the following submessages: seconds since 1970, and units of 2^-32 s.
    pub(crate) fn stamp(&mut self, (seconds, fraction): (u32, u32)) {
        self.submessage(INFO_TS, 0, |bytes| {
            bytes.extend(seconds.to_le_bytes());
            bytes.extend(fraction.to_le_bytes());
        });
    }

    /// Writes a message that fits into the datagram; with inline parameters, it is the key of an endpoint that is gone.
    pub(crate) fn data(
        &mut self,
        (reader, writer): (EntityId, EntityId),
        number: u64,
        parameters: &[u8],
        payload: &[u8],
    ) {
        let flags = if parameters.is_empty() { 4 } else { 8 | 2 };
        self.submessage(DATA, flags, |bytes| {
            bytes.extend([0, 0, 16, 0]);
            head(bytes, reader, writer, number);
            bytes.extend(parameters);
            bytes.extend(payload);
            // Number of padding bytes, in the options of the encapsulation (OMG DDS-XTypes 1.3, 7.6.3.1.2).
            let padding = payload.len().next_multiple_of(4) - payload.len();
            let options = bytes.len() - payload.len() + 3;
            if let Some(options) = bytes.get_mut(options) {
                *options |= padding as u8;
            }
        });
    }

    /// Writes `count` fragments of `size` bytes of a message, from fragment `start` on, counted from 1.
    pub(crate) fn fragments(
        &mut self,
        (reader, writer): (EntityId, EntityId),
        number: u64,
        (start, count, size): (u32, u16, u16),
        message: &[u8],
    ) {
        let from = (start as usize - 1) * usize::from(size);
        let end = (from + usize::from(count) * usize::from(size)).min(message.len());
        self.submessage(DATA_FRAG, 0, |bytes| {
            bytes.extend([0, 0, 28, 0]);
            head(bytes, reader, writer, number);
            bytes.extend(start.to_le_bytes());
            bytes.extend(count.to_le_bytes());
            bytes.extend(size.to_le_bytes());
            bytes.extend((message.len() as u32).to_le_bytes());
            bytes.extend(&message[from..end]);
        });
    }

    pub(crate) fn heartbeat(
        &mut self,
        (reader, writer): (EntityId, EntityId),
        (first, last): (u64, u64),
        count: u32,
    ) {
        self.submessage(HEARTBEAT, 0, |bytes| {
            head(bytes, reader, writer, first);
            sequence_number(bytes, last);
            bytes.extend(count.to_le_bytes());
        });
    }

    /// Writes a gap: numbers from the first up to but excluding the second are not sent.
    pub(crate) fn gap(
        &mut self,
        (reader, writer): (EntityId, EntityId),
        (first, after): (u64, u64),
    ) {
        self.submessage(GAP, 0, |bytes| {
            head(bytes, reader, writer, first);
            sequence_number(bytes, after);
            bytes.extend(0u32.to_le_bytes());
        });
    }

    /// Writes an acknowledgement of everything below `base`, and requests `missing`, in ascending order.
    pub(crate) fn acknowledge(
        &mut self,
        (reader, writer): (EntityId, EntityId),
        base: u64,
        missing: &[u64],
        count: u32,
        is_final: bool,
    ) {
        self.submessage(ACKNACK, if is_final { 2 } else { 0 }, |bytes| {
            head(bytes, reader, writer, base);
            set(bytes, base, missing);
            bytes.extend(count.to_le_bytes());
        });
    }

    pub(crate) fn missing_fragments(
        &mut self,
        (reader, writer): (EntityId, EntityId),
        number: u64,
        missing: &[u64],
        count: u32,
    ) {
        let Some(&base) = missing.first() else {
            return;
        };
        self.submessage(NACK_FRAG, 0, |bytes| {
            head(bytes, reader, writer, number);
            bytes.extend((base as u32).to_le_bytes());
            set(bytes, base, missing);
            bytes.extend(count.to_le_bytes());
        });
    }
}

fn head(bytes: &mut Vec<u8>, reader: EntityId, writer: EntityId, number: u64) {
    bytes.extend(reader);
    bytes.extend(writer);
    sequence_number(bytes, number);
}

fn sequence_number(bytes: &mut Vec<u8>, number: u64) {
    bytes.extend(((number >> 32) as u32).to_le_bytes());
    bytes.extend((number as u32).to_le_bytes());
}

/// Returns the `numbers` within 256 of `base`.
fn set(bytes: &mut Vec<u8>, base: u64, numbers: &[u64]) {
    let mut words = [0u32; 8];
    let mut count = 0;
    for number in numbers {
        let bit = number - base;
        if bit >= 256 {
            break;
        }
        words[bit as usize / 32] |= 1 << (31 - bit % 32);
        count = bit as u32 + 1;
    }
    bytes.extend(count.to_le_bytes());
    for word in &words[..count.div_ceil(32) as usize] {
        bytes.extend(word.to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const READER: EntityId = [0, 0, 1, 4];
    const WRITER: EntityId = [0, 0, 2, 3];

    fn only(datagram: &[u8]) -> Submessage<'_> {
        let (_, mut parts) = parse(datagram).expect("a datagram");
        let part = parts.next().expect("a submessage").expect("well formed");
        assert!(parts.next().is_none());
        part
    }

    /// The example of a bitmap in the specification, 9.4.2.6: `1234/12:00110`.
    #[test]
    fn sets_are_those_of_the_specification() {
        let mut bytes = Vec::new();
        set(&mut bytes, 1234, &[1236, 1237]);
        assert_eq!(bytes, [4, 0, 0, 0, 0, 0, 0, 0x30]);
        let mut bytes = 12u32.to_le_bytes().to_vec();
        bytes.extend(0x3000_0000_u32.to_le_bytes());
        assert_eq!(Input::new(&bytes, true).set(1234), Ok(vec![1236, 1237]));
    }

    #[test]
    fn what_is_written_is_read() {
        let mut output = Output::new([7; 12], None);
        output.acknowledge((READER, WRITER), 5, &[5, 260, 400], 3, true);
        assert_eq!(
            only(&output.finish()),
            Submessage::Acknowledge {
                reader: READER,
                writer: WRITER,
                base: 5,
                // 400 is beyond the span of a set.
                missing: vec![5, 260],
                count: 3,
                is_final: true
            }
        );
        let message: Vec<u8> = (0..10).collect();
        let mut output = Output::new([7; 12], None);
        output.fragments((READER, WRITER), 1 << 33, (2, 2, 4), &message);
        let datagram = output.finish();
        let Submessage::Fragments(fragments) = only(&datagram) else {
            panic!("not fragments");
        };
        assert_eq!(fragments.number, 1 << 33);
        assert_eq!((fragments.start, fragments.count), (2, 2));
        // Submessages are padded to four bytes.
        assert_eq!(fragments.payload[..6], [4, 5, 6, 7, 8, 9]);
    }

    /// Any prefix of any datagram, and any damaged byte, is read without panic.
    #[test]
    fn damage_is_refused() {
        let mut output = Output::new([7; 12], Some([8; 12]));
        output.stamp((1, 2));
        output.data(
            (READER, WRITER),
            1,
            &[0x71, 0, 4, 0, 0, 0, 0, 3, 1, 0, 0, 0],
            &[0; 20],
        );
        output.heartbeat((READER, WRITER), (1, 2), 1);
        output.gap((READER, WRITER), (1, 2));
        output.missing_fragments((READER, WRITER), 1, &[1, 9], 1);
        let datagram = output.finish();
        let whole =
            |bytes: &[u8]| parse(bytes).is_ok_and(|(_, mut parts)| parts.all(|part| part.is_ok()));
        assert!(whole(&datagram));
        for end in HEADER + 4..datagram.len() {
            let _ = whole(&datagram[..end]);
        }
        assert!(!whole(&datagram[..datagram.len() - 1]));
        for at in 0..datagram.len() {
            let mut damaged = datagram.clone();
            damaged[at] = 0xff;
            let _ = whole(&damaged);
        }
        assert!(!whole(b"RTPX\x02\x03\x00\x00aaaabbbbcccc"));
    }
}
