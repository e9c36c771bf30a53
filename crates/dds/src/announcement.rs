//! Announcements of participants, readers and writers: lists of parameters (OMG DDSI-RTPS 2.5,
//! chapters 9.4.2.11 and 9.6.3).

use std::{
    net::{Ipv4Addr, SocketAddrV4},
    time::Duration,
};

use crate::{
    qos::Qos,
    wire::{Guid, Input, Malformed, PARTICIPANT, Prefix},
};

/// A participant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ParticipantData {
    pub(crate) prefix: Prefix,
    pub(crate) name: String,
    /// Where announcements of readers and writers are received.
    pub(crate) discovery: Vec<SocketAddrV4>,
    /// Where messages are received.
    pub(crate) messages: Vec<SocketAddrV4>,
    /// It counts as gone after being silent for this long.
    pub(crate) lease: Duration,
    /// Differs only with security profiles and in other domains.
    pub(crate) domain: Option<u32>,
    /// Its built-in readers and writers, one bit each.
    pub(crate) builtin: u32,
}

/// A reader or a writer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct EndpointData {
    pub(crate) guid: Guid,
    pub(crate) topic: String,
    pub(crate) message_type: String,
    pub(crate) qos: Qos,
    /// `typehash=...;`, by which ROS 2 from Iron on tells types of the same name apart.
    pub(crate) user_data: Vec<u8>,
    /// Overrides the addresses of its participant.
    pub(crate) addresses: Vec<SocketAddrV4>,
    /// It has a partition or accepts only another data representation, so it is not matched.
    pub(crate) is_apart: bool,
}

/// Both built-in readers and both writers for the announcements of readers and writers, and of participants.
pub(crate) const BUILTIN: u32 = 0b11_1111;

const SENTINEL: u16 = 0x01;
const LEASE: u16 = 0x02;
const TOPIC_NAME: u16 = 0x05;
const TYPE_NAME: u16 = 0x07;
const DOMAIN: u16 = 0x0f;
const VERSION: u16 = 0x15;
const VENDOR: u16 = 0x16;
const RELIABILITY: u16 = 0x1a;
const DURABILITY: u16 = 0x1d;
const PARTITION: u16 = 0x29;
const USER_DATA: u16 = 0x2c;
const UNICAST: u16 = 0x2f;
const MESSAGES_UNICAST: u16 = 0x31;
const DISCOVERY_UNICAST: u16 = 0x32;
const HISTORY: u16 = 0x40;
const PARTICIPANT_GUID: u16 = 0x50;
const BUILTIN_ENDPOINTS: u16 = 0x58;
const ENDPOINT_GUID: u16 = 0x5a;
const ENTITY_NAME: u16 = 0x62;
const KEY_HASH: u16 = 0x70;
const STATUS: u16 = 0x71;
const REPRESENTATION: u16 = 0x73;

/// A list of parameters, little-endian.
struct List(Vec<u8>);

impl List {
    fn payload() -> Self {
        Self(vec![0, 3, 0, 0])
    }

    fn add(&mut self, parameter: u16, value: &[u8]) {
        let padding = value.len().next_multiple_of(4) - value.len();
        self.0.extend(parameter.to_le_bytes());
        self.0
            .extend(((value.len() + padding) as u16).to_le_bytes());
        self.0.extend(value);
        self.0.extend(&[0; 3][..padding]);
    }

    fn number(&mut self, parameter: u16, value: u32) {
        self.add(parameter, &value.to_le_bytes());
    }

    fn string(&mut self, parameter: u16, value: &str) {
        let mut bytes = (value.len() as u32 + 1).to_le_bytes().to_vec();
        bytes.extend(value.as_bytes());
        bytes.push(0);
        self.add(parameter, &bytes);
    }

    fn bytes(&mut self, parameter: u16, value: &[u8]) {
        let mut bytes = (value.len() as u32).to_le_bytes().to_vec();
        bytes.extend(value);
        self.add(parameter, &bytes);
    }

