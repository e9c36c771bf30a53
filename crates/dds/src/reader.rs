//! A reader: assembles the messages of each matched writer from fragments, orders them, and requests missing ones again
//! (OMG DDSI-RTPS 2.5, chapter 8.4.12).

use std::{
    collections::BTreeMap,
    mem,
    net::SocketAddrV4,
    time::{Duration, Instant},
};

use crate::{
    wire::{Fragments, Guid, Output},
    writer::Datagram,
};

/// Missing fragments are requested when none has arrived for this long.
const ASK: Duration = Duration::from_millis(20);

/// Interval between requests for the same data.
const ASK_AGAIN: Duration = Duration::from_millis(4);

/// Data requested at once, in bytes. The rest is requested later.
const REQUEST: usize = 16 << 10;

/// Interval between requests to a writer that has announced nothing yet.
const GREET: Duration = Duration::from_millis(200);

/// Limit of complete messages of a writer that wait for an earlier one. Beyond it, the earlier one counts as lost.
const AHEAD: usize = 64;

/// Largest span of a set of missing messages.
const REACH: u64 = 256;

/// Limit of incomplete messages of a writer. Beyond it, one is dropped.
const INCOMPLETE: usize = 8;

/// Counts of messages. They never decrease.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReceptionCounts {
    /// Complete messages.
    pub received: u64,
    /// Messages that a writer sent and that never arrived complete, or that it no longer keeps.
    pub lost: u64,
    /// Inconsistent submessages, and messages larger than
    /// [`Settings::largest_message`](crate::Settings::largest_message).
    pub refused: u64,
}

/// A message with missing fragments.
struct Incomplete {
    message: Vec<u8>,
    size: u16,
    has: Vec<bool>,
    missing: usize,
}

/// A matched writer.
struct Source {
    to: SocketAddrV4,
    reliable: bool,
    /// Number of the first missing message, once known.
    next: Option<u64>,
    /// Later messages; `None` for those not meant for this reader.
    ahead: BTreeMap<u64, Option<Vec<u8>>>,
    incomplete: BTreeMap<u64, Incomplete>,
    /// Last number that the writer has announced.
    announced: u64,
    heartbeat: Option<u32>,
    requests: u32,
    /// Earliest time of the next request, unless something is announced.
    ask_at: Instant,
    asked: Option<Instant>,
    /// Something has arrived: what is missing from then on counts as lost.
    has_begun: bool,
}

pub(crate) struct Reader {
    guid: Guid,
    reliable: bool,
    wants_history: bool,
    largest: usize,
    sources: BTreeMap<Guid, Source>,
    pub(crate) counts: ReceptionCounts,
}

impl Reader {
    pub(crate) fn new(guid: Guid, reliable: bool, wants_history: bool, largest: usize) -> Self {
        Self {
            guid,
            reliable,
            wants_history,
            largest,
            sources: BTreeMap::new(),
            counts: ReceptionCounts::default(),
        }
    }

    /// Number of matched writers.
    pub(crate) fn writers(&self) -> usize {
        self.sources.len()
    }

    pub(crate) fn has_writer(&self, writer: Guid) -> bool {
        self.sources.contains_key(&writer)
    }

    pub(crate) fn add(&mut self, writer: Guid, to: SocketAddrV4, now: Instant) {
        self.sources
            .entry(writer)
            .and_modify(|source| source.to = to)
            .or_insert(Source {
                to,
                reliable: self.reliable,
                next: None,
                ahead: BTreeMap::new(),
                incomplete: BTreeMap::new(),
                announced: 0,
                heartbeat: None,
                requests: 0,
                ask_at: now,
                asked: None,
                has_begun: false,
            });
    }

    pub(crate) fn remove(&mut self, is_gone: impl Fn(Guid) -> bool) {
        self.sources.retain(|&writer, _| !is_gone(writer));
    }

