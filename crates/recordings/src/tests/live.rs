//! Recordings sent message by message, as by a running robot.

use super::sent::{self, Sent, damaged, earlier, golden};
use crate::message::{MessageType, camera_of};
use crate::{
    DropReason, FrameOptions, FrameTopics, Frames, Header, LiveFrame, LiveFrames, Receipt,
    Recording, Writer,
};
use lsdc_rng::Rng;
use std::path::Path;
use std::time::Duration;

/// How long images wait.
const PATIENCE: Duration = Duration::from_millis(300);

fn messages(name: &str) -> Vec<Sent> {
    sent::messages(&golden(name))
}

fn frames(name: &str, options: &FrameOptions) -> (Recording, Frames) {
    sent::frames(&golden(name), options)
}

type Outcome = Result<LiveFrame, crate::DroppedFrame>;

/// Returns the outcome of every image. The messages are received at the times at which they were recorded.
fn outcomes_of(live: &mut LiveFrames, messages: &[Sent], start: Duration) -> Vec<Outcome> {
    let mut found = Vec::new();
    let first = messages[0].log;
    let mut now = start;
    for message in messages {
        now = start + Duration::from_nanos(message.log - first);
        let receipt = Receipt {
            at: now,
            stamp: message.log as i64,
        };
        live.add(&message.topic, message.data.clone(), receipt);
        found.extend(std::iter::from_fn(|| live.next(now)));
    }
    while let Some(deadline) = live.deadline() {
        assert!(deadline > now);
        found.extend(std::iter::from_fn(|| live.next(deadline)));
    }
    found
}

fn live(topics: &FrameTopics, options: &FrameOptions) -> LiveFrames {
    LiveFrames::new(topics.clone(), options, PATIENCE)
}

/// Checks that points, images and counts equal those of the recording, bit for bit.
fn assert_same(name: &str, options: &FrameOptions) -> usize {
    assert_same_in(&golden(name), options)
}

fn assert_same_in(path: &Path, options: &FrameOptions) -> usize {
    let name = path.display();
    let (mut recording, frames) = sent::frames(path, options);
    let mut live = live(frames.topics(), options);
    let outcomes = outcomes_of(&mut live, &sent::messages(path), Duration::ZERO);
    let dropped: Vec<_> = outcomes.iter().filter_map(|o| o.as_ref().err()).collect();
    let kinds = |dropped: &[&crate::DroppedFrame]| {
        let kinds = dropped.iter().map(|d| (d.stamp, d.reason.kind()));
        kinds.collect::<Vec<_>>()
    };
    let wanted: Vec<_> = frames.dropped.iter().collect();
    assert_eq!(kinds(&dropped), kinds(&wanted), "{name}");
    let found: Vec<_> = outcomes.iter().filter_map(|o| o.as_ref().ok()).collect();
    assert_eq!(found.len(), frames.found.len(), "{name}");
    for (frame, wanted) in found.iter().zip(&frames.found) {
        assert_eq!(frame.header().stamp, wanted.stamp);
        let (frame, wanted) = (
            frame.decode(),
            frames.read(&mut recording, wanted).unwrap().decode(&frames),
        );
        let (Ok(frame), Ok(wanted)) = (&frame, &wanted) else {
            assert_eq!(frame.is_err(), wanted.is_err());
            continue;
        };
        assert!(frame.image == wanted.image);
        assert_eq!(frame.points.points, wanted.points.points);
        assert_eq!(frame.points.remarks, wanted.points.remarks);
        assert_eq!(
            (frame.unplaced, frame.skewed, &frame.header, &frame.camera),
            (
                wanted.unplaced,
                wanted.skewed,
                &wanted.header,
                &wanted.camera
            )
        );
    }
    found.len()
}

