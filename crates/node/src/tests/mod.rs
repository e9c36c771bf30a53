//! Recordings that are sent to a node message by message.

mod damaged;
mod latency;
mod live;
#[path = "../../../recordings/src/tests/sent.rs"]
mod sent;
mod views;

use crate::{ManualClock, MemoryTransport, Node, NodeConfig, Published};
use lsdc_core::settings::{FitConfig, FitMethod, PriorKind};
use lsdc_core::{Channels, Completer, Image, Scene};
use lsdc_recordings::{DecodedFrame, FrameOptions, Frames, Recording, write_depth};
use sent::{Sent, earlier, golden};
use std::sync::Arc;
use std::sync::mpsc::Receiver;

fn messages(name: &str) -> Vec<Sent> {
    sent::messages(&golden(name))
}

fn frames(name: &str, points: Option<&str>) -> (Recording, Frames) {
    let options = FrameOptions {
        points: points.map(str::to_owned),
        ..FrameOptions::default()
    };
    sent::frames(&golden(name), &options)
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
    let mut depths = Vec::new();
    for frame in &frames.found {
        let stored = frames.read(&mut recording, frame).unwrap();
        let found = stored.decode(&frames).unwrap();
        let completion = scene(&found).complete(&found.points.points);
        let depth = completion.unwrap().depth().unwrap();
        depths.push(write_depth(&found.header, &depth, false).0);
    }
    depths
}

fn scene(found: &DecodedFrame) -> Scene {
    let (width, height) = (found.image.width() as usize, found.image.height() as usize);
    let image = Image::new(width, height, Channels::Rgb, found.image.as_raw()).unwrap();
    completer().scene(&image).unwrap()
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