    /// Handles a complete message; those that can be delivered are added to `ready`. A message without bytes only takes
    /// its place in the order.
    pub(crate) fn data(
        &mut self,
        writer: Guid,
        number: u64,
        message: Vec<u8>,
        ready: &mut Vec<Vec<u8>>,
    ) {
        let Some(source) = self.sources.get_mut(&writer) else {
            return;
        };
        if number == 0 || source.has(number) {
            return;
        }
        source.incomplete.remove(&number);
        if !source.reliable {
            let next = source.next.unwrap_or(number);
            self.counts.lost += number - next;
            source.next = Some(number + 1);
            source.incomplete.retain(|&other, _| other > number);
            deliver(message, &mut self.counts, ready);
            return;
        }
        if !self.wants_history {
            source.next.get_or_insert(number);
        }
        source.ahead.insert(number, Some(message));
        if source.ahead.len() > AHEAD
            && let Some((&first, _)) = source.ahead.first_key_value()
        {
            source.next.get_or_insert(first);
            source.skip_to(first, &mut self.counts, ready);
        }
        source.deliver(&mut self.counts, ready);
    }

    /// Handles fragments of a message.
    pub(crate) fn fragments(
        &mut self,
        writer: Guid,
        fragments: &Fragments<'_>,
        now: Instant,
        ready: &mut Vec<Vec<u8>>,
    ) {
        let Some(source) = self.sources.get_mut(&writer) else {
            return;
        };
        let number = fragments.number;
        if number == 0 || source.has(number) {
            return;
        }
        let (size, total) = (usize::from(fragments.size), fragments.total as usize);
        let (first, count) = (fragments.start as usize, usize::from(fragments.count));
        if size == 0 || total == 0 || total > self.largest || first == 0 || count == 0 {
            self.counts.refused += 1;
            return;
        }
        let first = first - 1;
        let of_message = total.div_ceil(size);
        // Checked in this order, so that no sum or product exceeds the size of the message.
        if first >= of_message
            || count > of_message - first
            || fragments.payload.len() < ((first + count) * size).min(total) - first * size
        {
            self.counts.refused += 1;
            return;
        }
        let bytes = first * size..((first + count) * size).min(total);
        if source.reliable && !self.wants_history {
            source.next.get_or_insert(number);
        }
        source.ask_at = now + ASK;
        let incomplete = source
            .incomplete
            .entry(number)
            .or_insert_with(|| Incomplete {
                message: vec![0; total],
                size: fragments.size,
                has: vec![false; of_message],
                missing: of_message,
            });
        if incomplete.message.len() != total || incomplete.size != fragments.size {
            self.counts.refused += 1;
            return;
        }
        let length = bytes.len();
        incomplete.message[bytes].copy_from_slice(&fragments.payload[..length]);
        for has in &mut incomplete.has[first..first + count] {
            incomplete.missing -= usize::from(!mem::replace(has, true));
        }
        if incomplete.missing == 0 {
            if let Some(complete) = source.incomplete.remove(&number) {
                self.data(writer, number, complete.message, ready);
            }
        } else if source.incomplete.len() > INCOMPLETE {
            // Best effort cannot complete the oldest; a reliable reader can request the newest again.
            if source.reliable {
                source.incomplete.pop_last();
            } else {
                source.incomplete.pop_first();
            }
        }
    }

    /// Handles a heartbeat: the writer keeps the messages from `first` to `last`.
    pub(crate) fn heartbeat(
        &mut self,
        writer: Guid,
        (first, last): (u64, u64),
        count: u32,
        is_final: bool,
        now: Instant,
        ready: &mut Vec<Vec<u8>>,
        out: &mut Vec<Datagram>,
    ) {
        let Some(source) = self.sources.get_mut(&writer) else {
            return;
        };
        if !source.reliable || first == 0 || last < first - 1 {
            return;
        }
        if source
            .heartbeat
            .is_some_and(|seen| count.wrapping_sub(seen).wrapping_sub(1) >= 1 << 31)
        {
            return;
        }
        source.heartbeat = Some(count);
        source.announced = source.announced.max(last);
        let start = if self.wants_history { first } else { last + 1 };
        source.next.get_or_insert(start);
        source.skip_to(first, &mut self.counts, ready);
        source.deliver(&mut self.counts, ready);
        let complete = source.is_complete();
        if source.may_ask(now) && (!complete || !is_final) {
            source.ask(self.guid, writer, now, out);
        }
    }

