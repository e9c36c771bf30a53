//! A participant without its sockets and clocks: datagrams and the time in, datagrams and messages out.

use std::{
    collections::BTreeMap,
    net::{Ipv4Addr, SocketAddrV4},
    ops::RangeBounds,
    sync::Arc,
    time::{Duration, Instant},
};

use crate::{
    announcement::{self, BUILTIN, EndpointData, ParticipantData},
    interfaces::Interfaces,
    names,
    qos::Qos,
    reader::{Reader, ReceptionCounts},
    wire::{
        self, EntityId, Guid, Malformed, Output, PARTICIPANT, PUBLICATIONS_READER,
        PUBLICATIONS_WRITER, Prefix, SPDP_READER, SPDP_WRITER, SUBSCRIPTIONS_READER,
        SUBSCRIPTIONS_WRITER, Submessage, UNKNOWN,
    },
    writer::{Datagram, Destination, Writer},
};

/// A participant that has been silent for this long is gone. Announcements come at least three times as often.
const LEASE: Duration = Duration::from_secs(10);

/// Interval between announcements: the first few, and later ones.
const ANNOUNCE: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(3)];
const FIRST_ANNOUNCEMENTS: u64 = 10;

/// Interval between heartbeats while something is unacknowledged: of topics, and of announcements.
const HEARTBEAT: Duration = Duration::from_millis(20);
const BUILTIN_HEARTBEAT: Duration = Duration::from_millis(100);

/// Limits of remote participants and of their readers and writers; further ones are refused.
const PARTICIPANTS: usize = 1000;
const ENDPOINTS: usize = 20_000;

/// Largest announcement, in bytes.
const ANNOUNCEMENT: usize = 1 << 20;

/// A topic of DDS and what a reader or a writer of it needs.
#[derive(Clone, Debug)]
pub(crate) struct TopicName {
    pub(crate) topic: String,
    pub(crate) message_type: String,
    pub(crate) user_data: Vec<u8>,
}

/// Another participant of the domain.
struct Peer {
    data: ParticipantData,
    heard: Instant,
    /// Source address of its announcement.
    from: Ipv4Addr,
}

/// A complete message and the reader it is for.
pub(crate) type Delivery = (EntityId, Vec<u8>);

/// A topic that a participant of the domain reads or writes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicInfo {
    /// Its name in ROS 2, such as `/camera/image_raw`.
    pub name: String,
    /// Its type in ROS 2, such as `sensor_msgs/msg/Image`.
    pub message_type: String,
    /// Number of publishers of other participants.
    pub publishers: usize,
    /// Number of subscribers of other participants.
    pub subscribers: usize,
}

/// Remote endpoints of a topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Matches {
    /// Publishers or subscribers with which messages are exchanged.
    pub matched: usize,
    /// Publishers or subscribers of the same topic with another type or an incompatible quality of service.
    pub incompatible: usize,
}

pub(crate) struct Engine {
    own: ParticipantData,
    interfaces: Interfaces,
    largest: usize,
    peers: BTreeMap<Prefix, Peer>,
    remote_writers: BTreeMap<Guid, EndpointData>,
    remote_readers: BTreeMap<Guid, EndpointData>,
    writers: BTreeMap<EntityId, (EndpointData, Writer)>,
    readers: BTreeMap<EntityId, (EndpointData, Reader)>,
    publications: Writer,
    subscriptions: Writer,
    publications_reader: Reader,
    subscriptions_reader: Reader,
    entities: u32,
    announcements: u64,
    announce_at: Instant,
    /// Datagrams that were not of RTPS or contradicted themselves.
    pub(crate) malformed: u64,
    /// Announcements beyond the limits, or without an address that is reached.
    pub(crate) not_admitted: u64,
}