    fn address(&mut self, parameter: u16, address: SocketAddrV4) {
        let mut bytes = 1u32.to_le_bytes().to_vec();
        bytes.extend(u32::from(address.port()).to_le_bytes());
        bytes.extend([0; 12]);
        bytes.extend(address.ip().octets());
        self.add(parameter, &bytes);
    }

    fn finish(mut self) -> Vec<u8> {
        self.add(SENTINEL, &[]);
        self.0
    }
}

/// Inline parameters beside the key of an endpoint that is gone.
pub(crate) fn gone(guid: Guid) -> Vec<u8> {
    let mut list = List(Vec::new());
    list.add(KEY_HASH, &guid.to_bytes());
    // Disposed and unregistered; big-endian in either byte order.
    list.add(STATUS, &[0, 0, 0, 3]);
    list.finish()
}

/// The key of a participant, a reader or a writer that is gone.
pub(crate) fn key(guid: Guid) -> Vec<u8> {
    let mut list = List::payload();
    let parameter = match guid.entity {
        PARTICIPANT => PARTICIPANT_GUID,
        _ => ENDPOINT_GUID,
    };
    list.add(parameter, &guid.to_bytes());
    list.finish()
}

/// The endpoint that a submessage declares gone by its parameters and key, if it does.
pub(crate) fn whose_end(
    parameters: Option<(&[u8], bool)>,
    payload: &[u8],
    is_key: bool,
) -> Result<Option<Guid>, Malformed> {
    let mut guid = None;
    let mut is_gone = is_key;
    if let Some((list, little)) = parameters {
        for parameter in Parameters(Input::new(list, little)) {
            match parameter? {
                (KEY_HASH, mut value) => guid = Some(Guid::from_bytes(value.array()?)),
                (STATUS, mut value) => is_gone = value.array::<4>()?[3] & 3 != 0,
                _ => {}
            }
        }
    }
    if !is_gone {
        return Ok(None);
    }
    if is_key && let Ok(parameters) = of_payload(payload) {
        for parameter in parameters {
            if let (PARTICIPANT_GUID | ENDPOINT_GUID, mut value) = parameter? {
                guid = Some(Guid::from_bytes(value.array()?));
            }
        }
    }
    Ok(guid)
}

/// Parameters up to the sentinel.
struct Parameters<'a>(Input<'a>);

fn of_payload(payload: &[u8]) -> Result<Parameters<'_>, Malformed> {
    match payload.split_first_chunk::<4>() {
        Some(([0, kind @ (2 | 3), _, _], list)) => Ok(Parameters(Input::new(list, *kind == 3))),
        _ => Err(Malformed),
    }
}

impl<'a> Iterator for Parameters<'a> {
    type Item = Result<(u16, Input<'a>), Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        let mut read = || {
            let (parameter, length) = (self.0.u16()?, self.0.u16()?);
            if parameter == SENTINEL {
                return Ok(None);
            }
            let value = Input::new(self.0.take(length.into())?, self.0.little);
            Ok(Some((parameter, value)))
        };
        read().transpose()
    }
}

fn string(value: &mut Input<'_>) -> Result<String, Malformed> {
    let bytes = bytes(value)?;
    Ok(String::from_utf8_lossy(bytes.strip_suffix(&[0]).unwrap_or(bytes)).into_owned())
}

fn bytes<'a>(value: &mut Input<'a>) -> Result<&'a [u8], Malformed> {
    let length = value.u32()?;
    value.take(length as usize)
}

/// An IPv4 address; others are ignored.
fn address(value: &mut Input<'_>) -> Result<Option<SocketAddrV4>, Malformed> {
    let (kind, port) = (value.u32()?, value.u32()?);
    let [.., a, b, c, d] = value.array::<16>()?;
    let port = u16::try_from(port).ok().filter(|port| *port > 0);
    Ok(port
        .filter(|_| kind == 1)
        .map(|port| SocketAddrV4::new(Ipv4Addr::new(a, b, c, d), port)))
}

