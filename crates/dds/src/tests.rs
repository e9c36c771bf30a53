//! Participants without sockets, on a network and a clock that the test has in hand.

use std::{
    net::{Ipv4Addr, SocketAddrV4},
    sync::Arc,
    time::{Duration, Instant},
};

use lsdc_rng::Rng;

use crate::{
    Qos,
    engine::{Delivery, Engine, TopicName},
    interfaces::Interfaces,
    wire::EntityId,
    writer::Datagram,
};

/// The port of a participant that no longer runs.
const DEAD: u16 = 0;
const STEP: Duration = Duration::from_millis(10);
const LARGEST: usize = 4 << 20;
/// A depth image of 640 x 480 pixels, 32 bits each, and what is beside it.
const IMAGE: usize = 640 * 480 * 4 + 56;

struct Network {
    now: Instant,
    rng: Rng,
    /// Of each datagram.
    loss: f32,
    engines: Vec<(Ipv4Addr, u16, Engine)>,
    received: Vec<Vec<Delivery>>,
    on_the_way: Vec<Datagram>,
}

impl Network {
    /// Participants at addresses; those with the same address are on one machine.
    fn new(addresses: &[[u8; 4]]) -> Self {
        let mut network = Self {
            now: Instant::now(),
            rng: Rng::stream(7, &["network"]),
            loss: 0.0,
            engines: Vec::new(),
            received: Vec::new(),
            on_the_way: Vec::new(),
        };
        for &address in addresses {
            network.join(address);
        }
        network
    }

    fn join(&mut self, address: [u8; 4]) -> usize {
        let index = self.engines.len();
        let ip = Ipv4Addr::from(address);
        let port = 7410 + 2 * index as u16;
        let mask = Ipv4Addr::new(255, 255, 255, 0);
        let interfaces = Interfaces::new(vec![(ip, mask), (Ipv4Addr::LOCALHOST, mask)]);
        let name = format!("/{index}");
        let prefix = [index as u8 + 1; 12];
        let ports = (port, port + 1);
        let engine = Engine::new(prefix, 0, name, interfaces, ports, LARGEST, self.now);
        self.engines.push((ip, port, engine));
        self.received.push(Vec::new());
        index
    }

    fn writer(&mut self, index: usize, topic: &str, qos: Qos) -> EntityId {
        let Self {
            engines,
            now,
            on_the_way,
            ..
        } = self;
        engines[index]
            .2
            .add_writer(name(topic), qos, (0, 0), *now, on_the_way)
    }

    fn reader(&mut self, index: usize, topic: &str, qos: Qos) -> EntityId {
        let Self {
            engines,
            now,
            on_the_way,
            ..
        } = self;
        engines[index]
            .2
            .add_reader(name(topic), qos, (0, 0), *now, on_the_way)
    }

    fn write(&mut self, index: usize, writer: EntityId, message: &[u8]) {
        let engine = &mut self.engines[index].2;
        let message = Arc::from(message);
        engine.write(writer, message, (0, 0), self.now, &mut self.on_the_way);
        engine.sent(writer, self.now);
        self.arrive();
    }

    /// Lets time pass.
    fn run(&mut self, time: Duration) {
        for _ in 0..time.as_millis() / STEP.as_millis() {
            self.now += STEP;
            for index in 0..self.engines.len() {
                if self.engines[index].1 == DEAD {
                    continue;
                }
                let engine = &mut self.engines[index].2;
                engine.tick(self.now, &mut self.on_the_way);
                if let Some(announcement) = engine.announcement(self.now) {
                    self.multicast(index, &announcement);
                }
            }
            self.arrive();
        }
    }

    fn multicast(&mut self, from: usize, bytes: &[u8]) {
        for (index, (ip, port, _)) in self.engines.iter().enumerate() {
            if index != from {
                self.on_the_way.push(Datagram {
                    to: SocketAddrV4::new(*ip, *port),
                    bytes: bytes.into(),
                });
            }
        }
    }

    fn arrive(&mut self) {
        while !self.on_the_way.is_empty() {
            for datagram in std::mem::take(&mut self.on_the_way) {
                if self.rng.chance(self.loss) {
                    continue;
                }
                let to = self.engines.iter().position(|(ip, port, _)| {
                    *ip == *datagram.to.ip() && (*port == datagram.to.port() & !1)
                });
                if let Some(index) = to {
                    self.engines[index].2.receive(
                        &datagram.bytes,
                        // One that says nothing of the sender.
                        *datagram.to.ip(),
                        self.now,
                        &mut self.on_the_way,
                        &mut self.received[index],
                    );
                }
            }
        }
    }

    /// Takes what a reader has received.
    fn taken(&mut self, index: usize) -> Vec<Vec<u8>> {
        let received = std::mem::take(&mut self.received[index]);
        received.into_iter().map(|(_, message)| message).collect()
    }
}

