//! A participant with its sockets and threads, its publishers and subscriptions.

use std::{
    collections::{BTreeMap, VecDeque},
    hash::{BuildHasher, Hasher, RandomState},
    io::ErrorKind,
    net::{SocketAddr, UdpSocket},
    process,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant, SystemTime},
};

use crate::{
    Error, Qos, Result, Settings,
    engine::{Engine, Matches, TopicInfo, TopicName},
    graph,
    interfaces::Interfaces,
    names,
    reader::ReceptionCounts,
    sockets::Sockets,
    wire::{EntityId, Guid, PARTICIPANT, Prefix},
    writer::Datagram,
};

/// Interval at which timers are checked.
const TICK: Duration = Duration::from_millis(10);

/// Bytes of a receive buffer that Linux uses for each datagram besides its content, at least.
const OVERHEAD: usize = 1024;

/// Pause after a burst.
const PAUSE: Duration = Duration::from_micros(300);

/// A participant of a domain, which other participants see as one node of ROS 2.
///
/// Dropping it tells the other participants, and disables its publishers and subscriptions.
pub struct Participant {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

/// State shared by a participant, its publishers and its subscriptions.
struct Shared {
    engine: Mutex<Engine>,
    sockets: Sockets,
    settings: Settings,
    queues: Mutex<BTreeMap<EntityId, Arc<Queue>>>,
    graph: EntityId,
    nodes: Mutex<Node>,
    ends: AtomicBool,
    not_sent: AtomicU64,
}

/// Readers and writers of the node.
#[derive(Default)]
struct Node {
    readers: Vec<Guid>,
    writers: Vec<Guid>,
}

/// Messages waiting for a subscriber.
struct Queue {
    depth: usize,
    waiting: Mutex<Waiting>,
    arrived: Condvar,
    dropped: AtomicU64,
}

#[derive(Default)]
struct Waiting {
    messages: VecDeque<Vec<u8>>,
    ends: bool,
}

/// Error counters of a participant. They never decrease.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ParticipantCounts {
    /// Datagrams that were not RTPS, or inconsistent.
    pub malformed: u64,
    /// Datagrams that the system failed to send.
    pub not_sent: u64,
    /// Refused announcements: of participants, readers and writers beyond the limits, and of participants without a
    /// reachable IPv4 address.
    pub not_admitted: u64,
}

/// State of a subscription: matched publishers, and counts of its messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SubscriptionStatus {
    /// Publishers of the topic.
    pub publishers: Matches,
    /// Counts of received and lost messages.
    pub reception: ReceptionCounts,
    /// Received messages that were dropped because the subscriber was too slow.
    pub dropped: u64,
}

