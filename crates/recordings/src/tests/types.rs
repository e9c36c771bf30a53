//! A message of every type and encoding, compared with NumPy and OpenCV.

use super::{expected, golden, numbers};
use crate::message::{Header, MessageType, PointCloud, camera_of, colours, depths};
use crate::{FrameOptions, Frames, Recording, Topic};
use lsdc_files::Unit;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The messages of a recording by topic, each with its type.
fn messages(name: &str) -> BTreeMap<String, (Arc<Topic>, Vec<u8>)> {
    let mut found = BTreeMap::new();
    let mut recording = Recording::open(&golden(name)).unwrap();
    let defects = recording.visit(&|_| true, &mut |topic, message| {
        found.insert(topic.name.clone(), (topic.clone(), message.data.to_vec()));
        Ok(())
    });
    assert_eq!(defects.unwrap(), crate::Defects::default());
    found
}

/// The containers of the messages.
const CONTAINERS: [&str; 3] = ["zstd.mcap", "alone.mcap", "bag"];

#[test]
fn every_container_holds_the_same() {
    let [first, others @ ..] = CONTAINERS.map(messages);
    assert_eq!(first.len(), 37);
    for other in others {
        for (name, (topic, data)) in &first {
            let (same_topic, same) = &other[name];
            assert_eq!((&topic.kind, data), (&same_topic.kind, same), "{name}");
        }
        assert_eq!(first.len(), other.len());
    }
}

#[test]
fn colours_are_those_of_opencv() {
    let messages = messages("zstd.mcap");
    for (name, values) in expected()["colours"].as_object().unwrap() {
        let (topic, data) = &messages[name];
        let (header, image, _) = colours(MessageType::of(&topic.kind).unwrap(), data).unwrap();
        assert_eq!(
            (header.frame.as_str(), image.dimensions()),
            ("eye", (14, 10)),
            "{name}"
        );
        // JPEG decoders upsample chroma differently, and means of four are rounded differently.
        let near = if name.contains("jpeg") {
            6.0
        } else {
            f64::from(u8::from(name.contains("bayer")))
        };
        for (i, (&found, value)) in image.as_raw().iter().zip(numbers(values)).enumerate() {
            let (x, y) = (i / 3 % 14, i / 42);
            // OpenCV copies the neighbouring colours at the border of a mosaic.
            let inside = (1..13).contains(&x) && (1..9).contains(&y);
            let compared = inside || !name.contains("bayer");
            let deviation = (f64::from(found) - value).abs();
            assert!(
                !compared || deviation <= near,
                "{name} at {x}, {y}: {found} {value}"
            );
        }
    }
}

#[test]
fn depths_are_those_of_numpy() {
    let messages = messages("zstd.mcap");
    let topics = expected();
    let topics = topics["depths"].as_object().unwrap();
    assert_eq!(topics.len(), 7);
    for (name, values) in topics {
        let (topic, data) = &messages[name];
        let found = depths(MessageType::of(&topic.kind).unwrap(), data, None).unwrap();
        assert_eq!((found.depth.width(), found.depth.height()), (14, 10));
        for (found, value) in found.depth.values().iter().zip(numbers(values)) {
            assert!(
                (f64::from(*found) - value).abs() < 1e-5,
                "{name}: {found} {value}"
            );
        }
    }
}

#[test]
fn points_of_any_layout_are_read() {
    let messages = messages("zstd.mcap");
    let topics = expected();
    let topics = topics["clouds"].as_object().unwrap();
    assert_eq!(topics.len(), 4);
    for (name, positions) in topics {
        let data = &messages[name].1;
        assert_eq!(Header::of(data).unwrap().frame, "eye");
        let found: Vec<_> = PointCloud::of(data).unwrap().iter().collect();
        let positions = positions.as_array().unwrap();
        assert_eq!(found.len(), positions.len());
        for (found, position) in found.iter().zip(positions) {
            if position.is_null() {
                assert!(found.iter().all(|v| v.is_nan()));
            } else {
                assert_eq!(found[..], numbers(position)[..], "{name}");
            }
        }
    }
}

#[test]
fn cameras_project_as_opencv() {
    let messages = messages("zstd.mcap");
    let topics = expected();
    let topics = topics["cameras"].as_object().unwrap();
    assert_eq!(topics.len(), 4);
    for (name, found) in topics {
        let described = camera_of(&messages[name].1, false).unwrap();
        assert_eq!(described.header.frame, "eye");
        let camera = described.camera;
        let position: [f64; 3] = numbers(&found[0]).try_into().unwrap();
        let (pixel, depth) = camera.project(position).unwrap();
        let expected = numbers(&found[1]);
        let deviation = (pixel[0] - expected[0]).hypot(pixel[1] - expected[1]);
        assert!(
            deviation < 1e-9 && depth == 2.0,
            "{name}: {pixel:?} {expected:?}"
        );
        // Rectified images have no distortion.
        let camera = camera_of(&messages[name].1, true).unwrap().camera;
        let (pixel, _) = camera.project(position).unwrap();
        assert_eq!(pixel, [12.0 * 0.2 + 6.4, 12.5 * -0.15 + 4.7]);
    }
}

fn frames(image: &str, points: &str) -> (Recording, Frames) {
    let mut recording = Recording::open(&golden("zstd.mcap")).unwrap();
    let options = FrameOptions {
        image: Some(image.to_owned()),
        points: Some(points.to_owned()),
        camera_info: Some("/cameras/straight/camera_info".to_owned()),
        ..FrameOptions::default()
    };
    let frames = Frames::of(&mut recording, &options).unwrap();
    assert_eq!((frames.found.len(), frames.dropped.len()), (1, 0));
    (recording, frames)
}

/// A depth camera registered to the image gives a map.
#[test]
fn depths_of_the_same_frame_are_a_map() {
    for (points, unit) in [
        ("/depth/metres", Unit::METRE),
        ("/depth/compressed_16UC1", Unit::MILLIMETRE),
        ("/depth/rvl_16UC1", Unit::MILLIMETRE),
        ("/depth/rvl_32FC1", Unit::METRE),
    ] {
        let (mut recording, frames) = frames("/image/rgb8", points);
        let loaded = frames
            .read(&mut recording, &frames.found[0])
            .unwrap()
            .decode(&frames)
            .unwrap();
        let expected = numbers(&expected()["depths"][points]);
        assert_eq!(loaded.points.unit, unit);
        assert_eq!(
            loaded.points.points.len(),
            expected.iter().filter(|depth| **depth > 0.0).count()
        );
        for point in &loaded.points.points {
            let depth = expected[point.v as usize * 14 + point.u as usize];
            assert!((f64::from(point.depth) - depth).abs() < 1e-5);
        }
    }
}

/// A depth camera beside the image camera gives points.
#[test]
fn depths_of_another_frame_are_points() {
    let (mut recording, frames) = frames("/image/jpeg", "/other/depth");
    let loaded = frames
        .read(&mut recording, &frames.found[0])
        .unwrap()
        .decode(&frames)
        .unwrap();
    let expected = expected();
    let expected: Vec<Vec<f64>> = expected["beside"]
        .as_array()
        .unwrap()
        .iter()
        .map(numbers)
        .collect();
    let found = &loaded.points;
    assert_eq!(found.points.len() + found.hidden, expected.len());
    assert!(found.points.len() > 100, "{}", found.points.len());
    for point in &found.points {
        let same =
            |position: &&Vec<f64>| (position[0] - point.u).hypot(position[1] - point.v) < 1e-5;
        let position = expected.iter().find(same).unwrap();
        assert!((position[2] - f64::from(point.depth)).abs() < 1e-5);
    }
}
