//! A writer: sends messages to matched readers, keeps the last ones, and sends them again on request (OMG DDSI-RTPS 2.5,
//! chapter 8.4.9).

use std::{
    collections::{BTreeMap, VecDeque},
    net::SocketAddrV4,
    sync::Arc,
    time::{Duration, Instant},
};

use crate::{
    announcement,
    wire::{Guid, Output, Prefix, UNKNOWN},
};

/// Size of a fragment in bytes. With its headers it fits into a packet of Ethernet and of most tunnels.
const FRAGMENT: usize = 1280;

/// Fragments in a datagram to a participant of the same machine: the loopback interface transfers 64 kB at once.
const FRAGMENTS_ON_HOST: usize = 48;

/// Limit of bytes sent again for one request. The reader will request the rest.
const REPAIR: usize = 4 << 20;

/// Address of a participant, and whether it is on this machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Destination {
    pub(crate) address: SocketAddrV4,
    pub(crate) on_host: bool,
}

/// A datagram to send.
#[derive(Debug)]
pub(crate) struct Datagram {
    pub(crate) to: SocketAddrV4,
    pub(crate) bytes: Vec<u8>,
}

/// A kept message.
struct Change {
    number: u64,
    stamp: (u32, u32),
    message: Arc<[u8]>,
    /// The message is a key: the endpoint with this key is gone.
    gone: Option<Guid>,
}

/// A matched reader.
struct Follower {
    to: Destination,
    reliable: bool,
    /// Earlier messages are not sent.
    from: u64,
    /// Everything up to this number is acknowledged or not wanted.
    acknowledged: u64,
    /// Count of the last request.
    count: Option<u32>,
}

pub(crate) struct Writer {
    guid: Guid,
    /// Number of messages to keep; `None`, all, for built-in writers.
    depth: Option<usize>,
    transient_local: bool,
    history: VecDeque<Change>,
    last: u64,
    followers: BTreeMap<Guid, Follower>,
    heartbeats: u32,
    heartbeat_at: Option<Instant>,
    interval: Duration,
    /// Messages or fragments sent again.
    pub(crate) repaired: u64,
}

impl Writer {
    pub(crate) fn new(
        guid: Guid,
        depth: Option<usize>,
        transient_local: bool,
        interval: Duration,
    ) -> Self {
        Self {
            guid,
            depth,
            transient_local,
            history: VecDeque::new(),
            last: 0,
            followers: BTreeMap::new(),
            heartbeats: 0,
            heartbeat_at: None,
            interval,
            repaired: 0,
        }
    }

    /// Number of matched readers.
    pub(crate) fn readers(&self) -> usize {
        self.followers.len()
    }

    /// Adds a reader, and sends it the kept messages if `wants_history`.
    pub(crate) fn add(
        &mut self,
        reader: Guid,
        to: Destination,
        reliable: bool,
        wants_history: bool,
        now: Instant,
        out: &mut Vec<Datagram>,
    ) {
        if let Some(follower) = self.followers.get_mut(&reader) {
            follower.to = to;
            return;
        }
        let from = if wants_history && self.transient_local {
            self.history
                .front()
                .map_or(self.last + 1, |first| first.number)
        } else {
            self.last + 1
        };
        let follower = Follower {
            to,
            reliable,
            from,
            acknowledged: from - 1,
            count: None,
        };
        if from <= self.last && !reliable {
            for change in &self.history {
                self.send(change, to, reader, None, out);
            }
        }
        self.followers.insert(reader, follower);
        if reliable {
            // Sent even when nothing is kept: from then on, the reader requests what is missing.
            self.heartbeat(reader, out);
            self.heartbeat_at.get_or_insert(now + self.interval);
        }
    }

    pub(crate) fn remove(&mut self, is_gone: impl Fn(Guid) -> bool) {
        self.followers.retain(|&reader, _| !is_gone(reader));
    }

    /// Sends a message to all readers, and keeps it. With `gone`, it is the key of an endpoint that is gone.
    pub(crate) fn write(
        &mut self,
        message: Arc<[u8]>,
        stamp: (u32, u32),
        gone: Option<Guid>,
        now: Instant,
        out: &mut Vec<Datagram>,
    ) {
        self.last += 1;
        let change = Change {
            number: self.last,
            stamp,
            message,
            gone,
        };
        // One copy for all readers of a participant.
        let mut participants: BTreeMap<Prefix, (Destination, bool)> = BTreeMap::new();
        for (reader, follower) in &self.followers {
            participants
                .entry(reader.prefix)
                .or_insert((follower.to, false))
                .1 |= follower.reliable;
        }
        let any_reliable = participants.values().any(|(_, reliable)| *reliable);
        let destinations: Vec<_> = participants.into_iter().collect();
        for &(prefix, (to, _)) in &destinations {
            self.send(&change, to, Guid::new(prefix, UNKNOWN), None, out);
        }
        if any_reliable || self.transient_local || self.depth.is_none() {
            self.history.push_back(change);
            while self.depth.is_some_and(|depth| self.history.len() > depth) {
                self.history.pop_front();
            }
        } else {
            self.history.clear();
        }
        for (prefix, (_, reliable)) in destinations {
            if reliable {
                self.heartbeat(Guid::new(prefix, UNKNOWN), out);
            }
        }
        if any_reliable {
            self.heartbeat_at = Some(now + self.interval);
        }
    }

    /// Holds heartbeats back until [`release`](Self::release), while the message is still being sent.
    pub(crate) fn hold(&mut self) {
        self.heartbeat_at = None;
    }

