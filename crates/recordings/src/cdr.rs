//! CDR, the encoding of ROS 2 messages (OMG DDS-XTypes 1.3, 7.4): numbers aligned to their size, strings and sequences
//! prefixed by their length.

use lsdc_files::error::{Cause, Error, Result};

/// Reads a message without reading beyond its end. A length is checked against the remaining bytes before memory is
/// allocated for it.
pub(crate) struct CdrReader<'a> {
    /// The bytes after the four-byte encapsulation header.
    body: &'a [u8],
    at: usize,
    big_endian: bool,
    /// Largest alignment of numbers.
    widest: usize,
}

macro_rules! numbers {
    ($($name:ident $type:ty)*) => {$(
        pub(crate) fn $name(&mut self) -> Result<$type> {
            let bytes = self.number()?;
            Ok(if self.big_endian {
                <$type>::from_be_bytes(bytes)
            } else {
                <$type>::from_le_bytes(bytes)
            })
        }
    )*};
}

impl<'a> CdrReader<'a> {
    /// Starts reading a whole message.
    pub(crate) fn new(message: &'a [u8]) -> Result<Self> {
        let Some((&[0, kind, ..], body)) = message.split_first_chunk::<4>() else {
            return Err(damaged("does not begin as CDR does"));
        };
        // CDR and, of its second version, the encoding of final types.
        let (big_endian, widest) = match kind {
            0 => (true, 8),
            1 => (false, 8),
            6 => (true, 4),
            7 => (false, 4),
            _ => {
                return Err(damaged(format!(
                    "is written in a way ({kind}) that is not read"
                )));
            }
        };
        Ok(Self {
            body,
            at: 0,
            big_endian,
            widest,
        })
    }

    numbers!(u8 u8 u32 u32 i32 i32 f64 f64);

    /// Reads a string, which ends with a zero. Invalid UTF-8 is replaced.
    pub(crate) fn string(&mut self) -> Result<String> {
        let bytes = self.bytes()?;
        let text = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        Ok(String::from_utf8_lossy(text).into_owned())
    }

    /// Reads a sequence of bytes.
    pub(crate) fn bytes(&mut self) -> Result<&'a [u8]> {
        let length = self.u32()? as usize;
        self.take(length)
    }

    /// Reads the length of a sequence whose elements have at least `least` bytes each.
    pub(crate) fn length(&mut self, least: usize) -> Result<usize> {
        let length = self.u32()? as usize;
        let left = self.body.len() - self.at;
        if length > left / least {
            return Err(damaged(format!(
                "says that {length} elements follow, but ends before"
            )));
        }
        Ok(length)
    }

    /// Reads `N` numbers without a length prefix.
    pub(crate) fn array<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N]> {
        self.at = self.at.next_multiple_of(N.min(self.widest));
        let bytes = self.take(N)?;
        bytes.try_into().map_err(|_| damaged("ends too early"))
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8]> {
        let rest = self.body.get(self.at..).unwrap_or_default();
        let taken = rest
            .get(..length)
            .ok_or_else(|| damaged("ends too early"))?;
        self.at += length;
        Ok(taken)
    }
}

/// Error of a malformed message; the caller adds which message it is.
pub(crate) fn damaged(what: impl Into<String>) -> Error {
    Error::new(Cause::Format, what)
}

/// Writes a message in little-endian order.
pub(crate) struct CdrWriter(Vec<u8>);

/// Encapsulation header of messages: little-endian CDR.
const HEAD: [u8; 4] = [0, 1, 0, 0];

impl CdrWriter {
    /// Creates a writer with capacity for `bytes` bytes.
    pub(crate) fn with_capacity(bytes: usize) -> Self {
        let mut message = Vec::with_capacity(HEAD.len() + bytes);
        message.extend(HEAD);
        Self(message)
    }

    pub(crate) fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub(crate) fn u32(&mut self, value: u32) {
        self.aligned(&value.to_le_bytes());
    }

    pub(crate) fn i32(&mut self, value: i32) {
        self.aligned(&value.to_le_bytes());
    }

    pub(crate) fn f64(&mut self, value: f64) {
        self.aligned(&value.to_le_bytes());
    }

    pub(crate) fn string(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.0.extend(text.as_bytes());
        self.0.push(0);
    }

    /// Writes a sequence of bytes.
    pub(crate) fn bytes(&mut self, bytes: impl ExactSizeIterator<Item = u8>) {
        self.u32(bytes.len() as u32);
        self.0.extend(bytes);
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.0
    }

    fn aligned(&mut self, bytes: &[u8]) {
        let written = (self.0.len() - HEAD.len()).next_multiple_of(bytes.len());
        self.0.resize(HEAD.len() + written, 0);
        self.0.extend(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_aligned_to_their_size() {
        let mut writer = CdrWriter::with_capacity(0);
        writer.u8(7);
        writer.f64(0.5);
        writer.string("ab");
        writer.i32(-2);
        let message = writer.finish();
        // After the header: 7, seven bytes of padding, 0.5; 3, "ab", 0, one byte of padding, -2.
        assert_eq!(message.len(), 4 + 16 + 4 + 3 + 1 + 4);
        let mut reader = CdrReader::new(&message).unwrap();
        assert_eq!(reader.u8().unwrap(), 7);
        assert_eq!(reader.f64().unwrap(), 0.5);
        assert_eq!(reader.string().unwrap(), "ab");
        assert_eq!(reader.i32().unwrap(), -2);
        assert!(reader.u8().is_err());
    }

    #[test]
    fn both_orders_of_bytes_and_both_versions_are_read() {
        let big = [
            0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0x3f, 0xe0, 0, 0, 0, 0, 0, 0,
        ];
        let mut reader = CdrReader::new(&big).unwrap();
        assert_eq!((reader.u8().unwrap(), reader.f64().unwrap()), (1, 0.5));
        // The second version aligns eight-byte numbers to four bytes.
        let second = [0, 7, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xe0, 0x3f];
        let mut reader = CdrReader::new(&second).unwrap();
        assert_eq!((reader.u8().unwrap(), reader.f64().unwrap()), (1, 0.5));
        for head in [&[0, 3, 0, 0][..], &[1, 1, 0, 0], &[0, 1]] {
            assert!(CdrReader::new(head).is_err());
        }
    }

    #[test]
    fn no_length_is_believed() {
        let endless = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff, 1, 2];
        assert!(CdrReader::new(&endless).unwrap().bytes().is_err());
        assert!(CdrReader::new(&endless).unwrap().length(1).is_err());
        assert!(CdrReader::new(&endless).unwrap().string().is_err());
    }
}