impl Engine {
    pub(crate) fn new(
        prefix: Prefix,
        domain: u32,
        name: String,
        interfaces: Interfaces,
        (discovery_port, messages_port): (u16, u16),
        largest: usize,
        now: Instant,
    ) -> Self {
        let at = |port| {
            let addresses = interfaces.announced();
            addresses
                .iter()
                .map(|&ip| SocketAddrV4::new(ip, port))
                .collect()
        };
        let own = ParticipantData {
            prefix,
            name,
            discovery: at(discovery_port),
            messages: at(messages_port),
            lease: LEASE,
            domain: Some(domain),
            builtin: BUILTIN,
        };
        let guid = |entity| Guid::new(prefix, entity);
        let writer = |entity| Writer::new(guid(entity), None, true, BUILTIN_HEARTBEAT);
        let reader = |entity| Reader::new(guid(entity), true, true, ANNOUNCEMENT);
        Self {
            publications: writer(PUBLICATIONS_WRITER),
            subscriptions: writer(SUBSCRIPTIONS_WRITER),
            publications_reader: reader(PUBLICATIONS_READER),
            subscriptions_reader: reader(SUBSCRIPTIONS_READER),
            own,
            interfaces,
            largest,
            peers: BTreeMap::new(),
            remote_writers: BTreeMap::new(),
            remote_readers: BTreeMap::new(),
            writers: BTreeMap::new(),
            readers: BTreeMap::new(),
            entities: 0,
            announcements: 0,
            announce_at: now,
            malformed: 0,
            not_admitted: 0,
        }
    }

    pub(crate) fn guid(&self, entity: EntityId) -> Guid {
        Guid::new(self.own.prefix, entity)
    }

    /// Announces this participant, if an announcement is due.
    pub(crate) fn announcement(&mut self, now: Instant) -> Option<Vec<u8>> {
        (now >= self.announce_at).then(|| {
            let early = self.announcements < FIRST_ANNOUNCEMENTS;
            self.announce_at = now + ANNOUNCE[usize::from(!early)];
            self.announcements += 1;
            self.announce(None)
        })
    }

    fn announce(&self, to: Option<Prefix>) -> Vec<u8> {
        let mut output = Output::new(self.own.prefix, to);
        let ids = (SPDP_READER, SPDP_WRITER);
        output.data(ids, self.announcements.max(1), &[], &self.own.write());
        output.finish()
    }

    /// Announces that this participant leaves.
    pub(crate) fn farewell(&self) -> Vec<u8> {
        let guid = self.guid(PARTICIPANT);
        let mut output = Output::new(self.own.prefix, None);
        output.data(
            (SPDP_READER, SPDP_WRITER),
            self.announcements + 1,
            &announcement::gone(guid),
            &announcement::key(guid),
        );
        output.finish()
    }

    /// Adds a writer of a topic.
    pub(crate) fn add_writer(
        &mut self,
        topic: TopicName,
        qos: Qos,
        stamp: (u32, u32),
        now: Instant,
        out: &mut Vec<Datagram>,
    ) -> EntityId {
        let data = self.endpoint(topic, qos, 0x03);
        let guid = data.guid;
        let depth = Some(qos.depth.max(1));
        let writer = Writer::new(guid, depth, qos.transient_local, HEARTBEAT);
        let announcement = data.write().into();
        self.publications.write(announcement, stamp, None, now, out);
        self.writers.insert(guid.entity, (data, writer));
        self.match_writers(.., now, out);
        guid.entity
    }

    /// Adds a reader of a topic.
    pub(crate) fn add_reader(
        &mut self,
        topic: TopicName,
        qos: Qos,
        stamp: (u32, u32),
        now: Instant,
        out: &mut Vec<Datagram>,
    ) -> EntityId {
        let data = self.endpoint(topic, qos, 0x04);
        let guid = data.guid;
        let reader = Reader::new(guid, qos.reliable, qos.transient_local, self.largest);
        let announcement = data.write().into();
        self.subscriptions
            .write(announcement, stamp, None, now, out);
        self.readers.insert(guid.entity, (data, reader));
        self.match_readers(.., now);
        guid.entity
    }

