//! The messages that are read and written: one type per file.

mod bayer;
mod camera_info;
mod cloud;
mod diagnostics;
mod image;
mod raw;
mod rvl;
mod transform;
mod yuv;

pub use camera_info::write_camera_info;
pub(crate) use camera_info::{StampedCamera, camera_of, restamped_camera_info};
pub(crate) use cloud::PointCloud;
pub use cloud::{write_cloud, write_points};
pub use diagnostics::{DIAGNOSTIC_ARRAY, DiagnosticLevel, DiagnosticStatus, write_diagnostics};
pub use image::write_depth;
pub(crate) use image::{colours, compressed_depths, depths, size_of};
pub use transform::TransformStamped;
pub(crate) use transform::transforms;

use crate::cdr::{CdrReader, CdrWriter};
use lsdc_files::error::{Error, Result};

/// The supported message types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MessageType {
    /// `sensor_msgs/msg/Image`.
    Image,
    /// `sensor_msgs/msg/CompressedImage`, of colours or of depths.
    CompressedImage,
    /// `sensor_msgs/msg/CameraInfo`.
    CameraInfo,
    /// `sensor_msgs/msg/PointCloud2`.
    PointCloud2,
    /// `tf2_msgs/msg/TFMessage`.
    Transforms,
}

impl MessageType {
    /// All types.
    pub const ALL: [Self; 5] = [
        Self::Image,
        Self::CompressedImage,
        Self::CameraInfo,
        Self::PointCloud2,
        Self::Transforms,
    ];

    /// Returns the name of the type in recordings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Image => "sensor_msgs/msg/Image",
            Self::CompressedImage => "sensor_msgs/msg/CompressedImage",
            Self::CameraInfo => "sensor_msgs/msg/CameraInfo",
            Self::PointCloud2 => "sensor_msgs/msg/PointCloud2",
            Self::Transforms => "tf2_msgs/msg/TFMessage",
        }
    }

    /// Returns the type with a name, as written in recordings.
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// Time of a measurement, in nanoseconds since 1970.
pub type Timestamp = i64;

/// The header of most messages.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Header {
    /// Time of the measurement.
    pub stamp: Timestamp,
    /// The frame of reference.
    pub frame: String,
}

const SECOND: i64 = 1_000_000_000;

impl Header {
    /// Reads the header at the start of a message.
    ///
    /// # Errors
    /// The message does not start with a header.
    pub fn of(message: &[u8]) -> Result<Self> {
        Self::read(&mut CdrReader::new(message)?)
    }

    pub(crate) fn read(reader: &mut CdrReader<'_>) -> Result<Self> {
        let (seconds, rest) = (reader.i32()?, reader.u32()?);
        Ok(Self {
            stamp: i64::from(seconds) * SECOND + i64::from(rest),
            // The first version of tf puts a slash before names.
            frame: reader.string()?.trim_start_matches('/').to_owned(),
        })
    }

    pub(crate) fn write(&self, writer: &mut CdrWriter) {
        writer.i32(self.stamp.div_euclid(SECOND) as i32);
        writer.u32(self.stamp.rem_euclid(SECOND) as u32);
        writer.string(&self.frame);
    }
}

/// Reads a message. Errors name its type.
fn read_message<'a, T>(
    kind: MessageType,
    message: &'a [u8],
    read: impl FnOnce(&mut CdrReader<'a>) -> Result<T>,
) -> Result<T> {
    let found = CdrReader::new(message).and_then(|mut reader| read(&mut reader));
    found.map_err(|error| {
        let what = format!("a message of {} {}", kind.name(), error.with_causes());
        let named = Error::new(error.cause(), what);
        match error.advice() {
            Some(hint) => named.hint(hint),
            None => named,
        }
    })
}
