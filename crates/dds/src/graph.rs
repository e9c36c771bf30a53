//! The node and its topics in the node graph of ROS 2: `rmw_dds_common/msg/ParticipantEntitiesInfo`, which every participant
//! publishes on `ros_discovery_info` and from which `ros2 node list` and `ros2 topic info --verbose` take names.

use crate::{qos::Qos, settings::Generation, wire::Guid};

pub(crate) const TOPIC: &str = "ros_discovery_info";
pub(crate) const TYPE: &str = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";
pub(crate) const QOS: Qos = Qos::LATCHED;

/// The graph message of a participant with one node.
pub(crate) fn message(
    generation: Generation,
    participant: Guid,
    (namespace, node): (&str, &str),
    readers: &[Guid],
    writers: &[Guid],
) -> Vec<u8> {
    let length = match generation {
        Generation::Humble => 24,
        Generation::Jazzy => 16,
    };
    let mut message = vec![0, 1, 0, 0];
    let guid = |message: &mut Vec<u8>, guid: Guid| {
        let end = message.len() + length;
        message.extend(guid.to_bytes());
        message.resize(end, 0);
    };
    let number = |message: &mut Vec<u8>, number: usize| {
        message.resize(message.len().next_multiple_of(4), 0);
        message.extend((number as u32).to_le_bytes());
    };
    guid(&mut message, participant);
    number(&mut message, 1);
    for text in [namespace, node] {
        number(&mut message, text.len() + 1);
        message.extend(text.as_bytes());
        message.push(0);
    }
    for guids in [readers, writers] {
        number(&mut message, guids.len());
        for &each in guids {
            guid(&mut message, each);
        }
    }
    message
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Laid out by hand after `Gid.msg` and `NodeEntitiesInfo.msg`.
    #[test]
    fn the_message_has_the_layout_of_each_generation() {
        let participant = Guid::new([1; 12], [0, 0, 1, 0xc1]);
        let writer = Guid::new([1; 12], [0, 0, 1, 3]);
        for (generation, padding) in [(Generation::Humble, 8), (Generation::Jazzy, 0)] {
            let mut expected = vec![0, 1, 0, 0];
            expected.extend(participant.to_bytes());
            expected.extend(vec![0; padding]);
            expected.extend([1, 0, 0, 0, 2, 0, 0, 0, b'/', 0, 0, 0, 5, 0, 0, 0]);
            expected.extend(b"lsdc\0\0\0\0");
            expected.extend([0, 0, 0, 0, 1, 0, 0, 0]);
            expected.extend(writer.to_bytes());
            expected.extend(vec![0; padding]);
            let written = message(generation, participant, ("/", "lsdc"), &[], &[writer]);
            assert_eq!(written, expected);
        }
    }
}