    fn endpoint(&mut self, topic: TopicName, qos: Qos, kind: u8) -> EndpointData {
        self.entities += 1;
        let [_, a, b, c] = self.entities.to_be_bytes();
        EndpointData {
            guid: self.guid([a, b, c, kind]),
            topic: topic.topic,
            message_type: topic.message_type,
            qos,
            user_data: topic.user_data,
            addresses: Vec::new(),
            is_apart: false,
        }
    }

    /// Removes a reader or a writer of this participant.
    pub(crate) fn remove(
        &mut self,
        entity: EntityId,
        stamp: (u32, u32),
        now: Instant,
        out: &mut Vec<Datagram>,
    ) {
        let guid = self.guid(entity);
        let announcements = if self.writers.remove(&entity).is_some() {
            &mut self.publications
        } else if self.readers.remove(&entity).is_some() {
            &mut self.subscriptions
        } else {
            return;
        };
        let key = announcement::key(guid).into();
        announcements.write(key, stamp, Some(guid), now, out);
    }

    /// Sends a message of a topic. [`sent`](Self::sent) follows when all datagrams are sent.
    pub(crate) fn write(
        &mut self,
        writer: EntityId,
        message: Arc<[u8]>,
        stamp: (u32, u32),
        now: Instant,
        out: &mut Vec<Datagram>,
    ) {
        if let Some((_, writer)) = self.writers.get_mut(&writer) {
            writer.write(message, stamp, None, now, out);
            writer.hold();
        }
    }

    pub(crate) fn sent(&mut self, writer: EntityId, now: Instant) {
        if let Some((_, writer)) = self.writers.get_mut(&writer) {
            writer.release(now);
        }
    }

    /// Sends what is due: heartbeats and requests; drops participants whose lease has expired.
    pub(crate) fn tick(&mut self, now: Instant, out: &mut Vec<Datagram>) {
        for writer in self
            .writers
            .values_mut()
            .map(|(_, writer)| writer)
            .chain([&mut self.publications, &mut self.subscriptions])
        {
            writer.tick(now, out);
        }
        for reader in self.readers.values_mut().map(|(_, reader)| reader).chain([
            &mut self.publications_reader,
            &mut self.subscriptions_reader,
        ]) {
            reader.tick(now, out);
        }
        let gone: Vec<Prefix> = self
            .peers
            .iter()
            .filter(|(_, peer)| now.saturating_duration_since(peer.heard) > peer.data.lease)
            .map(|(prefix, _)| *prefix)
            .collect();
        for prefix in gone {
            self.remove_peer(prefix);
        }
    }

    /// Handles a datagram. Messages that it completes are added to `ready`.
    pub(crate) fn receive(
        &mut self,
        datagram: &[u8],
        from: Ipv4Addr,
        now: Instant,
        out: &mut Vec<Datagram>,
        ready: &mut Vec<Delivery>,
    ) {
        let Ok((mut source, parts)) = wire::parse(datagram) else {
            self.malformed += 1;
            return;
        };
        if source == self.own.prefix {
            return;
        }
        let mut is_for_us = true;
        for part in parts {
            let taken = match part {
                Ok(Submessage::Destination(prefix)) => {
                    is_for_us = prefix == [0; 12] || prefix == self.own.prefix;
                    Ok(())
                }
                Ok(Submessage::Source(prefix)) => {
                    source = prefix;
                    Ok(())
                }
                Ok(part) if is_for_us => self.take((source, from), part, now, out, ready),
                Ok(_) => Ok(()),
                Err(error) => Err(error),
            };
            if taken.is_err() {
                self.malformed += 1;
                break;
            }
        }
        if let Some(peer) = self.peers.get_mut(&source) {
            peer.heard = now;
        }
    }

