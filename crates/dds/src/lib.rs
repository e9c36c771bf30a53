//! Topics of ROS 2 over DDS without ROS: raw messages, in and out, by the RTPS protocol (OMG DDSI-RTPS 2.5) over UDP, which
//! `rmw_fastrtps_cpp` and `rmw_cyclonedds_cpp` speak.
//!
//! ```no_run
//! # fn main() -> lsdc_dds::Result<()> {
//! use lsdc_dds::{Participant, Qos, Settings};
//!
//! let (domain, settings) = Settings::from_environment()?;
//! let participant = Participant::new(domain, settings)?;
//! let depth = participant.advertise("/depth", "sensor_msgs/msg/Image", Qos::DEFAULT)?;
//! let subscription = participant.subscribe(
//!     "/camera/image_raw",
//!     "sensor_msgs/msg/Image",
//!     Qos::SENSOR_DATA,
//!     // The same image under another name.
//!     Box::new(move |message| depth.publish(&message).unwrap_or_default()),
//! )?;
//! std::thread::park();
//! println!("{:?}", subscription.status());
//! # Ok(())
//! # }
//! ```
//!
//! Implemented is what topics need: discovery of participants and of their readers and writers, fragmented messages,
//! best effort and reliable delivery, and the last messages for late readers. There are no keys, services,
//! security profiles, shared memory or IPv6.

mod announcement;
mod engine;
mod error;
mod graph;
mod interfaces;
mod names;
mod participant;
mod qos;
mod reader;
mod settings;
mod sockets;
#[cfg(test)]
mod tests;
mod wire;
mod writer;

pub use engine::{Matches, TopicInfo};
pub use error::{Error, Result};
pub use participant::{
    Participant, ParticipantCounts, Publisher, PublisherStatus, Subscription, SubscriptionStatus,
};
pub use qos::Qos;
pub use reader::ReceptionCounts;
pub use settings::{Generation, Settings};
