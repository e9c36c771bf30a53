//! Recordings of ROS 2, read and written without ROS: MCAP files and the SQLite bags of rosbag2.
//!
//! A [`Recording`] is visited message by message, and any message can be read again by its [`Place`]; it is never held
//! whole. [`Survey`] counts what is in it. [`Frames`] finds the points that belong to each image: those nearest in time,
//! seen from where the camera was ([`Transforms`]). [`Writer`] writes MCAP.
//!
//! ```no_run
//! # fn main() -> lsdc_files::error::Result<()> {
//! use lsdc_recordings::{Frames, Recording, Wanted};
//! let mut recording = Recording::open("drive.mcap".as_ref())?;
//! let frames = Frames::of(&mut recording, &Wanted::default())?;
//! for frame in &frames.found {
//!     let loaded = frames.read(&mut recording, frame)?.decode(&frames)?;
//!     println!("{}: {} points", frame.stamp, loaded.points.points.len());
//! }
//! # Ok(())
//! # }
//! ```
//!
//! A decoded frame is what `lsdc-files` makes of files; `lsdc-core` completes it.

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

pub use container::{Flaws, Message, Place, Topic};
pub use frames::{Deskewed, Dropped, Frame, Frames, Loaded, Reason, Stored, Wanted};
pub use message::{Header, Kind, Stamp, TransformStamped, write_cloud, write_depth};
pub use recording::Recording;
pub use rigid::Rigid;
pub use survey::{Counted, Survey};
pub use transforms::{Gap, Route, Transforms};
pub use writer::{Times, Writer};

#[cfg(test)]
mod tests;
