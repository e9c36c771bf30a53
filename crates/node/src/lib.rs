//! Depth completion of live ROS 2 topics, without ROS.
//!
//! A [`Node`] subscribes to images, points, cameras and transforms over a [`Transport`], and publishes the depth of the
//! newest image. [`lsdc_recordings::LiveFrames`] matches points to images, deskews and projects them, as for
//! recordings: live depths are bit for bit those of the recording.

mod clock;
mod config;
mod engine;
#[cfg(feature = "foxglove")]
mod foxglove;
mod inbox;
mod memory;
mod node;
mod parameters;
mod past;
mod quality;
mod slot;
mod status;
mod transport;

pub use clock::{Clock, ManualClock, SystemClock};
pub use config::{NodeConfig, camera_info_beside, conventional_topics};
#[cfg(feature = "foxglove")]
pub use foxglove::{Foxglove, ShownTransport};
pub use memory::{MemoryTransport, Published};
pub use node::{Node, NodeHandle};
pub use parameters::Parameters;
pub use quality::Level;
pub use status::NodeStatus;
pub use transport::{Advertisement, Deliver, Publisher, Qos, Subscription, Transport};

#[cfg(test)]
mod tests;