    fn take(
        &mut self,
        (source, address): (Prefix, Ipv4Addr),
        part: Submessage<'_>,
        now: Instant,
        out: &mut Vec<Datagram>,
        ready: &mut Vec<Delivery>,
    ) -> Result<(), Malformed> {
        let mut messages = Vec::new();
        match part {
            Submessage::Data {
                writer: SPDP_WRITER,
                parameters,
                payload,
                is_key,
                ..
            } => {
                if let Some(guid) = announcement::whose_end(parameters, payload, is_key)? {
                    self.remove_peer(guid.prefix);
                } else {
                    self.meet(ParticipantData::read(payload)?, address, now, out);
                }
                return Ok(());
            }
            Submessage::Data {
                writer,
                reader,
                number,
                parameters,
                payload,
                is_key,
            } => {
                let from = Guid::new(source, writer);
                let gone = announcement::whose_end(parameters, payload, is_key)?;
                self.each_reader(reader, from, |id, reader| {
                    let message = match gone {
                        // An announcement without a topic says that the endpoint is gone.
                        Some(guid) if is_builtin(id) => announcement::key(guid),
                        None if !is_key => wire::unpadded(payload),
                        _ => Vec::new(),
                    };
                    deliver(id, &mut messages, |ready| {
                        reader.data(from, number, message, ready);
                    });
                });
            }
            Submessage::Fragments(fragments) => {
                let from = Guid::new(source, fragments.writer);
                self.each_reader(fragments.reader, from, |id, reader| {
                    deliver(id, &mut messages, |ready| {
                        reader.fragments(from, &fragments, now, ready);
                    });
                });
            }
            Submessage::Heartbeat {
                writer,
                reader,
                first,
                last,
                count,
                is_final,
            } => {
                let from = Guid::new(source, writer);
                self.each_reader(reader, from, |id, reader| {
                    deliver(id, &mut messages, |ready| {
                        reader.heartbeat(from, (first, last), count, is_final, now, ready, out);
                    });
                });
            }
            Submessage::FragmentHeartbeat {
                writer,
                reader,
                number,
            } => {
                let from = Guid::new(source, writer);
                self.each_reader(reader, from, |_, reader| {
                    reader.fragment_heartbeat(from, number, now, out);
                });
            }
            Submessage::Gap {
                writer,
                reader,
                range,
                listed,
            } => {
                let from = Guid::new(source, writer);
                self.each_reader(reader, from, |id, reader| {
                    deliver(id, &mut messages, |ready| {
                        reader.gap(from, range, &listed, ready);
                    });
                });
            }
            Submessage::Acknowledge {
                writer,
                reader,
                base,
                missing,
                count,
                ..
            } => {
                let from = Guid::new(source, reader);
                if let Some(writer) = self.writer(writer) {
                    writer.acknowledged(from, base, &missing, count, out);
                }
            }
            Submessage::MissingFragments {
                writer,
                reader,
                number,
                missing,
                ..
            } => {
                let from = Guid::new(source, reader);
                if let Some(writer) = self.writer(writer) {
                    writer.missing_fragments(from, number, &missing, out);
                }
            }
            Submessage::Destination(_) | Submessage::Source(_) | Submessage::Other => {}
        }
        for (reader, message) in messages {
            match reader {
                PUBLICATIONS_READER => self.announced(&message, true, now, out)?,
                SUBSCRIPTIONS_READER => self.announced(&message, false, now, out)?,
                _ => ready.push((reader, message)),
            }
        }
        Ok(())
    }

    fn writer(&mut self, entity: EntityId) -> Option<&mut Writer> {
        match entity {
            PUBLICATIONS_WRITER => Some(&mut self.publications),
            SUBSCRIPTIONS_WRITER => Some(&mut self.subscriptions),
            _ => self.writers.get_mut(&entity).map(|(_, writer)| writer),
        }
    }

    /// Calls `take` with the reader of this identifier or, without one, with every reader matched to the writer.
    fn each_reader(
        &mut self,
        entity: EntityId,
        writer: Guid,
        mut take: impl FnMut(EntityId, &mut Reader),
    ) {
        let readers = self
            .readers
            .iter_mut()
            .map(|(id, (_, reader))| (*id, reader))
            .chain([
                (PUBLICATIONS_READER, &mut self.publications_reader),
                (SUBSCRIPTIONS_READER, &mut self.subscriptions_reader),
            ]);
        for (id, reader) in readers {
            if (entity == id || entity == UNKNOWN) && reader.has_writer(writer) {
                take(id, reader);
            }
        }
    }