impl ParticipantData {
    pub(crate) fn write(&self) -> Vec<u8> {
        let mut list = List::payload();
        list.add(VERSION, &[2, 3]);
        list.add(VENDOR, &[0, 0]);
        list.add(
            PARTICIPANT_GUID,
            &Guid::new(self.prefix, PARTICIPANT).to_bytes(),
        );
        list.number(BUILTIN_ENDPOINTS, self.builtin);
        if let Some(domain) = self.domain {
            list.number(DOMAIN, domain);
        }
        let mut lease = (self.lease.as_secs() as u32).to_le_bytes().to_vec();
        lease.extend(0u32.to_le_bytes());
        list.add(LEASE, &lease);
        for &address in &self.discovery {
            list.address(DISCOVERY_UNICAST, address);
        }
        for &address in &self.messages {
            list.address(MESSAGES_UNICAST, address);
        }
        // Without an enclave, nodes of the participant are not listed by `ros2 node list`.
        list.bytes(USER_DATA, b"enclave=/;");
        list.string(ENTITY_NAME, &self.name);
        list.finish()
    }

    pub(crate) fn read(payload: &[u8]) -> Result<Self, Malformed> {
        let mut prefix = None;
        let mut data = Self {
            prefix: [0; 12],
            name: String::new(),
            discovery: Vec::new(),
            messages: Vec::new(),
            // The default of the specification.
            lease: Duration::from_secs(100),
            domain: None,
            builtin: 0,
        };
        for parameter in of_payload(payload)? {
            let (parameter, mut value) = parameter?;
            match parameter {
                PARTICIPANT_GUID => prefix = Some(value.array()?),
                BUILTIN_ENDPOINTS => data.builtin = value.u32()?,
                DOMAIN => data.domain = Some(value.u32()?),
                LEASE => data.lease = Duration::from_secs(value.u32()?.into()),
                DISCOVERY_UNICAST => data.discovery.extend(address(&mut value)?),
                MESSAGES_UNICAST => data.messages.extend(address(&mut value)?),
                ENTITY_NAME => data.name = string(&mut value)?,
                _ => {}
            }
        }
        data.prefix = prefix.ok_or(Malformed)?;
        Ok(data)
    }
}

impl EndpointData {
    pub(crate) fn write(&self) -> Vec<u8> {
        let mut list = List::payload();
        list.add(ENDPOINT_GUID, &self.guid.to_bytes());
        list.add(
            PARTICIPANT_GUID,
            &Guid::new(self.guid.prefix, PARTICIPANT).to_bytes(),
        );
        list.string(TOPIC_NAME, &self.topic);
        list.string(TYPE_NAME, &self.message_type);
        list.number(DURABILITY, self.qos.transient_local.into());
        // Followed by the time that a write may block, which none does here.
        let mut reliability = (u32::from(self.qos.reliable) + 1).to_le_bytes().to_vec();
        reliability.extend(0u32.to_le_bytes());
        reliability.extend((1u32 << 29).to_le_bytes());
        list.add(RELIABILITY, &reliability);
        let mut history = 0u32.to_le_bytes().to_vec();
        history.extend((self.qos.depth as u32).to_le_bytes());
        list.add(HISTORY, &history);
        if !self.user_data.is_empty() {
            list.bytes(USER_DATA, &self.user_data);
        }
        list.finish()
    }