/// State of a publisher: matched subscribers, and what was sent again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublisherStatus {
    /// Subscribers of the topic.
    pub subscribers: Matches,
    /// Messages and fragments that were sent again.
    pub repaired: u64,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Participant {
    /// Joins a domain (`ROS_DOMAIN_ID`) and announces a node in it.
    ///
    /// # Errors
    ///
    /// The domain has no ports, all its ports on this machine are taken, or a socket cannot be opened.
    pub fn new(domain: u32, settings: Settings) -> Result<Self> {
        let interfaces = Interfaces::of_machine(settings.localhost_only, settings.interface);
        if let Some(interface) = settings.interface
            && interfaces.all().next().is_none()
        {
            return Err(Error::NoInterface(interface));
        }
        let sockets = Sockets::open(domain, &settings, &interfaces)?;
        let ports = sockets
            .ports()
            .map_err(|source| Error::Socket { domain, source })?;
        let name = format!("{}{}", settings.namespace, settings.node);
        let largest = settings.largest_message;
        let now = Instant::now();
        let mut engine = Engine::new(prefix(), domain, name, interfaces, ports, largest, now);
        let topic = TopicName {
            topic: graph::TOPIC.into(),
            message_type: graph::TYPE.into(),
            user_data: Vec::new(),
        };
        let graph = engine.add_writer(topic, graph::QOS, stamp(), now, &mut Vec::new());
        let shared = Arc::new(Shared {
            engine: Mutex::new(engine),
            sockets,
            settings,
            queues: Mutex::default(),
            graph,
            nodes: Mutex::default(),
            ends: AtomicBool::new(false),
            not_sent: AtomicU64::new(0),
        });
        shared.publish_node();
        let receivers: [fn(&Sockets) -> &UdpSocket; 3] = [
            |sockets| &sockets.multicast,
            |sockets| &sockets.discovery,
            |sockets| &sockets.messages,
        ];
        let mut threads: Vec<_> = receivers
            .into_iter()
            .map(|socket| {
                let shared = Arc::clone(&shared);
                thread::spawn(move || shared.receive(socket))
            })
            .collect();
        let timer = Arc::clone(&shared);
        threads.push(thread::spawn(move || timer.tick()));
        Ok(Self { shared, threads })
    }

    /// Calls `take` with every message of a topic, on a thread of its own: the four bytes of the encapsulation, then CDR.
    ///
    /// `topic` is a name such as `/camera/image_raw`, `message_type` one such as `sensor_msgs/msg/Image`. Messages arrive
    /// until the subscription is dropped, except those of this participant's own publishers. While `take` runs, as many
    /// as `qos.depth` wait; older ones are dropped. Up to three bytes of padding may follow a message of less than 64 kB.
    ///
    /// # Errors
    ///
    /// A name that ROS 2 does not have.
    pub fn subscribe(
        &self,
        topic: &str,
        message_type: &str,
        qos: Qos,
        mut take: Box<dyn FnMut(Vec<u8>) + Send>,
    ) -> Result<Subscription> {
        let topic = topic_name(topic, message_type)?;
        let queue = Arc::new(Queue {
            depth: qos.depth.max(1),
            waiting: Mutex::default(),
            arrived: Condvar::new(),
            dropped: AtomicU64::new(0),
        });
        let mut out = Vec::new();
        let entity = {
            // The queue must exist before the first message arrives.
            let mut queues = lock(&self.shared.queues);
            let mut engine = self.shared.engine();
            let entity = engine.add_reader(topic, qos, stamp(), Instant::now(), &mut out);
            queues.insert(entity, Arc::clone(&queue));
            lock(&self.shared.nodes).readers.push(engine.guid(entity));
            entity
        };
        self.shared.send(&out, false);
        self.shared.publish_node();
        let messages = Arc::clone(&queue);
        let thread = thread::spawn(move || {
            while let Some(message) = messages.next() {
                take(message);
            }
        });
        Ok(Subscription {
            shared: Arc::clone(&self.shared),
            entity,
            queue,
            thread: Some(thread),
        })
    }

    /// Returns a publisher of a topic. Names are as in [`subscribe`](Self::subscribe).
    ///
    /// # Errors
    ///
    /// A name that ROS 2 does not have.
    pub fn advertise(&self, topic: &str, message_type: &str, qos: Qos) -> Result<Publisher> {
        let topic = topic_name(topic, message_type)?;
        let mut out = Vec::new();
        let entity = {
            let mut engine = self.shared.engine();
            let entity = engine.add_writer(topic, qos, stamp(), Instant::now(), &mut out);
            lock(&self.shared.nodes).writers.push(engine.guid(entity));
            entity
        };
        self.shared.send(&out, false);
        self.shared.publish_node();
        Ok(Publisher {
            shared: Arc::clone(&self.shared),
            entity,
        })
    }

    /// Returns the topics of other participants, in the order of their names.
    pub fn topics(&self) -> Vec<TopicInfo> {
        self.shared.engine().topics()
    }

    /// Returns the names of the other participants of the domain; those of ROS 2 are named after their context, `/`.
    pub fn participants(&self) -> Vec<String> {
        self.shared.engine().participants()
    }

    /// Returns what went wrong since the participant joined.
    pub fn counts(&self) -> ParticipantCounts {
        let engine = self.shared.engine();
        ParticipantCounts {
            malformed: engine.malformed,
            not_sent: self.shared.not_sent.load(Ordering::Relaxed),
            not_admitted: engine.not_admitted,
        }
    }
}