    /// Requests missing fragments of a message that the writer has sent completely.
    pub(crate) fn fragment_heartbeat(
        &mut self,
        writer: Guid,
        number: u64,
        now: Instant,
        out: &mut Vec<Datagram>,
    ) {
        if let Some(source) = self.sources.get_mut(&writer)
            && source.reliable
            && source.incomplete.contains_key(&number)
            && source.may_ask(now)
        {
            source.ask(self.guid, writer, now, out);
        }
    }

    /// Handles a gap: messages not meant for this reader.
    pub(crate) fn gap(
        &mut self,
        writer: Guid,
        (first, after): (u64, u64),
        listed: &[u64],
        ready: &mut Vec<Vec<u8>>,
    ) {
        let Some(source) = self.sources.get_mut(&writer) else {
            return;
        };
        let Some(next) = source.next.filter(|_| source.reliable) else {
            return;
        };
        if first <= next {
            source.skip_to(after, &mut self.counts, ready);
        } else {
            for number in first..after.min(next + REACH) {
                source.ahead.entry(number).or_insert(None);
                source.incomplete.remove(&number);
            }
        }
        let ahead = next..next + REACH;
        for &number in listed.iter().filter(|&number| ahead.contains(number)) {
            source.ahead.entry(number).or_insert(None);
            source.incomplete.remove(&number);
        }
        source.deliver(&mut self.counts, ready);
    }

    /// Requests missing messages or, before any heartbeat, a first one.
    pub(crate) fn tick(&mut self, now: Instant, out: &mut Vec<Datagram>) {
        for (&writer, source) in &mut self.sources {
            if source.reliable
                && now >= source.ask_at
                && (source.heartbeat.is_none() || !source.is_complete())
            {
                source.ask(self.guid, writer, now, out);
            }
        }
    }
}

impl Source {
    fn has(&self, number: u64) -> bool {
        self.next.is_some_and(|next| number < next) || self.ahead.contains_key(&number)
    }

    fn may_ask(&self, now: Instant) -> bool {
        self.asked.is_none_or(|asked| now >= asked + ASK_AGAIN)
    }

    fn is_complete(&self) -> bool {
        self.incomplete.is_empty() && self.next.is_some_and(|next| next > self.announced)
    }

    /// Counts missing messages before `number` as lost, and delivers the others.
    fn skip_to(&mut self, number: u64, counts: &mut ReceptionCounts, ready: &mut Vec<Vec<u8>>) {
        let Some(next) = self.next.filter(|&next| next < number) else {
            return;
        };
        let later = self.ahead.split_off(&number);
        let before = mem::replace(&mut self.ahead, later);
        if self.has_begun {
            counts.lost += number - next - before.values().flatten().count() as u64;
        }
        for message in before.into_values().flatten() {
            self.has_begun = true;
            deliver(message, counts, ready);
        }
        self.incomplete.retain(|&other, _| other >= number);
        self.next = Some(number);
    }

    /// Delivers complete messages up to the first missing one.
    fn deliver(&mut self, counts: &mut ReceptionCounts, ready: &mut Vec<Vec<u8>>) {
        while let Some(next) = self.next
            && let Some(message) = self.ahead.remove(&next)
        {
            self.next = Some(next + 1);
            match message {
                Some(message) => {
                    self.has_begun = true;
                    deliver(message, counts, ready);
                }
                None => counts.lost += u64::from(self.has_begun),
            }
        }
    }

