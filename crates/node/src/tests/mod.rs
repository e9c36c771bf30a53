//! Recordings that are sent to a node message by message.

mod damaged;
mod latency;
mod live;

use crate::{ManualClock, MemoryTransport, Node, NodeConfig, Published};
use lsdc_core::settings::{FitConfig, FitMethod, PriorKind};
use lsdc_core::{Channels, Completer, Image};
use lsdc_recordings::{FrameOptions, Frames, Recording, write_depth};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::Receiver;

/// A recording of `scripts/recordings.py`.
fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden/recordings")
        .join(name)
}

/// A message that is sent.
#[derive(Clone)]
struct Sent {
    topic: String,
    /// In nanoseconds.
    log: u64,
    data: Vec<u8>,
}

fn messages(name: &str) -> Vec<Sent> {
    let mut found = Vec::new();
    let mut recording = Recording::open(&golden(name)).unwrap();
    let visited = recording.visit(&|_| true, &mut |topic, message| {
        found.push(Sent {
            topic: topic.name.clone(),
            log: message.times.log,
            data: message.data.to_vec(),
        });
        Ok(())
    });
    visited.unwrap();
    found
}

/// The same messages with stamps of an earlier time. Messages of transforms have one each.
fn earlier(messages: &[Sent], seconds: i32) -> Vec<Sent> {
    let shifted = |message: &Sent| {
        let mut message = message.clone();
        // Behind the start of CDR, and the number of transforms.
        let at = if message.topic.starts_with("/tf") {
            8
        } else {
            4
        };
        let (stamp, _) = message.data[at..].split_first_chunk_mut().unwrap();
        *stamp = (i32::from_le_bytes(*stamp) - seconds).to_le_bytes();
        message
    };
    messages.iter().map(shifted).collect()
}

fn frames(name: &str, points: Option<&str>) -> (Recording, Frames) {
    let mut recording = Recording::open(&golden(name)).unwrap();
    let options = FrameOptions {
        points: points.map(str::to_owned),
        ..FrameOptions::default()
    };
    let frames = Frames::of(&mut recording, &options).unwrap();
    (recording, frames)
}

/// A fit of a field along the colours of the image: quick, and different for any other points.
fn completer() -> Completer {
    let fit = FitConfig {
        method: FitMethod::Joint,
        prior: PriorKind::Learned,
        ..FitConfig::default()
    };
    Completer::without_network(fit).unwrap()
}

/// The messages of depths that the file of the recording gives.
fn depths_of_file(name: &str, points: Option<&str>) -> Vec<Vec<u8>> {
    let (mut recording, frames) = frames(name, points);
    let completer = completer();
    let mut depths = Vec::new();
    for frame in &frames.found {
        let stored = frames.read(&mut recording, frame).unwrap();
        let found = stored.decode(&frames).unwrap();
        let (width, height) = (found.image.width() as usize, found.image.height() as usize);
        let image = Image::new(width, height, Channels::Rgb, found.image.as_raw()).unwrap();
        let scene = completer.scene(&image).unwrap();
        let depth = scene.complete(&found.points.points).unwrap().depth();
        depths.push(write_depth(&found.header, &depth.unwrap(), false).0);
    }
    depths
}

/// A node on a bus within the process.
struct Robot {
    bus: MemoryTransport,
    outputs: Receiver<Published>,
    clock: Arc<ManualClock>,
    node: Node,
}

impl Robot {
    fn new(config: NodeConfig) -> Self {
        let clock = Arc::new(ManualClock::default());
        let mut bus = MemoryTransport::default();
        let outputs = bus.outputs();
        let node = Node::new(config, completer(), None, clock.clone(), &mut bus).unwrap();
        Self {
            bus,
            outputs,
            clock,
            node,
        }
    }

    /// Sends messages at the times that they were recorded, and lets the node work after each, and at last until nothing waits.
    fn play(&mut self, messages: &[Sent]) {
        for message in messages {
            self.clock.set(message.log as i64);
            self.bus.send(&message.topic, &message.data);
            self.node.turn();
        }
        while self.node.status().waiting() > 0 {
            self.clock.advance(std::time::Duration::from_millis(50));
            self.node.turn();
        }
    }

    fn published(&self, topic: &str) -> Vec<Vec<u8>> {
        let all = self.outputs.try_iter();
        let of_topic = all.filter(|published| published.topic == topic);
        of_topic.map(|published| published.message).collect()
    }
}
