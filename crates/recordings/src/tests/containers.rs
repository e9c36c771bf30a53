//! Complete, truncated, and written recordings.

use super::golden;
use crate::container::MessageLocation;
use crate::message::{Header, MessageType};
use crate::{FrameOptions, Frames, MessageTimes, Recording, Survey, Writer, write_cloud};
use std::path::Path;

const CONTAINERS: [&str; 4] = ["zstd.mcap", "alone.mcap", "drive.mcap", "bag"];

fn survey(path: &Path) -> Survey {
    Survey::of(&mut Recording::open(path).unwrap()).unwrap()
}

fn count(survey: &Survey) -> u64 {
    survey.topics.iter().map(|counted| counted.count).sum()
}

#[test]
fn any_message_can_be_read_again() {
    for name in CONTAINERS {
        let mut recording = Recording::open(&golden(name)).unwrap();
        let mut found: Vec<(MessageLocation, Vec<u8>)> = Vec::new();
        let all = recording.visit(&|_| true, &mut |_, message| {
            found.push((message.location, message.data.to_vec()));
            Ok(())
        });
        all.unwrap();
        assert!(found.is_sorted_by_key(|(location, _)| *location), "{name}");
        for (location, data) in found.iter().rev() {
            assert_eq!(&recording.read(*location).unwrap(), data, "{name}");
        }
    }
}

#[test]
fn chunks_without_what_is_wanted_are_passed_over() {
    let mut recording = Recording::open(&golden("drive.mcap")).unwrap();
    let topics: Vec<String> = recording
        .topics()
        .iter()
        .map(|topic| topic.name.clone())
        .collect();
    assert_eq!(topics.len(), 5);
    for name in &topics {
        let mut count = 0;
        let wanted = recording.visit(&|topic| topic.name == *name, &mut |topic, _| {
            assert_eq!(topic.name, *name);
            count += 1;
            Ok(())
        });
        wanted.unwrap();
        let all = survey(&golden("drive.mcap"));
        let counted = all
            .topics
            .iter()
            .find(|counted| counted.topic.name == *name);
        assert_eq!(counted.map(|counted| counted.count), Some(count), "{name}");
    }
}

/// The expected rates are those of the script.
#[test]
fn messages_are_counted() {
    let survey = survey(&golden("drive.mcap"));
    let of = |name: &str| {
        survey
            .topics
            .iter()
            .find(|counted| counted.topic.name == name)
            .unwrap()
    };
    assert_eq!(of("/tf").count, 12);
    assert!((of("/tf").rate().unwrap() - 20.0).abs() < 1e-6);
    assert!((of("/camera/camera_info").rate().unwrap() - 10.0).abs() < 1e-6);
    assert_eq!((of("/tf_static").count, of("/tf_static").rate()), (1, None));
    assert_eq!(of("/lidar/points").bytes, 5 * of("/lidar/points").bytes / 5);
    let (first, last) = survey.times().unwrap();
    assert_eq!(last - first, 604_000_000);
}

/// A truncated recording is read up to its end.
#[test]
fn a_recording_that_is_cut_off_is_read_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    for (name, file) in [
        ("zstd.mcap", "zstd.mcap"),
        ("alone.mcap", "alone.mcap"),
        ("bag", "bag/bag.db3"),
    ] {
        let bytes = std::fs::read(golden(file)).unwrap();
        let whole = survey(&golden(name));
        let path = folder.path().join(Path::new(file).file_name().unwrap());
        let mut counts = Vec::new();
        for tenths in 4..10 {
            std::fs::write(&path, &bytes[..bytes.len() * tenths / 10]).unwrap();
            let found = survey(&path);
            assert!(found.defects.truncated.is_some(), "{name} {tenths}");
            counts.push(count(&found));
        }
        assert!(counts.is_sorted(), "{name}: {counts:?}");
        // In a bag, the tables are stored after the definitions of the types.
        let last = counts[counts.len() - 1];
        assert!(
            counts.iter().any(|count| (1..last).contains(count)),
            "{name}: {counts:?}"
        );
        assert!(last <= count(&whole), "{name}: {counts:?}");
    }
    let path = folder.path().join("drive.mcap");
    let bytes = std::fs::read(golden("drive.mcap")).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() * 8 / 10]).unwrap();
    let mut recording = Recording::open(&path).unwrap();
    let frames = Frames::of(&mut recording, &FrameOptions::default()).unwrap();
    assert!(
        frames.remarks[0].contains("cut off"),
        "{:?}",
        frames.remarks
    );
    assert!(!frames.found.is_empty());
}

#[test]
fn what_is_written_appears_when_it_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.mcap");
    let message = write_cloud(&Header::default(), &[]);
    let times = MessageTimes { log: 7, publish: 5 };
    let mut writer = Writer::create(&path).unwrap();
    writer
        .write("/points", MessageType::PointCloud2, times, &message)
        .unwrap();
    drop(writer);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let mut source = Recording::open(&golden("bag")).unwrap();
    let mut writer = Writer::create(&path).unwrap();
    let mut copied = Vec::new();
    let visited = source.visit(&|_| true, &mut |topic, message| {
        copied.push((topic.name.clone(), message.times.log, message.data.to_vec()));
        writer.copy(topic, message)
    });
    visited.unwrap();
    writer
        .write("/points", MessageType::PointCloud2, times, &message)
        .unwrap();
    copied.push(("/points".to_owned(), 7, message));
    assert!(!path.exists());
    writer.finish().unwrap();
    let mut found = Vec::new();
    let visited = Recording::open(&path)
        .unwrap()
        .visit(&|_| true, &mut |topic, message| {
            assert!(
                topic
                    .definition
                    .as_ref()
                    .is_some_and(|(_, text)| !text.is_empty()),
                "{}",
                topic.name
            );
            found.push((topic.name.clone(), message.times.log, message.data.to_vec()));
            Ok(())
        });
    assert_eq!(visited.unwrap(), crate::Defects::default());
    assert!(found == copied);
}

#[test]
fn what_is_no_recording_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("empty.mcap"), b"").unwrap();
    std::fs::write(at("text.mcap"), b"time,x,y\n0,1,2\n").unwrap();
    std::fs::write(at("short.db3"), b"SQLite format 3\0").unwrap();
    for name in ["empty.mcap", "text.mcap", "short.db3", "missing.mcap", ""] {
        assert!(Recording::open(&at(name)).is_err(), "{name}");
    }
    assert!(Recording::is_at(&at("missing.mcap")) && Recording::is_at(&golden("bag")));
    std::fs::create_dir(at("images")).unwrap();
    assert!(!Recording::is_at(&at("images")) && !Recording::is_at(&at("a.png")));
}
