//! Points of earlier images.

use super::sent::Sent;
use super::{Robot, frames, messages, scene};
use crate::NodeConfig;
use lsdc_core::{PosedView, ViewSettings, neighbours};
use lsdc_recordings::{Header, write_depth};
use std::time::Duration;

const SETTINGS: ViewSettings = ViewSettings {
    count: 3,
    only_past: true,
    max_points: 2000,
};

fn config() -> NodeConfig {
    let (_, frames) = frames("drive.mcap", None);
    NodeConfig {
        views: Some(SETTINGS),
        ..NodeConfig::new(frames.topics().clone())
    }
}

/// The depths of the recording by the public functions for views, and how many points were carried.
fn depths_of_file() -> (Vec<Vec<u8>>, usize) {
    let (mut recording, frames) = frames("drive.mcap", None);
    let route = frames.camera_route().unwrap();
    let (mut views, mut depths, mut carried) = (Vec::new(), Vec::new(), 0);
    for frame in &frames.found {
        let stored = frames.read(&mut recording, frame).unwrap();
        let found = stored.decode(&frames).unwrap();
        let pose = frames.camera_pose(&route, frame).unwrap();
        let scene = scene(&found);
        let camera = found.camera.unwrap();
        let camera = camera.moved(pose.matrix(), pose.translation());
        let (width, height) = found.points.size;
        let own = PosedView::new(camera, width, height, found.points.points).unwrap();
        views.push(own.clone());
        let others = neighbours(&views, views.len() - 1, &SETTINGS);
        let others: Vec<&PosedView> = others.into_iter().map(|other| &views[other]).collect();
        let completed = scene.complete_with_views(&own, &others, &SETTINGS);
        let (completion, report) = completed.unwrap();
        carried += report.carried();
        let depth = completion.depth().unwrap();
        depths.push(write_depth(&found.header, &depth, false).0);
    }
    (depths, carried)
}

#[test]
fn points_of_earlier_images_join_as_in_the_recording() {
    let mut robot = Robot::new(config());
    robot.play(&messages("drive.mcap"));
    let (expected, carried) = depths_of_file();
    assert!(carried > 0);
    assert!(robot.published("/lsdc/depth/image") == expected);
    assert_eq!(robot.node.status().alone, 0);
    // They make a difference.
    assert!(expected != super::depths_of_file("drive.mcap", None));
}

/// A car that is said to stand still by a static transform, as without odometry.
#[test]
fn without_a_known_place_images_are_completed_alone() {
    let all = messages("drive.mcap");
    let moving = all.iter().find(|message| message.topic == "/tf").unwrap();
    let placed = Sent {
        topic: "/tf_static".to_owned(),
        log: all[0].log,
        ..moving.clone()
    };
    let still = all.iter().filter(|message| message.topic != "/tf").cloned();
    let still: Vec<_> = std::iter::once(placed).chain(still).collect();
    let mut robot = Robot::new(config());
    robot.play(&still);
    let status = robot.node.status();
    assert!(status.completed > 0, "{status:?}");
    assert_eq!(status.alone, status.completed);
    assert!(
        status
            .remarks
            .iter()
            .any(|remark| remark.contains("no transforms that move"))
    );
    robot.clock.advance(Duration::from_secs(1));
    robot.node.turn();
    let has =
        |message: &[u8], text: &str| message.windows(text.len()).any(|w| w == text.as_bytes());
    let found = robot.published("/diagnostics");
    assert!(
        found
            .iter()
            .any(|message| has(message, "images without points of earlier ones"))
    );
}

/// A camera that is given, in metres beside points in centimetres: it is published, and no topic or transform is needed.
#[test]
fn a_given_camera_and_unit_replace_topic_and_transforms() {
    let (mut recording, frames) = frames("drive.mcap", None);
    let first = &frames.found[0];
    let stored = frames.read(&mut recording, first).unwrap();
    let camera = stored.decode(&frames).unwrap().camera.unwrap();
    // The axes of the camera look along x of the scanner, and z is up there.
    let ahead = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]];
    let usual = NodeConfig::new(frames.topics().clone());
    let mut config = usual.clone();
    config.frames.camera = Some(camera.with_pose(ahead, [0.0; 3]));
    config.frames.unit = Some("cm".parse().unwrap());
    let mut robot = Robot::new(config);
    let subscribed: Vec<_> = robot
        .bus
        .subscriptions()
        .map(|found| found.topic.clone())
        .collect();
    assert!(!subscribed.contains(usual.topics.camera_info.as_ref().unwrap()));
    let all = messages("drive.mcap");
    let some: Vec<_> = all
        .into_iter()
        .filter(|m| !m.topic.starts_with("/tf"))
        .collect();
    robot.play(&some);
    let status = robot.node.status();
    assert!(status.completed > 0, "{status:?}");
    let outputs: Vec<_> = robot.outputs.try_iter().collect();
    let of = |topic: &str| {
        let found = outputs.iter().filter(|published| published.topic == topic);
        found
            .map(|published| &published.message)
            .collect::<Vec<_>>()
    };
    let (depths, cameras) = (of("/lsdc/depth/image"), of("/lsdc/depth/camera_info"));
    assert_eq!(
        (depths.len() as u64, cameras.len()),
        (status.completed, depths.len())
    );
    for (depth, camera) in depths.iter().zip(cameras) {
        assert_eq!(Header::of(depth).unwrap(), Header::of(camera).unwrap());
        // The wall is 16 m ahead of the start: 0.16 m if that is centimetres.
        let pixels = depth[depth.len() - 4 * 96 * 72..].as_chunks::<4>().0;
        let depths = pixels.iter().map(|bytes| f32::from_le_bytes(*bytes));
        assert!({ depths }.all(|depth| (0.08..0.2).contains(&depth)));
    }
}
