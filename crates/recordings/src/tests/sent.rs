//! Messages of a recording, sent one by one or damaged. The tests of `lsdc-node` include this file.

use lsdc_recordings::{FrameOptions, Frames, Recording};
use lsdc_rng::Rng;
use std::path::{Path, PathBuf};

/// A recording of `scripts/recordings.py`.
pub(super) fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden/recordings")
        .join(name)
}

/// A message that is sent.
#[derive(Clone)]
pub(super) struct Sent {
    pub(super) topic: String,
    /// Time of recording in nanoseconds.
    pub(super) log: u64,
    pub(super) data: Vec<u8>,
}

pub(super) fn messages(path: &Path) -> Vec<Sent> {
    let mut found = Vec::new();
    let mut recording = Recording::open(path).unwrap();
    let visited = recording.visit(&|_| true, &mut |topic, message| {
        found.push(Sent {
            topic: topic.name.clone(),
            log: message.times.log,
            data: message.data.to_vec(),
        });
        Ok(())
    });
    visited.unwrap();
    found
}

pub(super) fn frames(path: &Path, options: &FrameOptions) -> (Recording, Frames) {
    let mut recording = Recording::open(path).unwrap();
    let frames = Frames::of(&mut recording, options).unwrap();
    (recording, frames)
}

/// The same messages with earlier stamps. Messages of transforms contain one each.
pub(super) fn earlier(messages: &[Sent], seconds: i32) -> Vec<Sent> {
    let shifted = |message: &Sent| {
        let mut message = message.clone();
        // After the CDR header, and the number of transforms.
        let at = if message.topic.starts_with("/tf") {
            8
        } else {
            4
        };
        let (stamp, _) = message.data[at..].split_first_chunk_mut().unwrap();
        *stamp = (i32::from_le_bytes(*stamp) - seconds).to_le_bytes();
        message
    };
    messages.iter().map(shifted).collect()
}

/// Damages a message: truncates it with a probability, or else replaces some of the first bytes, which contain lengths.
pub(super) fn damaged(data: &[u8], cut_short: f32, rng: &mut Rng) -> Vec<u8> {
    let mut data = data.to_vec();
    if rng.chance(cut_short) {
        data.truncate(rng.below(data.len() as u32) as usize);
    } else {
        let at = rng.below(data.len().min(160) as u32) as usize;
        let end = (at + 1 + rng.below(8) as usize).min(data.len());
        data[at..end].fill([0xff, 0x7f, 0, 1][rng.below(4) as usize]);
    }
    data
}