    /// Reads the announcement of a reader or a writer, whose defaults differ.
    pub(crate) fn read(payload: &[u8], is_writer: bool) -> Result<Self, Malformed> {
        let mut guid = None;
        let mut data = Self {
            guid: Guid::new([0; 12], [0; 4]),
            topic: String::new(),
            message_type: String::new(),
            qos: Qos {
                reliable: is_writer,
                transient_local: false,
                depth: 1,
            },
            user_data: Vec::new(),
            addresses: Vec::new(),
            is_apart: false,
        };
        for parameter in of_payload(payload)? {
            let (parameter, mut value) = parameter?;
            match parameter {
                ENDPOINT_GUID => guid = Some(Guid::from_bytes(value.array()?)),
                TOPIC_NAME => data.topic = string(&mut value)?,
                TYPE_NAME => data.message_type = string(&mut value)?,
                DURABILITY => data.qos.transient_local = value.u32()? > 0,
                // 2; 3 in the first implementations.
                RELIABILITY => data.qos.reliable = value.u32()? >= 2,
                USER_DATA => data.user_data = bytes(&mut value)?.into(),
                UNICAST => data.addresses.extend(address(&mut value)?),
                PARTITION => {
                    let count = value.u32()?;
                    data.is_apart |= count > 0 && !(count == 1 && string(&mut value)?.is_empty());
                }
                // Messages here are XCDR1; a reader that lists others only cannot read them.
                REPRESENTATION if !is_writer => {
                    let count = value.u32()?;
                    let mut accepts = count == 0;
                    for _ in 0..count {
                        accepts |= value.u16()? == 0;
                    }
                    data.is_apart |= !accepts;
                }
                _ => {}
            }
        }
        data.guid = guid.ok_or(Malformed)?;
        Ok(data)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_announced_is_read() {
        let participant = ParticipantData {
            prefix: [5; 12],
            name: "/lsdc".into(),
            discovery: vec![SocketAddrV4::new([10, 0, 0, 2].into(), 7410)],
            messages: vec![
                SocketAddrV4::new([10, 0, 0, 2].into(), 7411),
                SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7411),
            ],
            lease: Duration::from_secs(10),
            domain: Some(7),
            builtin: BUILTIN,
        };
        assert_eq!(ParticipantData::read(&participant.write()), Ok(participant));
        for is_writer in [false, true] {
            let endpoint = EndpointData {
                guid: Guid::new([5; 12], [0, 0, 1, 3]),
                topic: "rt/tf_static".into(),
                message_type: "tf2_msgs::msg::dds_::TFMessage_".into(),
                qos: Qos::LATCHED,
                user_data: b"typehash=RIHS01_0;".to_vec(),
                addresses: Vec::new(),
                is_apart: false,
            };
            assert_eq!(
                EndpointData::read(&endpoint.write(), is_writer),
                Ok(endpoint)
            );
        }
    }

    #[test]
    fn the_end_is_read_from_key_or_hash() {
        let guid = Guid::new([5; 12], [0, 0, 1, 3]);
        let (parameters, key) = (gone(guid), key(guid));
        for (parameters, key, is_key) in [
            (Some(parameters.as_slice()), key.as_slice(), true),
            (Some(&parameters), &[], false),
            (None, &key, true),
        ] {
            let parameters = parameters.map(|list| (list, true));
            assert_eq!(whose_end(parameters, key, is_key), Ok(Some(guid)));
        }
        assert_eq!(whose_end(None, &key, false), Ok(None));
    }

    #[test]
    fn damage_is_refused() {
        let endpoint = EndpointData {
            guid: Guid::new([5; 12], [0, 0, 1, 3]),
            topic: "rt/a".into(),
            message_type: "a".into(),
            qos: Qos::DEFAULT,
            user_data: Vec::new(),
            addresses: Vec::new(),
            is_apart: false,
        };
        let payload = endpoint.write();
        for end in 0..payload.len() {
            assert!(EndpointData::read(&payload[..end], true).is_err());
        }
        for at in 0..payload.len() {
            let mut damaged = payload.clone();
            damaged[at] = 0xff;
            let _ = EndpointData::read(&damaged, false);
            let _ = ParticipantData::read(&damaged);
        }
    }
}
