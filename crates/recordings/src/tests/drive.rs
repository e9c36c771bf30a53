//! The frames of a car that passes a wall.

use super::{expected, golden, numbers};
use crate::{DropReason, FrameOptions, Frames, Recording};
use std::time::Duration;

fn frames(options: &FrameOptions) -> lsdc_files::error::Result<(Recording, Frames)> {
    let mut recording = Recording::open(&golden("drive.mcap"))?;
    let frames = Frames::of(&mut recording, options)?;
    Ok((recording, frames))
}

/// Covers static transforms, dynamic ones between the times of points and image, lens distortion, and points behind the
/// camera.
#[test]
fn points_are_where_opencv_projects_them() {
    let (mut recording, frames) = frames(&FrameOptions::default()).unwrap();
    let expected = expected();
    let wanted = expected["frames"].as_array().unwrap();
    assert_eq!(frames.found.len(), wanted.len());
    for (frame, wanted) in frames.found.iter().zip(wanted) {
        assert_eq!(Some(frame.stamp), wanted["stamp"].as_i64());
        let loaded = frames
            .read(&mut recording, frame)
            .unwrap()
            .decode(&frames)
            .unwrap();
        assert_eq!(loaded.image.dimensions(), (96, 72));
        let positions: Vec<Vec<f64>> = wanted["points"]
            .as_array()
            .unwrap()
            .iter()
            .map(numbers)
            .collect();
        let found = &loaded.points;
        // Points on the border may fall on either side of it.
        let all = found.points.len() + found.hidden;
        assert!(
            positions.len() > 100 && all.abs_diff(positions.len()) <= 2,
            "{all} {}",
            positions.len()
        );
        let mut deviation = 0.0_f64;
        for point in &found.points {
            let distance =
                |position: &&Vec<f64>| (position[0] - point.u).hypot(position[1] - point.v);
            let by_distance = |a: &&Vec<f64>, b: &&Vec<f64>| distance(a).total_cmp(&distance(b));
            let nearest = positions.iter().min_by(by_distance).unwrap();
            deviation = deviation
                .max(distance(&nearest))
                .max((nearest[2] - f64::from(point.depth)).abs());
        }
        assert!(deviation < 2e-3, "{deviation}");
    }
}

#[test]
fn every_image_is_found_or_dropped() {
    let (_, frames) = frames(&FrameOptions::default()).unwrap();
    let stamps: Vec<i64> = frames.dropped.iter().map(|dropped| dropped.stamp).collect();
    let wanted = numbers_of_dropped();
    assert_eq!(stamps, wanted);
    assert!(matches!(
        frames.dropped[0].reason,
        DropReason::NoTransform(_)
    ));
    assert_eq!(
        frames.dropped[1].reason,
        DropReason::NoPoints(Some(80_000_000))
    );
    assert_eq!(frames.remarks, Vec::<String>::new());
    let wide = FrameOptions {
        tolerance: Duration::from_millis(100),
        ..FrameOptions::default()
    };
    let (_, frames) = self::frames(&wide).unwrap();
    assert_eq!((frames.found.len(), frames.dropped.len()), (5, 1));
}

fn numbers_of_dropped() -> Vec<i64> {
    let expected = expected();
    let stamps = expected["dropped"].as_array().unwrap();
    stamps.iter().map(|stamp| stamp.as_i64().unwrap()).collect()
}

#[test]
fn what_is_not_there_is_named_with_what_is() {
    let topic = |name: &str| Some(name.to_owned());
    let refused = |options: FrameOptions, what: &str, hint: &str| {
        let error = frames(&options).err().unwrap();
        assert!(error.to_string().contains(what), "{error}");
        let advice = error.advice().unwrap();
        assert!(advice.contains(hint), "{advice}");
    };
    let usual = FrameOptions::default;
    let options = FrameOptions {
        image: topic("/camera/image_raw"),
        ..usual()
    };
    refused(
        options,
        "no topic `/camera/image_raw`",
        "/camera/image_raw/compressed",
    );
    let options = FrameOptions {
        points: topic("/tf"),
        ..usual()
    };
    refused(
        options,
        "is of type tf2_msgs/msg/TFMessage",
        "/lidar/points",
    );
    let options = FrameOptions {
        camera_info: topic("/lidar/points"),
        ..usual()
    };
    refused(options, "is of type", "/camera/camera_info");
    let options = FrameOptions {
        tf: vec!["/tf".to_owned()],
        ..usual()
    };
    refused(
        options,
        "no transforms lead from `lidar` to `camera`",
        "base_link",
    );
    let options = FrameOptions {
        fixed: topic("map"),
        ..usual()
    };
    refused(options, "not both in the frame `map`", "odom");
}

/// The car is at (8 t, 2 t², 0) in `odom` after t seconds and turned by 0.4 t + 0.3 t²; its camera is at (0.8, 0.1, 1.4) and looks
/// ahead.
#[test]
fn the_camera_is_where_the_car_drove() {
    let (mut recording, frames) = frames(&FrameOptions::default()).unwrap();
    let route = frames.camera_route().unwrap();
    assert_eq!(route.fixed(), "odom");
    for frame in &frames.found {
        let seconds = (frame.stamp - 1_700_000_000_000_000_000) as f64 * 1e-9;
        let (sin, cos) = (0.4 * seconds + 0.3 * seconds * seconds).sin_cos();
        let place = [
            8.0 * seconds + cos * 0.8 - sin * 0.1,
            2.0 * seconds * seconds + sin * 0.8 + cos * 0.1,
            1.4,
        ];
        let pose = frames.camera_pose(&route, frame).unwrap();
        // Two metres ahead, and one above.
        let point = [place[0] + 2.0 * cos, place[1] + 2.0 * sin, place[2] + 1.0];
        let seen = pose.apply(point);
        for (found, expected) in seen.into_iter().zip([0.0, -1.0, 2.0]) {
            assert!((found - expected).abs() < 1e-6, "{seen:?}");
        }
        // Decoding only the points gives the same points.
        let read = frames.read(&mut recording, frame).unwrap();
        let (whole, points) = (
            read.decode(&frames).unwrap(),
            read.decode_points(&frames).unwrap(),
        );
        assert_eq!(whole.points.points, points.points.points);
        assert_eq!(points.points.size, (96, 72));
    }
    let still = FrameOptions {
        fixed: Some("base_link".to_owned()),
        ..FrameOptions::default()
    };
    let (_, frames) = self::frames(&still).unwrap();
    let error = frames.camera_route().err().unwrap();
    assert!(
        error.to_string().contains("no transforms that move"),
        "{error}"
    );
}