#[test]
fn frames_are_those_of_the_recording() {
    assert_eq!(assert_same("drive.mcap", &FrameOptions::default()), 4);
    let wide = FrameOptions {
        tolerance: Duration::from_millis(100),
        ..FrameOptions::default()
    };
    assert_eq!(assert_same("drive.mcap", &wide), 5);
    for driver in ["ouster", "velodyne", "hesai", "livox"] {
        for deskew in [true, false] {
            let options = FrameOptions {
                points: Some(format!("/{driver}/points")),
                deskew,
                ..FrameOptions::default()
            };
            assert!(assert_same("turn.mcap", &options) > 0);
        }
    }
}

/// The focal length changes in the middle: each image gets its own, as in the recording.
#[test]
fn a_calibration_that_changes_is_that_of_each_image() {
    let options = FrameOptions::default();
    let (mut recording, frames) = frames("drive.mcap", &options);
    let (_, topics) = (&mut recording, frames.topics());
    let info = topics.camera_info.clone().unwrap();
    let [.., middle] = [0, 1].map(|at| frames.found[at].stamp);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("changed.mcap");
    let mut writer = Writer::create(&path).unwrap();
    let mut changed = 0;
    let visited = recording.visit(&|_| true, &mut |topic, message| {
        let mut data = message.data.to_vec();
        let stamp = if topic.name == info {
            Header::of(&data)?.stamp
        } else {
            i64::MIN
        };
        if stamp >= middle {
            let camera = camera_of(&data, false)?.camera;
            let focal = camera.intrinsics()[0];
            let at = data
                .windows(8)
                .position(|bytes| bytes == focal.to_le_bytes());
            let (number, _) = data[at.unwrap()..].split_first_chunk_mut().unwrap();
            *number = (1.25 * focal).to_le_bytes();
            changed += 1;
        }
        let kind = MessageType::of(&topic.kind).unwrap();
        writer.write(&topic.name, kind, message.times, &data)
    });
    visited.unwrap();
    writer.finish().unwrap();
    assert!(changed > 0);
    assert_eq!(assert_same_in(&path, &options), frames.found.len());
}

/// A recording that is played twice: the clock is set back, and the same frames follow.
#[test]
fn a_recording_that_starts_again_gives_the_same_frames() {
    let options = FrameOptions::default();
    let (_, frames) = frames("drive.mcap", &options);
    let messages = messages("drive.mcap");
    let mut live = live(frames.topics(), &options);
    let first = outcomes_of(&mut live, &messages, Duration::ZERO);
    assert_eq!(live.counts().set_back, 0);
    // Static transforms are sent once.
    let rest: Vec<_> = messages
        .iter()
        .filter(|message| !message.topic.ends_with("static"))
        .cloned()
        .collect();
    let second = outcomes_of(&mut live, &earlier(&rest, 1000), Duration::from_secs(100));
    assert!(live.counts().set_back > 0);
    let points = |outcomes: &[Outcome]| {
        let found = outcomes.iter().filter_map(|o| o.as_ref().ok());
        let points = found.map(|frame| frame.decode().unwrap().points.points);
        points.collect::<Vec<_>>()
    };
    assert_eq!(points(&first).len(), 4);
    // The first messages count as out of order until the clock is known to be set back.
    let (first, second) = (points(&first), points(&second));
    assert!(second.len() >= 3 && second.iter().all(|frame| first.contains(frame)));
}

/// Without transforms images wait, are dropped for that reason, and are completed once transforms arrive.
#[test]
fn what_is_lacking_is_named_until_it_comes() {
    let options = FrameOptions::default();
    let (_, frames) = frames("drive.mcap", &options);
    let all = messages("drive.mcap");
    let is_static = |message: &&Sent| message.topic.ends_with("static");
    let without: Vec<_> = all.iter().filter(|m| !is_static(m)).cloned().collect();
    let mut live = live(frames.topics(), &options);
    let outcomes = outcomes_of(&mut live, &without, Duration::ZERO);
    let not_ready = |outcome: &&Outcome| matches!(outcome, Err(dropped) if matches!(dropped.reason, DropReason::NotReady(_)));
    assert_eq!(outcomes.iter().filter(not_ready).count(), 5);
    assert!(live.lacking().unwrap().contains("no transforms lead"));
    // The transforms arrive, and the clock restarts.
    let outcomes = outcomes_of(&mut live, &all, Duration::from_secs(100));
    assert!(outcomes.iter().any(Result::is_ok));
    assert_eq!(live.lacking(), None);
}

