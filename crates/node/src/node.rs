//! The node: from messages to published depth.

use crate::clock::Clock;
use crate::config::{NodeConfig, camera_info_beside};
use crate::engine::{Completed, Engine, FrameMoments, Output, Prepared};
use crate::inbox::{Inbox, Received};
use crate::quality::Governor;
use crate::slot::Slot;
use crate::status::NodeStatus;
use crate::transport::{Advertisement, Publisher, Qos, Subscription, Transport};
use lsdc_core::Completer;
use lsdc_files::error::{Cause, Error, Result};
use lsdc_recordings::{
    DIAGNOSTIC_ARRAY, DropReason, LiveFrame, LiveFrames, MessageType, write_diagnostics,
};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Queue limits: of images, of which only the newest is completed; of points and cameras; of transforms, which may
/// arrive at several kHz.
const IMAGES: usize = 4;
const OTHERS: usize = 32;
const TRANSFORMS: usize = 8192;
/// Interval between diagnostics.
const PERIOD: Duration = Duration::from_secs(1);

/// A node that completes the newest image.
///
/// [`Self::run`] uses two threads: the network processes an image while the previous one is fitted. [`Self::turn`] does all
/// pending work on the calling thread, for tests and for programs with their own loop.
///
/// ```
/// # fn main() -> lsdc_files::error::Result<()> {
/// use lsdc_core::settings::FitConfig;
/// use lsdc_core::Completer;
/// use lsdc_node::{ManualClock, MemoryTransport, Node, NodeConfig, conventional_topics};
/// use std::sync::Arc;
///
/// let config = NodeConfig::new(conventional_topics("/camera/image_raw", "/lidar/points"));
/// let completer = Completer::without_network(FitConfig::default())?;
/// let mut bus = MemoryTransport::default();
/// let mut node = Node::new(config, completer, None, Arc::new(ManualClock::default()), &mut bus)?;
/// bus.send("/camera/image_raw", b"no image");
/// node.turn();
/// let status = node.status();
/// assert_eq!((status.images, status.completed, status.left_out["damaged"]), (1, 0, 1));
/// # Ok(())
/// # }
/// ```
pub struct Node {
    front: Front,
    back: Back,
    shared: Arc<Shared>,
}

/// A handle that stops a running node.
#[derive(Clone)]
pub struct NodeHandle(Arc<Shared>);

impl NodeHandle {
    /// Makes [`Node::run`] return after the current image.
    pub fn stop(&self) {
        self.0.inbox.close();
    }

    /// Statistics since the node was created.
    pub fn status(&self) -> NodeStatus {
        self.0.status()
    }
}

/// State shared by both threads.
struct Shared {
    inbox: Arc<Inbox>,
    image_topic: usize,
    other_topics: Vec<usize>,
    clock: Arc<dyn Clock>,
    engine: Engine,
    state: Mutex<State>,
}

struct State {
    status: NodeStatus,
    governor: Governor,
}

/// The first stage: up to the network.
struct Front {
    live: LiveFrames,
    /// The newest complete frame, and when it became complete.
    held: Option<(LiveFrame, Duration)>,
    diagnostics: Box<dyn Publisher>,
    name: String,
    image_topic: String,
    /// The last diagnostics, and when they were published.
    published: (Duration, NodeStatus),
}

/// The second stage: from the fit on.
struct Back {
    publishers: Vec<(Output, Box<dyn Publisher>)>,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn status(&self) -> NodeStatus {
        let mut status = self.state().status.clone();
        self.count_lost(&mut status);
        status
    }

    /// Adds the messages dropped by the inbox.
    fn count_lost(&self, status: &mut NodeStatus) {
        let images = self.inbox.lost(self.image_topic);
        status.images += images;
        if images > 0 {
            let kind = DropReason::Superseded.kind();
            *status.left_out.entry(kind).or_default() += images;
        }
        let others = self.other_topics.iter();
        status.lost = others.map(|topic| self.inbox.lost(*topic)).sum();
    }

    /// Unwraps the result of a stage; a failed image is counted.
    fn guarded<T>(&self, stage: &'static str, work: impl FnOnce() -> Result<T>) -> Option<T> {
        let found = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
            let what = "a part of the program broke off";
            Err(Error::new(Cause::Fit, what))
        });
        let failed = |error: Error| {
            let status = &mut self.state().status;
            status.leave_out(stage, error.with_causes());
        };
        found.map_err(failed).ok()
    }

    fn prepare(&self, (frame, ready): &(LiveFrame, Duration)) -> Option<Prepared> {
        let times = FrameMoments {
            received: frame.received(),
            ready: *ready,
        };
        let level = self.state().governor.level();
        self.guarded("that cannot be decoded", || {
            self.engine.prepare(frame, level, times)
        })
    }

    fn complete(&self, prepared: Prepared) -> Option<Completed> {
        self.guarded("that cannot be fitted", || self.engine.complete(prepared))
    }
}