fn name(topic: &str) -> TopicName {
    TopicName {
        topic: format!("rt/{topic}"),
        message_type: "sensor_msgs::msg::dds_::Image_".into(),
        user_data: Vec::new(),
    }
}

/// A message that differs from those of other seeds everywhere.
fn message(length: usize, seed: usize) -> Vec<u8> {
    let mut message = vec![0, 1, 0, 0];
    message.extend((0..length - 4).map(|at| (at.wrapping_mul(31) >> 3) as u8 ^ seed as u8));
    message
}

const DISCOVERY: Duration = Duration::from_secs(2);

#[test]
fn messages_of_any_size_arrive_unchanged_in_both_directions() {
    for addresses in [
        [[10, 0, 0, 1], [10, 0, 0, 1]],
        [[10, 0, 0, 1], [10, 0, 0, 2]],
    ] {
        let mut network = Network::new(&addresses);
        let there = network.writer(0, "there", Qos::SENSOR_DATA);
        let back = network.writer(1, "back", Qos::DEFAULT);
        network.reader(1, "there", Qos::SENSOR_DATA);
        network.reader(0, "back", Qos::DEFAULT);
        network.run(DISCOVERY);
        for length in [
            4, 5, 6, 7, 8, 1279, 1280, 1281, 1283, 2560, 61_440, 61_441, IMAGE, LARGEST,
        ] {
            let sent = message(length, length);
            network.write(0, there, &sent);
            assert!(network.taken(1) == [sent.clone()], "{length} bytes there");
            network.write(1, back, &sent);
            assert!(network.taken(0) == [sent], "{length} bytes back");
        }
    }
}

#[test]
fn reliable_messages_arrive_in_order_whatever_is_lost() {
    for (addresses, loss) in [
        ([[10, 0, 0, 1], [10, 0, 0, 1]], 0.2),
        ([[10, 0, 0, 1], [10, 0, 0, 2]], 0.05),
    ] {
        let mut network = Network::new(&addresses);
        network.loss = loss;
        let writer = network.writer(0, "image", Qos::DEFAULT);
        let reader = network.reader(1, "image", Qos::DEFAULT);
        network.run(DISCOVERY);
        let sent: Vec<_> = (0..30)
            .map(|seed| message(if seed % 3 == 0 { IMAGE } else { 100 }, seed))
            .collect();
        for message in &sent {
            network.write(0, writer, message);
            network.run(Duration::from_millis(100));
        }
        network.run(Duration::from_secs(1));
        assert!(network.taken(1) == sent);
        let (_, counts) = network.engines[1].2.reader_counts(reader);
        assert_eq!((counts.received, counts.lost, counts.refused), (30, 0, 0));
    }
}

#[test]
fn lost_messages_are_counted() {
    let mut network = Network::new(&[[10, 0, 0, 1], [10, 0, 0, 2]]);
    let writer = network.writer(0, "image", Qos::SENSOR_DATA);
    let reader = network.reader(1, "image", Qos::SENSOR_DATA);
    network.run(DISCOVERY);
    network.write(0, writer, &message(100, 0));
    network.loss = 0.02;
    let sent: Vec<_> = (0..100).map(|seed| message(20_000, seed)).collect();
    for message in &sent {
        network.write(0, writer, message);
    }
    network.loss = 0.0;
    network.write(0, writer, &message(100, 0));
    let received = network.taken(1);
    let (_, counts) = network.engines[1].2.reader_counts(reader);
    // Each of 16 fragments arrives with a probability of 0.98: 72 of 100 messages, with a standard deviation of 4.5.
    assert!((60..=86).contains(&received.len()), "{}", received.len());
    assert_eq!(counts.received as usize, received.len());
    assert_eq!(counts.received + counts.lost, 102);
    let inner = &received[1..received.len() - 1];
    assert!(inner.iter().all(|message| sent.contains(message)));
}

#[test]
fn the_last_message_is_kept_for_those_that_ask_for_it() {
    let mut network = Network::new(&[[10, 0, 0, 1], [10, 0, 0, 2]]);
    let writer = network.writer(0, "tf_static", Qos::LATCHED);
    for seed in 0..3 {
        network.write(0, writer, &message(5000, seed));
    }
    network.reader(1, "tf_static", Qos::LATCHED);
    network.run(DISCOVERY);
    assert!(network.taken(1) == [message(5000, 2)]);
    // Without asking, only what is written from then on.
    let late = network.join([10, 0, 0, 3]);
    network.reader(late, "tf_static", Qos::DEFAULT);
    network.run(DISCOVERY);
    assert!(network.taken(late).is_empty());
    network.write(0, writer, &message(5000, 3));
    assert!(network.taken(late) == [message(5000, 3)]);
    assert!(network.taken(1) == [message(5000, 3)]);
}

