//! Messages that are damaged, by accident or on purpose.

use super::sent::{Sent, damaged};
use super::{Robot, frames, messages};
use crate::NodeConfig;
use lsdc_rng::Rng;

#[test]
fn damaged_messages_are_counted_and_the_node_lives_on() {
    let intact = messages("drive.mcap");
    let (_, frames) = frames("drive.mcap", None);
    for copy in 0..8 {
        let mut rng = Rng::stream(copy, &["node"]);
        let mut robot = Robot::new(NodeConfig::new(frames.topics().clone()));
        let damaged = intact.iter().map(|message| Sent {
            data: damaged(&message.data, 0.4, &mut rng),
            ..message.clone()
        });
        robot.play(&damaged.collect::<Vec<_>>());
        let status = robot.node.status();
        assert_eq!((status.images, status.waiting()), (6, 0), "{status:?}");
        // Afterwards all is as it was. The clock was set back, and frames may have been placed wrongly until then.
        robot.play(&intact);
        let status = robot.node.status();
        assert_eq!((status.images, status.waiting()), (12, 0), "{status:?}");
    }
}

/// A transform of NaN, a cloud with more points than bytes, an image of the largest size.
#[test]
fn hostile_messages_are_refused() {
    let intact = messages("drive.mcap");
    let (_, frames) = frames("drive.mcap", None);
    let mut robot = Robot::new(NodeConfig::new(frames.topics().clone()));
    let mut hostile = intact.clone();
    for message in &mut hostile {
        let length = message.data.len();
        if message.topic == "/tf" {
            // The rotation lies at the end.
            message.data[length - 32..].copy_from_slice(&f64::NAN.to_le_bytes().repeat(4));
        } else if message.topic == frames.topics().points.0 {
            // The size lies behind the header: 4 bytes, the stamp, the name of the frame.
            let at = (4 + 8 + 4 + frames_length(&message.data)).next_multiple_of(4);
            message.data[at..at + 8].fill(0xff);
        }
    }
    robot.play(&hostile);
    let status = robot.node.status();
    assert_eq!((status.completed, status.waiting()), (0, 0), "{status:?}");
    assert!(status.inputs.unusable_transforms > 0);
}

/// Bytes of the name of the frame, with its zero.
fn frames_length(message: &[u8]) -> usize {
    message[12..16]
        .iter()
        .rev()
        .fold(0, |sum, &byte| 256 * sum + usize::from(byte))
}
