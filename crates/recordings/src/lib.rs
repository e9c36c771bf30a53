//! Recordings of ROS 2, read and written without ROS: MCAP files and the SQLite bags of rosbag2.
//!
//! A [`Recording`] is visited message by message and never loaded whole; any message can be read again by its
//! [`MessageLocation`]. [`Survey`] counts its messages. [`Frames`] pairs each image with the points nearest in time and
//! moves them to the pose of the camera ([`Transforms`]). [`LiveFrames`] does the same with the messages of a running
//! robot. [`Writer`] writes MCAP.
//!
//! ```no_run
//! # fn main() -> lsdc_files::error::Result<()> {
//! use lsdc_recordings::{FrameOptions, Frames, Recording};
//! let mut recording = Recording::open("drive.mcap".as_ref())?;
//! let frames = Frames::of(&mut recording, &FrameOptions::default())?;
//! for frame in &frames.found {
//!     let loaded = frames.read(&mut recording, frame)?.decode(&frames)?;
//!     println!("{}: {} points", frame.stamp, loaded.points.points.len());
//! }
//! # Ok(())
//! # }
//! ```
//!
//! A decoded frame has the same types as one that `lsdc-files` reads from files; `lsdc-core` completes it.

mod cdr;
mod container;
mod definitions;
mod frames;
#[doc(hidden)]
pub mod fuzzing;
mod message;
mod recording;
mod rigid;
mod series;
mod survey;
mod transforms;
mod writer;

pub use container::{Defects, Message, MessageLocation, MessageTimes, Topic};
pub use definitions::message_definition;
pub use frames::{
    CameraPose, DecodedFrame, DecodedPoints, DropReason, DroppedFrame, FrameMessages, FrameOptions,
    FrameTopics, Frames, LiveCounts, LiveFrame, LiveFrames, NEIGHBOUR_WINDOW, PointTimes, Receipt,
    SyncedFrame,
};
pub use message::{
    DIAGNOSTIC_ARRAY, DiagnosticLevel, DiagnosticStatus, Header, MessageType, Timestamp,
    TransformStamped, write_camera_info, write_cloud, write_depth, write_diagnostics, write_points,
};
pub use recording::Recording;
pub use rigid::Rigid;
pub use survey::{Survey, TopicSummary};
pub use transforms::{Route, TransformGap, Transforms};
pub use writer::Writer;

#[cfg(test)]
extern crate self as lsdc_recordings;
#[cfg(test)]
mod tests;