impl Drop for Participant {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A panic of a thread has been reported by its hook.
            let _ = thread.join();
        }
        let farewell = self.shared.engine().farewell();
        self.shared.sockets.announce(&farewell);
        for queue in lock(&self.shared.queues).values() {
            queue.end();
        }
    }
}

impl Shared {
    fn engine(&self) -> MutexGuard<'_, Engine> {
        lock(&self.engine)
    }

    /// Sends datagrams; those of a message in bursts, with pauses between.
    fn send(&self, datagrams: &[Datagram], in_bursts: bool) {
        let burst = self.settings.burst;
        let mut sent = 0;
        for Datagram { to, bytes } in datagrams {
            let charged = bytes.len() + OVERHEAD;
            if in_bursts && burst > 0 && sent > 0 && sent + charged > burst {
                thread::sleep(PAUSE);
                sent = 0;
            }
            sent += charged;
            if self.sockets.messages.send_to(bytes, to).is_err() {
                self.not_sent.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    fn receive(&self, socket: impl Fn(&Sockets) -> &UdpSocket) {
        let socket = socket(&self.sockets);
        let mut datagram = vec![0; 1 << 16];
        let (mut out, mut ready) = (Vec::new(), Vec::new());
        while !self.ends.load(Ordering::Relaxed) {
            let (length, from) = match socket.recv_from(&mut datagram) {
                Ok((length, SocketAddr::V4(from))) => (length, *from.ip()),
                Ok((_, SocketAddr::V6(_))) => continue,
                Err(error)
                    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) =>
                {
                    continue;
                }
                Err(_) => {
                    // The interface is down, or Windows reports the failure of an earlier datagram.
                    thread::sleep(TICK);
                    continue;
                }
            };
            self.engine().receive(
                &datagram[..length],
                from,
                Instant::now(),
                &mut out,
                &mut ready,
            );
            self.send(&out, true);
            out.clear();
            if !ready.is_empty() {
                let queues = lock(&self.queues);
                for (entity, message) in ready.drain(..) {
                    if let Some(queue) = queues.get(&entity) {
                        queue.add(message);
                    }
                }
            }
        }
    }

    fn tick(&self) {
        let mut out = Vec::new();
        while !self.ends.load(Ordering::Relaxed) {
            let now = Instant::now();
            let announcement = {
                let mut engine = self.engine();
                engine.tick(now, &mut out);
                engine.announcement(now)
            };
            self.send(&out, true);
            out.clear();
            if let Some(announcement) = announcement {
                let failed = self.sockets.announce(&announcement);
                self.not_sent.fetch_add(failed, Ordering::Relaxed);
            }
            thread::sleep(TICK);
        }
    }

    /// Publishes the topics of the node in the graph of ROS 2.
    fn publish_node(&self) {
        let Settings {
            generation,
            namespace,
            node,
            ..
        } = &self.settings;
        let mut out = Vec::new();
        {
            // Same order of locks as when a topic is added.
            let mut engine = self.engine();
            let nodes = lock(&self.nodes);
            let participant = engine.guid(PARTICIPANT);
            let message = graph::message(
                *generation,
                participant,
                (namespace, node),
                &nodes.readers,
                &nodes.writers,
            );
            engine.write(
                self.graph,
                message.into(),
                stamp(),
                Instant::now(),
                &mut out,
            );
        }
        self.send(&out, false);
        self.engine().sent(self.graph, Instant::now());
    }

    fn remove(&self, entity: EntityId) {
        let mut out = Vec::new();
        {
            let mut engine = self.engine();
            engine.remove(entity, stamp(), Instant::now(), &mut out);
            let mut nodes = lock(&self.nodes);
            let guid = engine.guid(entity);
            nodes.readers.retain(|reader| *reader != guid);
            nodes.writers.retain(|writer| *writer != guid);
        }
        self.send(&out, false);
        self.publish_node();
    }
}

impl Queue {
    fn add(&self, message: Vec<u8>) {
        let mut waiting = lock(&self.waiting);
        if waiting.messages.len() >= self.depth {
            waiting.messages.pop_front();
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        waiting.messages.push_back(message);
        self.arrived.notify_one();
    }

    /// Waits for a message; `None` once the subscription has ended.
    fn next(&self) -> Option<Vec<u8>> {
        let mut waiting = lock(&self.waiting);
        loop {
            if waiting.ends {
                return None;
            }
            if let Some(message) = waiting.messages.pop_front() {
                return Some(message);
            }
            waiting = self
                .arrived
                .wait(waiting)
                .unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn end(&self) {
        lock(&self.waiting).ends = true;
        self.arrived.notify_one();
    }
}

/// A subscription, which ends when dropped.
pub struct Subscription {
    shared: Arc<Shared>,
    entity: EntityId,
    queue: Arc<Queue>,
    thread: Option<JoinHandle<()>>,
}

impl Subscription {
    /// Returns the matched publishers, and the counts of messages.
    pub fn status(&self) -> SubscriptionStatus {
        let (publishers, reception) = self.shared.engine().reader_counts(self.entity);
        SubscriptionStatus {
            publishers,
            reception,
            dropped: self.queue.dropped.load(Ordering::Relaxed),
        }
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        lock(&self.shared.queues).remove(&self.entity);
        self.shared.remove(self.entity);
        self.queue.end();
        if let Some(thread) = self.thread.take()
            && thread.thread().id() != thread::current().id()
        {
            let _ = thread.join();
        }
    }
}

/// A publisher of a topic, which is withdrawn when dropped.
pub struct Publisher {
    shared: Arc<Shared>,
    entity: EntityId,
}

impl Publisher {
    /// Sends a message: the four bytes of the encapsulation, then CDR. Returns when it is handed to the system; what
    /// reliable subscribers have not received is sent again later.
    ///
    /// # Errors
    ///
    /// A message shorter than the encapsulation, or larger than [`Settings::largest_message`].
    pub fn publish(&self, message: &[u8]) -> Result<()> {
        let largest = self.shared.settings.largest_message;
        if !(4..=largest).contains(&message.len()) {
            return Err(Error::MessageSize {
                bytes: message.len(),
                largest,
            });
        }
        let mut out = Vec::new();
        self.shared.engine().write(
            self.entity,
            message.into(),
            stamp(),
            Instant::now(),
            &mut out,
        );
        self.shared.send(&out, true);
        self.shared.engine().sent(self.entity, Instant::now());
        Ok(())
    }

    /// Returns the matched subscribers, and what was sent again.
    pub fn status(&self) -> PublisherStatus {
        let (subscribers, repaired) = self.shared.engine().writer_counts(self.entity);
        PublisherStatus {
            subscribers,
            repaired,
        }
    }
}

impl Drop for Publisher {
    fn drop(&mut self) {
        self.shared.remove(self.entity);
    }
}

fn topic_name(topic: &str, message_type: &str) -> Result<TopicName> {
    Ok(TopicName {
        topic: names::topic(topic)?,
        message_type: names::message_type(message_type)?,
        user_data: names::type_hash(message_type)
            .map(|hash| format!("typehash={hash};").into_bytes())
            .unwrap_or_default(),
    })
}

/// A unique identifier: an unassigned vendor, the process identifier, and random bytes.
fn prefix() -> Prefix {
    let mut prefix = [0; 12];
    let chance = RandomState::new().build_hasher().finish();
    prefix[2..4].copy_from_slice(&(process::id() as u16).to_be_bytes());
    prefix[4..].copy_from_slice(&chance.to_be_bytes());
    prefix
}

/// Current time: seconds since 1970, and units of 2^-32 s.
fn stamp() -> (u32, u32) {
    let time = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .unwrap_or_default();
    let fraction = (u64::from(time.subsec_nanos()) << 32) / 1_000_000_000;
    (time.as_secs() as u32, fraction as u32)
}