    /// Handles the announcement of another participant.
    fn meet(
        &mut self,
        data: ParticipantData,
        from: Ipv4Addr,
        now: Instant,
        out: &mut Vec<Datagram>,
    ) {
        let prefix = data.prefix;
        let is_other_domain = data.domain.is_some() && data.domain != self.own.domain;
        if prefix == self.own.prefix || is_other_domain {
            return;
        }
        let known = self.peers.get(&prefix);
        if known.is_some_and(|peer| peer.data == data) {
            return;
        }
        let is_new = known.is_none();
        if is_new && self.peers.len() >= PARTICIPANTS {
            self.not_admitted += 1;
            return;
        }
        let Some(to) = self.interfaces.destination(&data.discovery, from) else {
            self.not_admitted += 1;
            return;
        };
        if is_new {
            out.push(Datagram {
                to: to.address,
                bytes: self.announce(Some(prefix)),
            });
        }
        self.peers.insert(
            prefix,
            Peer {
                data,
                heard: now,
                from,
            },
        );
        let guid = |entity| Guid::new(prefix, entity);
        self.publications
            .add(guid(PUBLICATIONS_READER), to, true, true, now, out);
        self.subscriptions
            .add(guid(SUBSCRIPTIONS_READER), to, true, true, now, out);
        self.publications_reader
            .add(guid(PUBLICATIONS_WRITER), to.address, now);
        self.subscriptions_reader
            .add(guid(SUBSCRIPTIONS_WRITER), to.address, now);
        self.publications_reader.tick(now, out);
        self.subscriptions_reader.tick(now, out);
        // Its addresses may have changed.
        let of_peer = guid([0; 4])..=guid([0xff; 4]);
        self.match_writers(of_peer.clone(), now, out);
        self.match_readers(of_peer, now);
    }

    fn remove_peer(&mut self, prefix: Prefix) {
        self.peers.remove(&prefix);
        self.remote_writers.retain(|guid, _| guid.prefix != prefix);
        self.remote_readers.retain(|guid, _| guid.prefix != prefix);
        self.forget(|guid| guid.prefix == prefix);
        for writer in [&mut self.publications, &mut self.subscriptions] {
            writer.remove(|guid| guid.prefix == prefix);
        }
        for reader in [
            &mut self.publications_reader,
            &mut self.subscriptions_reader,
        ] {
            reader.remove(|guid| guid.prefix == prefix);
        }
    }

    fn forget(&mut self, is_gone: impl Fn(Guid) -> bool) {
        for (_, writer) in self.writers.values_mut() {
            writer.remove(&is_gone);
        }
        for (_, reader) in self.readers.values_mut() {
            reader.remove(&is_gone);
        }
    }

    /// Handles the announcement of a reader or a writer, or of its removal.
    fn announced(
        &mut self,
        message: &[u8],
        is_writer: bool,
        now: Instant,
        out: &mut Vec<Datagram>,
    ) -> Result<(), Malformed> {
        let data = EndpointData::read(message, is_writer)?;
        let guid = data.guid;
        let known = if is_writer {
            &mut self.remote_writers
        } else {
            &mut self.remote_readers
        };
        if data.topic.is_empty() {
            known.remove(&guid);
            self.forget(|other| other == guid);
            return Ok(());
        }
        if known.len() >= ENDPOINTS && !known.contains_key(&guid) {
            self.not_admitted += 1;
            return Ok(());
        }
        known.insert(guid, data);
        if is_writer {
            self.match_readers(guid..=guid, now);
        } else {
            self.match_writers(guid..=guid, now, out);
        }
        Ok(())
    }

    /// Matches the writers of this participant with readers of others.
    fn match_writers(
        &mut self,
        others: impl RangeBounds<Guid>,
        now: Instant,
        out: &mut Vec<Datagram>,
    ) {
        for (_, reader) in self.remote_readers.range(others) {
            let Some(to) = destination(&self.peers, &self.interfaces, reader) else {
                continue;
            };
            for (data, writer) in self.writers.values_mut() {
                if agree(data, reader) && data.qos.satisfies(reader.qos) {
                    let Qos {
                        reliable,
                        transient_local,
                        ..
                    } = reader.qos;
                    writer.add(reader.guid, to, reliable, transient_local, now, out);
                }
            }
        }
    }

