//! `tf2_msgs/msg/TFMessage`: where frames of reference are.

use super::{Header, MessageType, Timestamp, read_message};
use crate::rigid::Rigid;
use lsdc_files::error::Result;

/// Where a frame is in another one.
#[derive(Clone, Debug, PartialEq)]
pub struct TransformStamped {
    /// When.
    pub stamp: Timestamp,
    /// The frame that it is in.
    pub parent: String,
    /// The frame that is there.
    pub child: String,
    /// From the child's coordinates to the parent's.
    pub rigid: Rigid,
}

/// The transforms of a message. Those that are none, with numbers that are not finite or a rotation of length 0, are
/// counted.
///
/// # Errors
/// A damaged message.
pub(crate) fn transforms(message: &[u8]) -> Result<(Vec<TransformStamped>, usize)> {
    /// Of a transform without names.
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
