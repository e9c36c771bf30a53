//! What fuzzers and tests call: the readers of messages, without a recording.

use crate::frames::timed;
use crate::message::{
    Header, MessageType, PointCloud, camera_of, colours, compressed_depths, depths, transforms,
};

/// Reads a message of the type of that number, as what it may be; behind the last type, what a message of compressed depths
/// holds. Says whether all of it could be read.
pub fn message(number: u8, data: &[u8]) -> bool {
    let number = usize::from(number) % (MessageType::ALL.len() + 1);
    match MessageType::ALL.get(number) {
        Some(kind) => read(*kind, data),
        None => compressed_depths("32FC1; compressedDepth rvl", data).is_ok(),
    }
}

/// Reads a message as what it says to be, and what it could be taken for.
pub(crate) fn read(kind: MessageType, data: &[u8]) -> bool {
    let _ = Header::of(data);
    match kind {
        MessageType::Image | MessageType::CompressedImage => {
            let colours = colours(kind, data).is_ok();
            let depths = depths(kind, data, None).is_ok();
            colours || depths
        }
        MessageType::CameraInfo => camera_of(data, false).is_ok() && camera_of(data, true).is_ok(),
        MessageType::PointCloud2 => PointCloud::of(data).is_ok_and(|points| {
            let stamp = Header::of(data).map_or(0, |header| header.stamp);
            let count = points.iter().count();
            count > 0 && timed(&points, stamp) <= count
        }),
        MessageType::Transforms => transforms(data).is_ok(),
    }
}
