//! Entry points for fuzzers and tests: the message readers without a recording, and the frames of a running robot.

use crate::frames::{FrameOptions, FrameTopics, LiveFrames, Receipt, timed};
use crate::message::{
    Header, MessageType, PointCloud, camera_of, colours, compressed_depths, depths, transforms,
};
use std::time::Duration;

/// Topics of [`live`]: compressed images, clouds, cameras, and transforms.
pub const LIVE_TOPICS: [&str; 5] = ["/image", "/points", "/camera_info", "/tf", "/tf_static"];

/// Sends messages to [`LiveFrames`], one per millisecond. Each message is encoded as its topic number in one byte, its
/// length in two, and its bytes. Returns the numbers of images received, images returned, and frames decoded.
pub fn live(data: &[u8]) -> [u64; 3] {
    let patience = Duration::from_millis(20);
    let [image, points, info, tf @ ..] = LIVE_TOPICS;
    let topics = FrameTopics {
        image: (image.to_owned(), MessageType::CompressedImage),
        points: (points.to_owned(), MessageType::PointCloud2),
        camera_info: Some(info.to_owned()),
        depth_info: None,
        tf: tf.map(str::to_owned).to_vec(),
    };
    let mut robot = LiveFrames::new(topics, &FrameOptions::default(), patience).with_poses();
    let (mut returned, mut decoded) = (0, 0);
    let mut look = |robot: &mut LiveFrames, now| {
        while let Some(found) = robot.next(now) {
            returned += 1;
            if let Ok(frame) = found {
                let _ = (frame.camera_info(), frame.pose().cloned());
                decoded += u64::from(frame.decode().is_ok());
            }
        }
    };
    let (mut rest, mut step) = (data, 0);
    while let [topic, low, high, after @ ..] = rest {
        let length = usize::from(u16::from_le_bytes([*low, *high])).min(after.len());
        let (message, next) = after.split_at(length);
        rest = next;
        step += 1;
        let receipt = Receipt {
            at: Duration::from_millis(step),
            stamp: step as i64,
        };
        let topic = LIVE_TOPICS[usize::from(*topic) % LIVE_TOPICS.len()];
        robot.add(topic, message.to_vec(), receipt);
        look(&mut robot, receipt.at);
    }
    look(&mut robot, Duration::from_millis(step) + patience);
    [robot.counts().images, returned, decoded]
}

/// Reads a message as the type of a number; the number after the last type selects the contents of a compressed depth
/// message. Returns whether all of it could be read.
pub fn message(number: u8, data: &[u8]) -> bool {
    let number = usize::from(number) % (MessageType::ALL.len() + 1);
    match MessageType::ALL.get(number) {
        Some(kind) => read(*kind, data),
        None => compressed_depths("32FC1; compressedDepth rvl", data).is_ok(),
    }
}

/// Reads a message as its type and as the types that it could be mistaken for.
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