    /// Matches the readers of this participant with writers of others.
    fn match_readers(&mut self, others: impl RangeBounds<Guid>, now: Instant) {
        for (_, writer) in self.remote_writers.range(others) {
            let Some(to) = destination(&self.peers, &self.interfaces, writer) else {
                continue;
            };
            for (data, reader) in self.readers.values_mut() {
                if agree(data, writer) && writer.qos.satisfies(data.qos) {
                    reader.add(writer.guid, to.address, now);
                }
            }
        }
    }

    /// ROS 2 topics that other participants read or write.
    pub(crate) fn topics(&self) -> Vec<TopicInfo> {
        let mut topics: BTreeMap<(&str, String), (usize, usize)> = BTreeMap::new();
        let endpoints = self
            .remote_writers
            .values()
            .map(|writer| (writer, (1, 0)))
            .chain(self.remote_readers.values().map(|reader| (reader, (0, 1))));
        for (endpoint, count) in endpoints {
            if let Some(name) = names::ros_topic(&endpoint.topic)
                && let Some(message_type) = names::ros_type(&endpoint.message_type)
            {
                let topic = topics.entry((name, message_type)).or_default();
                topic.0 += count.0;
                topic.1 += count.1;
            }
        }
        topics
            .into_iter()
            .map(
                |((name, message_type), (publishers, subscribers))| TopicInfo {
                    name: name.into(),
                    message_type,
                    publishers,
                    subscribers,
                },
            )
            .collect()
    }

    /// Names of the known participants.
    pub(crate) fn participants(&self) -> Vec<String> {
        let names = self.peers.values().map(|peer| peer.data.name.clone());
        names.collect()
    }

    pub(crate) fn reader_counts(&self, entity: EntityId) -> (Matches, ReceptionCounts) {
        let Some((data, reader)) = self.readers.get(&entity) else {
            return Default::default();
        };
        let matched = reader.writers();
        (matches(matched, data, &self.remote_writers), reader.counts)
    }

    /// Matches, and the number of messages and fragments that were sent again.
    pub(crate) fn writer_counts(&self, entity: EntityId) -> (Matches, u64) {
        let Some((data, writer)) = self.writers.get(&entity) else {
            return Default::default();
        };
        let matched = writer.readers();
        (
            matches(matched, data, &self.remote_readers),
            writer.repaired,
        )
    }
}

fn is_builtin(reader: EntityId) -> bool {
    matches!(reader, PUBLICATIONS_READER | SUBSCRIPTIONS_READER)
}

fn deliver(reader: EntityId, messages: &mut Vec<Delivery>, take: impl FnOnce(&mut Vec<Vec<u8>>)) {
    let mut ready = Vec::new();
    take(&mut ready);
    messages.extend(ready.into_iter().map(|message| (reader, message)));
}

fn matches(matched: usize, own: &EndpointData, others: &BTreeMap<Guid, EndpointData>) -> Matches {
    let of_topic = others.values().filter(|other| other.topic == own.topic);
    Matches {
        matched,
        incompatible: of_topic.count().saturating_sub(matched),
    }
}

fn agree(a: &EndpointData, b: &EndpointData) -> bool {
    a.topic == b.topic && a.message_type == b.message_type && !a.is_apart && !b.is_apart
}

/// Where a reader or a writer receives: its own addresses if it announced any, else those of its participant.
fn destination(
    peers: &BTreeMap<Prefix, Peer>,
    interfaces: &Interfaces,
    endpoint: &EndpointData,
) -> Option<Destination> {
    let peer = peers.get(&endpoint.guid.prefix)?;
    interfaces
        .destination(&endpoint.addresses, peer.from)
        .or_else(|| interfaces.destination(&peer.data.messages, peer.from))
}