    fn ask(&mut self, reader: Guid, writer: Guid, now: Instant, out: &mut Vec<Datagram>) {
        let next = self.next.unwrap_or(1);
        let missing: Vec<u64> = (next..=self.announced.min(next + REACH - 1))
            .filter(|number| {
                !self.ahead.contains_key(number) && !self.incomplete.contains_key(number)
            })
            .collect();
        let greets = self.heartbeat.is_none();
        let ids = (reader.entity, writer.entity);
        let mut output = Output::new(reader.prefix, Some(writer.prefix));
        self.requests += 1;
        let is_final = missing.is_empty() && !greets;
        output.acknowledge(ids, next, &missing, self.requests, is_final);
        for (&number, incomplete) in &self.incomplete {
            let mut missing: Vec<u64> = (1..)
                .zip(&incomplete.has)
                .filter(|(_, has)| !**has)
                .map(|(fragment, _)| fragment)
                .collect();
            while let Some(&base) = missing.first()
                && output.len() < REQUEST
            {
                let further = missing.partition_point(|fragment| fragment - base < 256);
                let later = missing.split_off(further);
                self.requests += 1;
                output.missing_fragments(ids, number, &missing, self.requests);
                missing = later;
            }
        }
        out.push(Datagram {
            to: self.to,
            bytes: output.finish(),
        });
        self.asked = Some(now);
        self.ask_at = now + if greets { GREET } else { ASK };
    }
}

fn deliver(message: Vec<u8>, counts: &mut ReceptionCounts, ready: &mut Vec<Vec<u8>>) {
    if !message.is_empty() {
        counts.received += 1;
        ready.push(message);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::EntityId;

    const READER: EntityId = [0, 0, 1, 4];
    const WRITER: EntityId = [0, 0, 2, 3];

    fn matched(reliable: bool) -> (Reader, Guid, Instant) {
        let now = Instant::now();
        let writer = Guid::new([2; 12], WRITER);
        let mut reader = Reader::new(Guid::new([1; 12], READER), reliable, false, 1 << 20);
        reader.add(writer, SocketAddrV4::new([10, 0, 0, 2].into(), 7411), now);
        (reader, writer, now)
    }

    #[test]
    fn fragments_that_contradict_themselves_are_refused() {
        let (mut reader, writer, now) = matched(false);
        let mut ready = Vec::new();
        let mut refused = 0;
        for (start, count, size, total) in [
            (u32::MAX, u16::MAX, u16::MAX, 100),
            (0, 1, 10, 100),
            (1, 0, 10, 100),
            (1, 1, 0, 100),
            (1, 1, 10, 0),
            (11, 1, 10, 100),
            (10, 2, 10, 100),
            (1, 2, 10, 100),
            (1, 1, 10, u32::MAX),
        ] {
            let fragments = Fragments {
                writer: WRITER,
                reader: READER,
                number: 1,
                start,
                count,
                size,
                total,
                payload: &[7; 19],
            };
            reader.fragments(writer, &fragments, now, &mut ready);
            refused += 1;
            assert_eq!(reader.counts.refused, refused, "{fragments:?}");
        }
        assert!(ready.is_empty());
    }

    /// A writer that announces much and sends little.
    #[test]
    fn what_is_kept_for_a_writer_is_bounded() {
        let (mut reader, writer, now) = matched(true);
        let (mut ready, mut out) = (Vec::new(), Vec::new());
        reader.heartbeat(writer, (1, 0), 1, false, now, &mut ready, &mut out);
        for number in 1..1000u64 {
            let listed: Vec<u64> = (0..256).map(|at| number << 20 | at).collect();
            reader.gap(writer, (number << 20, u64::MAX >> 1), &listed, &mut ready);
            reader.data(writer, 2 * number, vec![0; 8], &mut ready);
        }
        let source = &reader.sources[&writer];
        assert!(source.ahead.len() <= AHEAD, "{}", source.ahead.len());
        // Every second message; those that still wait are the last ones.
        assert_eq!(ready.len() + source.ahead.len(), 999);
        assert_eq!(reader.counts.received as usize, ready.len());
        // A request lists no more than a set can hold, whatever is announced.
        reader.heartbeat(
            writer,
            (1, 1 << 40),
            2,
            false,
            now + ASK,
            &mut ready,
            &mut out,
        );
        assert!(out.iter().all(|datagram| datagram.bytes.len() < 256));
    }
}
