//! The queue of received messages.

use lsdc_recordings::Receipt;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Limit of all queued messages, in bytes.
const MOST_BYTES: usize = 1 << 30;

/// Messages in order of arrival: a limited number of each topic, and at most [`MOST_BYTES`]. The oldest are dropped.
#[derive(Default)]
pub(crate) struct Inbox {
    contents: Mutex<Contents>,
    arrived: Condvar,
}

#[derive(Default)]
struct Contents {
    messages: VecDeque<Received>,
    bytes: usize,
    topics: Vec<Topic>,
    is_closed: bool,
    /// Wake the waiting thread although no message has come.
    is_woken: bool,
}

struct Topic {
    name: String,
    limit: usize,
    waiting: usize,
    lost: u64,
}

/// A message of a topic.
pub(crate) struct Received {
    /// Index of the topic.
    pub(crate) topic: usize,
    pub(crate) message: Vec<u8>,
    pub(crate) receipt: Receipt,
}

impl Contents {
    /// Drops the oldest of these messages.
    fn lose(&mut self, of: impl Fn(&Received) -> bool) {
        let oldest = self.messages.iter().position(of);
        let Some(lost) = oldest.and_then(|oldest| self.messages.remove(oldest)) else {
            return;
        };
        self.bytes -= lost.message.len();
        if let Some(topic) = self.topics.get_mut(lost.topic) {
            topic.waiting -= 1;
            topic.lost += 1;
        }
    }
}

impl Inbox {
    fn lock(&self) -> MutexGuard<'_, Contents> {
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a topic with a limit of queued messages, and returns its index.
    pub(crate) fn add_topic(&self, name: &str, limit: usize) -> usize {
        let mut contents = self.lock();
        contents.topics.push(Topic {
            name: name.to_owned(),
            limit,
            waiting: 0,
            lost: 0,
        });
        contents.topics.len() - 1
    }

    /// Adds a message of a registered topic.
    pub(crate) fn put(&self, received: Received) {
        let mut contents = self.lock();
        let number = received.topic;
        let Some(topic) = contents.topics.get_mut(number) else {
            return;
        };
        topic.waiting += 1;
        let is_full = topic.waiting > topic.limit;
        contents.bytes += received.message.len();
        contents.messages.push_back(received);
        if is_full {
            contents.lose(|message| message.topic == number);
        }
        while contents.bytes > MOST_BYTES && contents.messages.len() > 1 {
            contents.lose(|_| true);
        }
        drop(contents);
        self.arrived.notify_one();
    }

    /// Removes the oldest message, and returns it with the name of its topic.
    pub(crate) fn take(&self) -> Option<(String, Received)> {
        let mut contents = self.lock();
        let received = contents.messages.pop_front()?;
        contents.bytes -= received.message.len();
        let topic = contents.topics.get_mut(received.topic)?;
        topic.waiting -= 1;
        Some((topic.name.clone(), received))
    }

    /// Number of dropped messages of a topic.
    pub(crate) fn lost(&self, topic: usize) -> u64 {
        self.lock().topics.get(topic).map_or(0, |topic| topic.lost)
    }

    /// Blocks until there is a message, the inbox is closed, or the time has passed. Returns whether it is still open.
    pub(crate) fn wait(&self, most: Duration) -> bool {
        let contents = self.lock();
        let is_idle = |contents: &mut Contents| {
            contents.messages.is_empty() && !contents.is_closed && !contents.is_woken
        };
        let waited = self.arrived.wait_timeout_while(contents, most, is_idle);
        let (mut contents, _) = waited.unwrap_or_else(PoisonError::into_inner);
        contents.is_woken = false;
        !contents.is_closed
    }

    /// Ends the current or the next wait.
    pub(crate) fn wake(&self) {
        self.lock().is_woken = true;
        self.arrived.notify_all();
    }

    /// Closes the inbox: every wait ends.
    pub(crate) fn close(&self) {
        self.lock().is_closed = true;
        self.arrived.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_of_a_topic_makes_room() {
        let inbox = Inbox::default();
        let (image, tf) = (inbox.add_topic("image", 2), inbox.add_topic("tf", 10));
        let receipt = Receipt {
            at: Duration::ZERO,
            stamp: 0,
        };
        for number in 0..5 {
            for topic in [image, tf] {
                let message = vec![number];
                inbox.put(Received {
                    topic,
                    message,
                    receipt,
                });
            }
        }
        assert_eq!((inbox.lost(image), inbox.lost(tf)), (3, 0));
        let taken = std::iter::from_fn(|| inbox.take());
        let taken: Vec<_> = taken.map(|(name, m)| (name, m.message[0])).collect();
        let of = |wanted: &str| {
            let numbers = taken.iter().filter(|(name, _)| name == wanted);
            numbers.map(|(_, number)| *number).collect::<Vec<_>>()
        };
        assert_eq!((of("image"), of("tf")), (vec![3, 4], vec![0, 1, 2, 3, 4]));
        assert!(inbox.wait(Duration::ZERO));
        inbox.close();
        assert!(!inbox.wait(Duration::MAX));
    }
}