impl Front {
    /// Handles all queued messages, and keeps the newest complete frame.
    fn read(&mut self, shared: &Shared) {
        while let Some((topic, received)) = shared.inbox.take() {
            self.live.add(&topic, received.message, received.receipt);
        }
        let now = shared.clock.elapsed();
        let mut dropped = Vec::new();
        while let Some(decided) = self.live.next(now) {
            match decided {
                Ok(frame) => {
                    if self.held.replace((frame, now)).is_some() {
                        dropped.push(DropReason::Superseded);
                    }
                }
                Err(found) => dropped.push(found.reason),
            }
        }
        let mut state = shared.state();
        let status = &mut state.status;
        for reason in &dropped {
            status.drop_image(reason);
        }
        status.inputs = self.live.counts();
        status.images = status.inputs.images;
        status.lacking = self.live.lacking().map(str::to_owned);
        if status.remarks != self.live.remarks() {
            self.live.remarks().clone_into(&mut status.remarks);
        }
    }

    /// Publishes diagnostics, if they are due.
    fn diagnose(&mut self, shared: &Shared) {
        let now = shared.clock.elapsed();
        let (last, before) = &self.published;
        if now.saturating_sub(*last) < PERIOD {
            return;
        }
        let status = shared.status();
        let part = status.diagnostic(before, &self.name, &self.image_topic);
        let message = write_diagnostics(shared.clock.stamp(), &[part]);
        if self.diagnostics.publish(&message).is_err() {
            shared.state().status.unpublished += 1;
        }
        self.published = (now, status);
    }

    /// Time until something is due without another message.
    fn idle(&self, shared: &Shared) -> Duration {
        let next = self.published.0.saturating_add(PERIOD);
        let next = self
            .live
            .deadline()
            .map_or(next, |deadline| deadline.min(next));
        next.saturating_sub(shared.clock.elapsed())
    }
}

impl Back {
    fn publish(&self, shared: &Shared, completed: Completed) {
        let Completed {
            messages,
            facts,
            level,
            times,
        } = completed;
        let mut failed = Vec::new();
        for (output, message) in messages {
            let publisher = self.publishers.iter().find(|(of, _)| *of == output);
            if let Some(Err(error)) = publisher.map(|(_, publisher)| publisher.publish(&message)) {
                failed.push((output, error));
            }
        }
        let now = shared.clock.elapsed();
        let mut state = shared.state();
        let State { status, governor } = &mut *state;
        status.unpublished += failed.len() as u64;
        match failed.iter().find(|(output, _)| *output == Output::Depth) {
            Some((_, error)) => status.leave_out("that cannot be published", error.with_causes()),
            None => status.completed += 1,
        }
        let latency = now.saturating_sub(times.ready);
        governor.add(level, latency);
        status.quality = Some(governor.level());
        status.late = governor.late;
        status.latency = Some(latency);
        status.age = Some(now.saturating_sub(times.received));
        status.alone += u64::from(shared.engine.has_views() && facts.carried.is_none());
        status.facts = facts;
    }
}

impl Node {
    /// Subscribes to the topics of a configuration, and advertises those of its results. `small` are the weights used when a
    /// deadline requires faster ones.
    ///
    /// # Errors
    /// Errors of the transport.
    pub fn new(
        config: NodeConfig,
        completer: Completer,
        small: Option<Completer>,
        clock: Arc<dyn Clock>,
        transport: &mut dyn Transport,
    ) -> Result<Self> {
        let engine = Engine::new(&config, completer, small);
        let has_views = engine.has_views();
        let governor = Governor::new(config.max_latency, engine.has_small_weights());
        let publishers = advertise(&config, transport)?;
        let diagnostics = transport.advertise(&Advertisement {
            topic: "/diagnostics".to_owned(),
            kind: DIAGNOSTIC_ARRAY.to_owned(),
            qos: Qos::RESULTS,
        })?;
        let inbox = Arc::new(Inbox::default());
        let topics = subscribe(&config, &inbox, &clock, transport)?;
        let shared = Arc::new(Shared {
            image_topic: topics[0],
            other_topics: topics[1..].to_vec(),
            inbox,
            engine,
            state: Mutex::new(State {
                status: NodeStatus::default(),
                governor,
            }),
            clock,
        });
        let live = LiveFrames::new(config.topics.clone(), &config.frames, config.patience);
        let front = Front {
            image_topic: config.topics.image.0,
            live: if has_views { live.with_poses() } else { live },
            held: None,
            diagnostics,
            name: config.name,
            published: (shared.clock.elapsed(), NodeStatus::default()),
        };
        Ok(Self {
            front,
            back: Back { publishers },
            shared,
        })
    }

    /// Returns a handle that stops the node while it runs.
    pub fn handle(&self) -> NodeHandle {
        NodeHandle(self.shared.clone())
    }

    /// Statistics since the node was created.
    pub fn status(&self) -> NodeStatus {
        self.shared.status()
    }

