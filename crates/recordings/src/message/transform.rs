//! `tf2_msgs/msg/TFMessage`: poses of frames of reference.

use super::{Header, MessageType, Timestamp, read_message};
use crate::rigid::Rigid;
use lsdc_files::error::Result;

/// The pose of a frame in another one.
#[derive(Clone, Debug, PartialEq)]
pub struct TransformStamped {
    /// Time of the pose.
    pub stamp: Timestamp,
    /// Frame in which the pose is given.
    pub parent: String,
    /// Frame whose pose is given.
    pub child: String,
    /// Transform from the child's coordinates to the parent's.
    pub rigid: Rigid,
}

/// Reads the transforms of a message. Returns the valid ones and the number of invalid ones, which have non-finite numbers
/// or a rotation of length 0.
///
/// # Errors
/// The message is damaged.
pub(crate) fn transforms(message: &[u8]) -> Result<(Vec<TransformStamped>, usize)> {
    /// Size of a transform without names, in bytes.
    const LEAST: usize = 72;
    read_message(MessageType::Transforms, message, |reader| {
        let count = reader.length(LEAST)?;
        let mut found = Vec::with_capacity(count);
        let mut unusable = 0;
        for _ in 0..count {
            let header = Header::read(reader)?;
            let child = reader.string()?.trim_start_matches('/').to_owned();
            let translation = reader.array()?;
            let rotation = reader.array()?;
            match Rigid::new(rotation, translation) {
                Some(rigid) => found.push(TransformStamped {
                    stamp: header.stamp,
                    parent: header.frame,
                    child,
                    rigid,
                }),
                None => unusable += 1,
            }
        }
        Ok((found, unusable))
    })
}
