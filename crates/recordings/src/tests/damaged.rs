//! Damaged messages: an error or a result, never a panic.

use super::golden;
use super::sent::{damaged, messages};
use crate::Recording;
use crate::fuzzing::{LIVE_TOPICS, live, read};
use crate::message::MessageType;
use lsdc_rng::Rng;

#[test]
fn damaged_messages_do_no_harm() {
    let mut intact: Vec<(MessageType, Vec<u8>)> = Vec::new();
    for name in ["zstd.mcap", "drive.mcap", "turn.mcap"] {
        let visited =
            Recording::open(&golden(name))
                .unwrap()
                .visit(&|_| true, &mut |topic, message| {
                    intact.extend(
                        MessageType::of(&topic.kind).map(|kind| (kind, message.data.to_vec())),
                    );
                    Ok(())
                });
        visited.unwrap();
    }
    let mut refused = 0;
    for (number, (kind, data)) in intact.iter().enumerate() {
        assert!(read(*kind, data), "{kind:?}");
        for copy in 0..200 {
            let mut rng = Rng::stream(copy, &["message", &number.to_string()]);
            let copy = damaged(data, 0.3, &mut rng);
            refused += u32::from(!read(*kind, &copy));
        }
    }
    assert!(refused > 1000, "{refused}");
}

/// The entry point of the fuzz target `node`, with a drive and its damaged copies: each image is returned once.
#[test]
fn a_running_robot_that_sends_anything_does_no_harm() {
    let intact = messages(&golden("drive.mcap"));
    let topics = [
        "/camera/image_raw/compressed",
        "/lidar/points",
        "/camera/camera_info",
        "/tf",
        "/tf_static",
    ];
    assert_eq!(topics.len(), LIVE_TOPICS.len());
    let mut decoded = 0;
    for copy in 0..40 {
        let mut rng = Rng::stream(copy, &["live"]);
        let mut session = Vec::new();
        for message in &intact {
            let topic = topics.iter().position(|topic| *topic == message.topic);
            let data = if copy > 0 && rng.chance(0.2) {
                damaged(&message.data, 0.3, &mut rng)
            } else {
                message.data.clone()
            };
            session.push(topic.unwrap() as u8);
            session.extend((data.len() as u16).to_le_bytes());
            session.extend(data);
        }
        // Random bytes at the end.
        session.extend((0..rng.below(600)).map(|_| rng.below(256) as u8));
        let [images, returned, frames] = live(&session);
        assert!(images >= 6);
        assert_eq!(returned, images);
        decoded += frames;
    }
    assert!(decoded > 40, "{decoded}");
}