    pub(crate) fn release(&mut self, now: Instant) {
        self.heartbeat_at = Some(now + self.interval);
    }

    /// Sends heartbeats to readers with unacknowledged messages.
    pub(crate) fn tick(&mut self, now: Instant, out: &mut Vec<Datagram>) {
        if self.heartbeat_at.is_none_or(|at| now < at) {
            return;
        }
        let behind: Vec<_> = self
            .followers
            .iter()
            .filter(|(_, follower)| follower.reliable && follower.acknowledged < self.last)
            .map(|(reader, _)| *reader)
            .collect();
        self.heartbeat_at = (!behind.is_empty()).then_some(now + self.interval);
        for reader in behind {
            self.heartbeat(reader, out);
        }
    }

    /// Handles an acknowledgement of everything below `base`, and sends the missing messages again.
    pub(crate) fn acknowledged(
        &mut self,
        reader: Guid,
        base: u64,
        missing: &[u64],
        count: u32,
        out: &mut Vec<Datagram>,
    ) {
        let Some(follower) = self.followers.get_mut(&reader) else {
            return;
        };
        if !follower.reliable || is_repeated(follower.count, count) {
            return;
        }
        let is_first = follower.count.replace(count).is_none();
        let acknowledged = base.saturating_sub(1).min(self.last);
        follower.acknowledged = follower.acknowledged.max(acknowledged);
        let (to, from) = (follower.to, follower.from);
        let kept = self
            .history
            .front()
            .map_or(self.last + 1, |first| first.number)
            .max(from);
        if base < kept && (base > 0 || !missing.is_empty()) {
            let mut output = Output::new(self.guid.prefix, Some(reader.prefix));
            output.gap((reader.entity, self.guid.entity), (base.max(1), kept));
            out.push(Datagram {
                to: to.address,
                bytes: output.finish(),
            });
        }
        let mut bytes = 0;
        for change in &self.history {
            if missing.binary_search(&change.number).is_ok() && change.number >= from {
                if bytes > REPAIR {
                    break;
                }
                bytes += change.message.len();
                self.repaired += 1;
                self.send(change, to, reader, None, out);
            }
        }
        if is_first || bytes > 0 {
            self.heartbeat(reader, out);
        }
    }

    /// Handles a request for fragments of a message.
    pub(crate) fn missing_fragments(
        &mut self,
        reader: Guid,
        number: u64,
        missing: &[u64],
        out: &mut Vec<Datagram>,
    ) {
        let Some(follower) = self.followers.get(&reader) else {
            return;
        };
        let to = follower.to;
        let Some(change) = self.history.iter().find(|change| change.number == number) else {
            let mut output = Output::new(self.guid.prefix, Some(reader.prefix));
            output.gap((reader.entity, self.guid.entity), (number, number + 1));
            out.push(Datagram {
                to: to.address,
                bytes: output.finish(),
            });
            return;
        };
        self.send(change, to, reader, Some(missing), out);
        self.repaired += missing.len() as u64;
        self.heartbeat(reader, out);
    }

    /// Sends a message, or the fragments of it in `only`, counted from 1 and in order.
    fn send(
        &self,
        change: &Change,
        to: Destination,
        reader: Guid,
        only: Option<&[u64]>,
        out: &mut Vec<Datagram>,
    ) {
        let per_datagram = if to.on_host { FRAGMENTS_ON_HOST } else { 1 };
        let ids = (reader.entity, self.guid.entity);
        let mut send = |fill: &mut dyn FnMut(&mut Output)| {
            let mut output = Output::new(self.guid.prefix, Some(reader.prefix));
            output.stamp(change.stamp);
            fill(&mut output);
            out.push(Datagram {
                to: to.address,
                bytes: output.finish(),
            });
        };
        let message = &*change.message;
        if only.is_none() && message.len() <= per_datagram * FRAGMENT {
            let parameters = change.gone.map(announcement::gone).unwrap_or_default();
            send(&mut |output| output.data(ids, change.number, &parameters, message));
            return;
        }
        let fragments = message.len().div_ceil(FRAGMENT);
        let mut at = 1;
        while at <= fragments {
            let count = match only {
                None => per_datagram.min(fragments + 1 - at),
                Some(only) => (at..=fragments)
                    .take(per_datagram)
                    .take_while(|&fragment| only.binary_search(&(fragment as u64)).is_ok())
                    .count(),
            };
            if count == 0 {
                at += 1;
                continue;
            }
            let range = (at as u32, count as u16, FRAGMENT as u16);
            send(&mut |output| output.fragments(ids, change.number, range, message));
            at += count;
        }
    }

    /// Sends a heartbeat about the kept messages to a reader, or to all readers of a participant.
    fn heartbeat(&mut self, reader: Guid, out: &mut Vec<Datagram>) {
        let Some(to) = self
            .followers
            .iter()
            .find(|(guid, _)| guid.prefix == reader.prefix)
            .map(|(_, follower)| follower.to)
        else {
            return;
        };
        self.heartbeats += 1;
        let first = self
            .history
            .front()
            .map_or(self.last + 1, |first| first.number);
        let mut output = Output::new(self.guid.prefix, Some(reader.prefix));
        output.heartbeat(
            (reader.entity, self.guid.entity),
            (first, self.last),
            self.heartbeats,
        );
        out.push(Datagram {
            to: to.address,
            bytes: output.finish(),
        });
    }
}

/// Whether a count, which never decreases, belongs to a submessage received before.
fn is_repeated(last: Option<u32>, count: u32) -> bool {
    last.is_some_and(|last| count.wrapping_sub(last).wrapping_sub(1) >= 1 << 31)
}