/// If images arrive faster than they are taken, the oldest are dropped; each is accounted for.
#[test]
fn memory_is_bounded_and_every_image_accounted_for() {
    let options = FrameOptions::default();
    let (_, frames) = frames("drive.mcap", &options);
    let all = messages("drive.mcap");
    let mut live = live(frames.topics(), &options);
    let (image, points) = (&frames.topics().image.0, &frames.topics().points.0);
    let of = |topic: &String| all.iter().find(|m| m.topic == *topic).unwrap();
    let mut outcomes = Vec::new();
    for step in 0..100_u64 {
        for message in [of(image), of(points)] {
            let mut data = message.data.clone();
            // The seconds of the stamp, after the four-byte header.
            data[4..8].copy_from_slice(&(step as u32).to_le_bytes());
            let receipt = Receipt {
                at: Duration::from_micros(step),
                stamp: 0,
            };
            live.add(&message.topic, data, receipt);
        }
        assert!(live.waiting() <= 16);
    }
    outcomes.extend(std::iter::from_fn(|| live.next(Duration::from_micros(100))));
    assert_eq!((outcomes.len(), live.waiting()), (84, 16));
    let superseded =
        |outcome: &&Outcome| matches!(outcome, Err(d) if d.reason == DropReason::Superseded);
    assert_eq!(outcomes.iter().filter(superseded).count(), 84);
    outcomes.extend(std::iter::from_fn(|| live.next(Duration::from_secs(9))));
    assert_eq!((outcomes.len(), live.counts().images), (100, 100));
}

/// Damaged copies between intact messages are counted, and the intact frames are still completed.
#[test]
fn damaged_messages_do_no_harm() {
    let options = FrameOptions {
        points: Some("/ouster/points".to_owned()),
        ..FrameOptions::default()
    };
    let (_, frames) = frames("turn.mcap", &options);
    let intact = messages("turn.mcap");
    let mut completed = 0;
    for copy in 0..60 {
        let mut rng = Rng::stream(copy, &["live"]);
        let mut mixed = Vec::new();
        for message in &intact {
            mixed.push(message.clone());
            // Poses may be wrong, but no image is returned twice.
            if rng.chance(0.5) {
                mixed.push(Sent {
                    data: damaged(&message.data, 0.3, &mut rng),
                    ..message.clone()
                });
            }
        }
        let images = mixed.iter().filter(|m| m.topic == frames.topics().image.0);
        let images = images.count();
        let mut live = live(frames.topics(), &options);
        let outcomes = outcomes_of(&mut live, &mixed, Duration::ZERO);
        assert_eq!(outcomes.len(), images);
        assert_eq!(live.counts().images, images as u64);
        let decoded = outcomes
            .iter()
            .filter_map(|o| o.as_ref().ok()?.decode().ok());
        completed += decoded.count();
    }
    assert!(completed > 40, "{completed}");
}

/// The camera of a frame is that of its image, with its stamp and frame.
#[test]
fn frames_have_the_camera_of_their_image() {
    let options = FrameOptions::default();
    let (_, frames) = frames("drive.mcap", &options);
    let mut live = live(frames.topics(), &options);
    let outcomes = outcomes_of(&mut live, &messages("drive.mcap"), Duration::ZERO);
    for frame in outcomes.iter().filter_map(|o| o.as_ref().ok()) {
        let message = frame.camera_info().unwrap();
        let camera = crate::message::camera_of(&message, false).unwrap();
        assert_eq!(camera.header, *frame.header());
        assert_eq!(Some(camera.camera), frame.decode().unwrap().camera);
        assert!(crate::fuzzing::read(MessageType::CameraInfo, &message));
    }
}
