//! Damaged messages: an error or a result, never a panic.

use super::golden;
use crate::Recording;
use crate::message::{Header, Kind, Points, camera_of, colours, depths, transforms};
use lsdc_rng::Rng;

/// Reads a message as what it says to be, and what it could be taken for.
fn read(kind: Kind, data: &[u8]) -> bool {
    let _ = Header::of(data);
    match kind {
        Kind::Image | Kind::CompressedImage => {
            let colours = colours(kind, data).is_ok();
            let depths = depths(kind, data, |_| 0.001).is_ok();
            colours || depths
        }
        Kind::CameraInfo => camera_of(data, false).is_ok() && camera_of(data, true).is_ok(),
        Kind::PointCloud2 => Points::of(data).is_ok_and(|points| points.iter().count() > 0),
        Kind::Transforms => transforms(data).is_ok(),
    }
}

#[test]
fn damaged_messages_do_no_harm() {
    let mut sound: Vec<(Kind, Vec<u8>)> = Vec::new();
    for name in ["zstd.mcap", "drive.mcap"] {
        let visited = Recording::open(&golden(name)).unwrap().visit(&|_| true, &mut |topic, message| {
            sound.extend(Kind::of(&topic.kind).map(|kind| (kind, message.data.to_vec())));
            Ok(())
        });
        visited.unwrap();
    }
    let mut refused = 0;
    for (number, (kind, data)) in sound.iter().enumerate() {
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
