//! A deadline, on a clock that the publisher of the depth moves on.

use super::{completer, frames, messages};
use crate::{
    Advertisement, Deliver, Level, ManualClock, MemoryTransport, Node, NodeConfig, Publisher,
    Subscription, Transport,
};
use lsdc_files::error::{Cause, Error, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Passes messages on; that of the depth takes so many milliseconds, and fails if these are none.
struct SlowTransport {
    inner: MemoryTransport,
    clock: Arc<ManualClock>,
    milliseconds: Arc<AtomicU64>,
}

struct SlowPublisher(Arc<ManualClock>, Arc<AtomicU64>);

impl Transport for SlowTransport {
    fn subscribe(&mut self, subscription: &Subscription, deliver: Deliver) -> Result<()> {
        self.inner.subscribe(subscription, deliver)
    }

    fn advertise(&mut self, advertisement: &Advertisement) -> Result<Box<dyn Publisher>> {
        if advertisement.topic.ends_with("depth/image") {
            let publisher = SlowPublisher(self.clock.clone(), self.milliseconds.clone());
            return Ok(Box::new(publisher));
        }
        self.inner.advertise(advertisement)
    }
}

impl Publisher for SlowPublisher {
    fn publish(&self, _: &[u8]) -> Result<()> {
        let milliseconds = self.1.load(Ordering::Relaxed);
        self.0.advance(Duration::from_millis(milliseconds));
        if milliseconds == 0 {
            return Err(Error::new(Cause::Write, "nobody is there"));
        }
        Ok(())
    }
}

#[test]
fn a_deadline_lowers_quality_and_is_reported() {
    let (_, frames) = frames("drive.mcap", None);
    let config = NodeConfig {
        max_latency: Some(Duration::from_millis(50)),
        ..NodeConfig::new(frames.topics().clone())
    };
    let (clock, milliseconds) = (
        Arc::new(ManualClock::default()),
        Arc::new(AtomicU64::new(80)),
    );
    let mut bus = SlowTransport {
        inner: MemoryTransport::default(),
        clock: clock.clone(),
        milliseconds: milliseconds.clone(),
    };
    let small = Some(completer());
    let mut node = Node::new(config, completer(), small, clock.clone(), &mut bus).unwrap();
    let mut play = |node: &mut Node| {
        for message in messages("drive.mcap") {
            clock.set(message.log as i64);
            bus.inner.send(&message.topic, &message.data);
            node.turn();
        }
    };
    play(&mut node);
    let status = node.status();
    assert!(status.completed >= 3, "{status:?}");
    assert_eq!(status.quality, Some(Level::SmallWeights));
    assert_eq!(status.latency, Some(Duration::from_millis(80)));
    assert_eq!(status.late, status.completed);
    // What nobody takes is not completed, but counted.
    milliseconds.store(0, Ordering::Relaxed);
    play(&mut node);
    let after = node.status();
    assert_eq!(after.completed, status.completed);
    assert!(after.left_out["that cannot be published"] > 0);
    assert_eq!(
        after.unpublished,
        after.left_out["that cannot be published"]
    );
}