    /// Handles all queued messages, and completes the newest image that has points, on the calling thread. Returns the
    /// time until something is due without another message.
    pub fn turn(&mut self) -> Duration {
        let Self {
            front,
            back,
            shared,
        } = self;
        front.read(shared);
        let prepared = front.held.take().and_then(|held| shared.prepare(&held));
        if let Some(completed) = prepared.and_then(|prepared| shared.complete(prepared)) {
            back.publish(shared, completed);
        }
        front.diagnose(shared);
        front.idle(shared)
    }

    /// Completes images until it is [stopped](NodeHandle::stop).
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn run(self) -> Result<()> {
        let Self {
            mut front,
            back,
            shared,
        } = self;
        let (shared, slot) = (&*shared, &Slot::default());
        std::thread::scope(|scope| {
            let thread = std::thread::Builder::new().name("lsdc-fit".to_owned());
            let fitting = move || {
                while let Some(prepared) = slot.take() {
                    // The network may process the next image.
                    shared.inbox.wake();
                    if let Some(completed) = shared.complete(prepared) {
                        back.publish(shared, completed);
                    }
                }
            };
            let started = thread.spawn_scoped(scope, fitting);
            started.map_err(|error| {
                Error::new(Cause::Config, "no thread can be started for the fit").because(error)
            })?;
            while shared.inbox.wait(front.idle(shared)) {
                front.read(shared);
                if slot.is_empty()
                    && let Some(held) = front.held.take()
                    && let Some(prepared) = shared.prepare(&held)
                {
                    slot.put(prepared);
                }
                front.diagnose(shared);
            }
            slot.close();
            Ok(())
        })
    }
}

/// Advertises the results.
fn advertise(
    config: &NodeConfig,
    transport: &mut dyn Transport,
) -> Result<Vec<(Output, Box<dyn Publisher>)>> {
    let NodeConfig { name, topics, .. } = config;
    let own = |end: &str| format!("/{name}/{end}");
    let depth = config.depth.clone().unwrap_or_else(|| own("depth/image"));
    let camera_info = camera_info_beside(&depth);
    let (image, cloud) = (MessageType::Image, MessageType::PointCloud2);
    // The camera info of the images may already be published beside this topic.
    let is_new = ![&topics.camera_info, &topics.depth_info]
        .into_iter()
        .flatten()
        .any(|taken| *taken == camera_info);
    let wanted = [
        (Output::Depth, true, depth, image),
        (
            Output::CameraInfo,
            is_new && topics.camera_info.is_some(),
            camera_info,
            MessageType::CameraInfo,
        ),
        (
            Output::StandardDeviation,
            config.standard_deviation,
            own("standard_deviation/image"),
            image,
        ),
        (Output::Outliers, config.outliers, own("outliers"), cloud),
        (Output::Cloud, config.cloud.is_some(), own("points"), cloud),
    ];
    let mut publishers = Vec::new();
    for (output, _, topic, kind) in wanted.into_iter().filter(|(_, wanted, ..)| *wanted) {
        let publisher = transport.advertise(&Advertisement {
            topic,
            kind: kind.name().to_owned(),
            qos: Qos::RESULTS,
        })?;
        publishers.push((output, publisher));
    }
    Ok(publishers)
}

/// Subscribes to all topics, and returns their indices in the inbox, that of the images first.
fn subscribe(
    config: &NodeConfig,
    inbox: &Arc<Inbox>,
    clock: &Arc<dyn Clock>,
    transport: &mut dyn Transport,
) -> Result<Vec<usize>> {
    let topics = &config.topics;
    let qos = Qos {
        reliable: config.reliable,
        ..Qos::SENSOR_DATA
    };
    let one = |(name, kind): &(String, MessageType), limit| (name.clone(), *kind, qos, limit);
    let mut wanted = vec![one(&topics.image, IMAGES), one(&topics.points, OTHERS)];
    for info in [&topics.camera_info, &topics.depth_info]
        .into_iter()
        .flatten()
    {
        let known = wanted.iter().any(|(name, ..)| name == info);
        if !known && config.frames.camera.is_none() {
            let kind = MessageType::CameraInfo;
            wanted.push((info.clone(), kind, qos, OTHERS));
        }
    }
    for tf in &topics.tf {
        let qos = if tf.ends_with("static") {
            Qos::TF_STATIC
        } else {
            Qos::TF
        };
        wanted.push((tf.clone(), MessageType::Transforms, qos, TRANSFORMS));
    }
    let mut numbers = Vec::new();
    for (topic, kind, qos, limit) in wanted {
        let number = inbox.add_topic(&topic, limit);
        let (inbox, clock) = (inbox.clone(), clock.clone());
        let subscription = Subscription {
            topic,
            kind: kind.name().to_owned(),
            qos,
        };
        let deliver = move |message| {
            inbox.put(Received {
                topic: number,
                message,
                receipt: clock.receipt(),
            });
        };
        transport.subscribe(&subscription, Box::new(deliver))?;
        numbers.push(number);
    }
    Ok(numbers)
}
