//! Damaged messages: an error or a result, never a panic.

use super::golden;
use crate::Recording;
use crate::fuzzing::read;
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
            let mut copy = data.clone();
            if rng.chance(0.3) {
                copy.truncate(rng.below(data.len() as u32) as usize);
            } else {
                // What says how long something is lies at the front.
                let at = rng.below(data.len().min(160) as u32) as usize;
                let end = (at + 1 + rng.below(8) as usize).min(data.len());
                let value = [0xff, 0x7f, 0, 1][rng.below(4) as usize];
                copy[at..end].fill(value);
            }
            refused += u32::from(!read(*kind, &copy));
        }
    }
    assert!(refused > 1000, "{refused}");
}