#[test]
fn incompatible_ends_are_counted_not_matched() {
    let mut network = Network::new(&[[10, 0, 0, 1], [10, 0, 0, 2]]);
    let writer = network.writer(0, "image", Qos::SENSOR_DATA);
    let reader = network.reader(1, "image", Qos::DEFAULT);
    network.run(DISCOVERY);
    let (matches, _) = network.engines[1].2.reader_counts(reader);
    assert_eq!((matches.matched, matches.incompatible), (0, 1));
    let (matches, _) = network.engines[0].2.writer_counts(writer);
    assert_eq!((matches.matched, matches.incompatible), (0, 1));
    let topics = network.engines[1].2.topics();
    assert_eq!(topics.len(), 1);
    assert_eq!(topics[0].name, "/image");
    assert_eq!(topics[0].message_type, "sensor_msgs/msg/Image");
    assert_eq!((topics[0].publishers, topics[0].subscribers), (1, 0));
}

#[test]
fn a_participant_that_died_is_replaced() {
    let mut network = Network::new(&[[10, 0, 0, 1], [10, 0, 0, 2]]);
    let writer = network.writer(0, "image", Qos::DEFAULT);
    network.reader(1, "image", Qos::DEFAULT);
    network.run(DISCOVERY);
    let matched = |network: &Network| network.engines[0].2.writer_counts(writer).0.matched;
    assert_eq!(matched(&network), 1);
    // It ends without announcing that, and another one comes.
    network.engines[1].1 = DEAD;
    let next = network.join([10, 0, 0, 2]);
    network.reader(next, "image", Qos::DEFAULT);
    network.run(DISCOVERY);
    assert_eq!(matched(&network), 2);
    network.write(0, writer, &message(IMAGE, 1));
    assert!(network.taken(next) == [message(IMAGE, 1)]);
    network.run(Duration::from_secs(12));
    assert_eq!(matched(&network), 1);
    // This one says goodbye.
    let farewell = network.engines[next].2.farewell();
    network.multicast(next, &farewell);
    network.arrive();
    assert_eq!(matched(&network), 0);
}

#[test]
fn what_no_longer_exists_is_not_matched() {
    let mut network = Network::new(&[[10, 0, 0, 1], [10, 0, 0, 2]]);
    let writer = network.writer(0, "image", Qos::DEFAULT);
    let reader = network.reader(1, "image", Qos::DEFAULT);
    network.run(DISCOVERY);
    let Network {
        engines,
        on_the_way,
        now,
        ..
    } = &mut network;
    engines[1].2.remove(reader, (0, 0), *now, on_the_way);
    network.run(STEP);
    assert_eq!(network.engines[0].2.writer_counts(writer).0.matched, 0);
    assert!(network.engines[0].2.topics().is_empty());
}

#[test]
fn larger_messages_are_refused_and_counted() {
    let mut network = Network::new(&[[10, 0, 0, 1], [10, 0, 0, 2]]);
    let writer = network.writer(0, "image", Qos::SENSOR_DATA);
    let reader = network.reader(1, "image", Qos::SENSOR_DATA);
    network.run(DISCOVERY);
    network.write(0, writer, &message(LARGEST + 1, 0));
    assert!(network.taken(1).is_empty());
    let (_, counts) = network.engines[1].2.reader_counts(reader);
    assert!(counts.refused > 0);
}

/// Damaged datagrams, and chance, at any moment of an exchange.
#[test]
fn no_datagram_is_fatal() {
    let mut network = Network::new(&[[10, 0, 0, 1], [10, 0, 0, 2]]);
    let writer = network.writer(0, "image", Qos::DEFAULT);
    network.reader(1, "image", Qos::DEFAULT);
    network.run(DISCOVERY);
    let mut rng = Rng::stream(7, &["damage"]);
    let mut below = |end: usize| rng.below(end as u32) as usize;
    for round in 0..300 {
        network.engines[0].2.write(
            writer,
            message(3000, round).into(),
            (0, 0),
            network.now,
            &mut network.on_the_way,
        );
        for datagram in &mut network.on_the_way {
            for _ in 0..below(4) {
                let at = below(datagram.bytes.len());
                datagram.bytes[at] = below(256) as u8;
            }
            datagram
                .bytes
                .truncate(20 + below(2 * datagram.bytes.len()));
        }
        network.arrive();
        network.run(STEP);
        let noise: Vec<u8> = b"RTPS\x02\x03\x00\x00"
            .iter()
            .copied()
            .chain((0..below(300)).map(|_| below(256) as u8))
            .collect();
        network.multicast(0, &noise);
        network.arrive();
    }
    assert!(network.engines[1].2.malformed > 0);
}
