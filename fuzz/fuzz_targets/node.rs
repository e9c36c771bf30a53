//! Messages of the topics of a node in any order: each image is returned once, whatever was sent before.
#![no_main]

use libfuzzer_sys::fuzz_target;
use lsdc_recordings::{FrameOptions, FrameTopics, LiveFrames, MessageType, Receipt};
use std::time::Duration;

const TOPICS: [&str; 5] = ["/image", "/points", "/camera_info", "/tf", "/tf_static"];

fuzz_target!(|data: &[u8]| {
    let topics = FrameTopics {
        image: (TOPICS[0].to_owned(), MessageType::Image),
        points: (TOPICS[1].to_owned(), MessageType::PointCloud2),
        camera_info: Some(TOPICS[2].to_owned()),
        depth_info: None,
        tf: TOPICS[3..].iter().map(|&tf| tf.to_owned()).collect(),
    };
    let mut live = LiveFrames::new(topics, &FrameOptions::default(), Duration::from_millis(3));
    let mut rest = data;
    let (mut step, mut returned) = (0, 0);
    let mut decode = |live: &mut LiveFrames, now| {
        while let Some(found) = live.next(now) {
            returned += 1;
            if let Ok(frame) = found {
                let _ = (frame.decode(), frame.camera_info());
            }
        }
    };
    // A topic, a length, and a message.
    while let [topic, low, high, after @ ..] = rest {
        let length = usize::from(u16::from_le_bytes([*low, *high])).min(after.len());
        let (message, next) = after.split_at(length);
        rest = next;
        step += 1;
        let receipt = Receipt {
            at: Duration::from_millis(step),
            stamp: step as i64,
        };
        live.add(
            TOPICS[usize::from(*topic) % TOPICS.len()],
            message.to_vec(),
            receipt,
        );
        decode(&mut live, receipt.at);
    }
    decode(&mut live, Duration::from_millis(step + 3));
    assert_eq!((live.waiting(), returned), (0, live.counts().images));
});
