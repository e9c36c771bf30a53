//! What a node publishes of a drive.

use super::{Robot, depths_of_file, earlier, frames, messages};
use crate::{Level, NodeConfig, Qos};
use lsdc_files::CloudOptions;
use lsdc_recordings::Header;
use std::time::Duration;

fn config(name: &str, points: Option<&str>) -> NodeConfig {
    let (_, frames) = frames(name, points);
    NodeConfig::new(frames.topics().clone())
}

#[test]
fn depths_are_those_of_the_recording() {
    for (name, points) in [
        ("drive.mcap", None),
        ("turn.mcap", Some("/ouster/points")),
        ("turn.mcap", Some("/velodyne/points")),
        ("turn.mcap", Some("/hesai/points")),
    ] {
        let mut robot = Robot::new(config(name, points));
        robot.play(&messages(name));
        let status = robot.node.status();
        let expected = depths_of_file(name, points);
        assert!(!expected.is_empty());
        assert_eq!(status.completed, expected.len() as u64, "{status:?}");
        assert!(robot.published("/lsdc/depth/image") == expected, "{name}");
        assert_eq!((status.waiting(), status.unpublished), (0, 0));
    }
}

/// On two threads, where an image is sent when the depth of the one before has come.
#[test]
fn threads_change_no_bit() {
    let Robot {
        mut bus,
        outputs,
        clock,
        node,
    } = Robot::new(config("drive.mcap", None));
    let handle = node.handle();
    let expected = depths_of_file("drive.mcap", None);
    let thread = std::thread::spawn(|| node.run());
    // All but the images first: then each image is complete at once.
    let (images, others): (Vec<_>, Vec<_>) = messages("drive.mcap")
        .into_iter()
        .partition(|message| message.topic.contains("image_raw"));
    for message in &others {
        clock.set(message.log as i64);
        bus.send(&message.topic, &message.data);
    }
    let wanted: Vec<Header> = expected.iter().map(|m| Header::of(m).unwrap()).collect();
    let mut depths = Vec::new();
    for message in &images {
        let header = Header::of(&message.data).unwrap();
        if !wanted.contains(&header) {
            continue;
        }
        bus.send(&message.topic, &message.data);
        let depth = outputs
            .iter()
            .find(|found| found.topic == "/lsdc/depth/image");
        depths.push(depth.unwrap().message);
    }
    handle.stop();
    thread.join().unwrap().unwrap();
    assert!(depths == expected);
    assert_eq!(handle.status().completed, expected.len() as u64);
}

#[test]
fn every_image_is_completed_or_left_out_for_a_reason() {
    let (_, frames) = frames("drive.mcap", None);
    let mut robot = Robot::new(config("drive.mcap", None));
    robot.play(&messages("drive.mcap"));
    let status = robot.node.status();
    let all = frames.found.len() + frames.dropped.len();
    assert_eq!(status.images, all as u64);
    for dropped in &frames.dropped {
        assert!(status.left_out[dropped.reason.kind()] > 0);
    }
    assert_eq!(
        status.left_out.values().sum::<u64>(),
        frames.dropped.len() as u64
    );
    assert_eq!(status.quality, Some(Level::Full));
}

#[test]
fn results_have_the_names_types_and_headers_of_ros() {
    let config = NodeConfig {
        name: "front".to_owned(),
        millimetres: true,
        standard_deviation: true,
        outliers: true,
        cloud: Some(CloudOptions::default()),
        ..config("drive.mcap", None)
    };
    let mut robot = Robot::new(config);
    let advertised = robot.bus.advertised().to_vec();
    let names: Vec<_> = advertised
        .iter()
        .map(|a| (a.topic.as_str(), a.kind.as_str()))
        .collect();
    assert_eq!(
        names,
        [
            ("/front/depth/image", "sensor_msgs/msg/Image"),
            ("/front/depth/camera_info", "sensor_msgs/msg/CameraInfo"),
            ("/front/standard_deviation/image", "sensor_msgs/msg/Image"),
            ("/front/outliers", "sensor_msgs/msg/PointCloud2"),
            ("/front/points", "sensor_msgs/msg/PointCloud2"),
            ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
        ]
    );
    let qos = |robot: &Robot, topic: &str| {
        let mut all = robot.bus.subscriptions();
        all.find(|found| found.topic == topic).unwrap().qos
    };
    assert_eq!(qos(&robot, "/lidar/points"), Qos::SENSOR_DATA);
    assert_eq!(qos(&robot, "/tf"), Qos::TF);
    assert_eq!(qos(&robot, "/tf_static"), Qos::TF_STATIC);
    let reliable = Robot::new(NodeConfig {
        reliable: true,
        ..self::config("drive.mcap", None)
    });
    assert!(qos(&reliable, "/lidar/points").reliable);
    robot.play(&messages("drive.mcap"));
    let wanted: Vec<_> = depths_of_file("drive.mcap", None)
        .iter()
        .map(|message| Header::of(message).unwrap())
        .collect();
    let all: Vec<_> = robot.outputs.try_iter().collect();
    for (topic, _) in &names[..5] {
        let of_topic = all.iter().filter(|published| published.topic == *topic);
        let headers: Vec<_> = of_topic.map(|m| Header::of(&m.message).unwrap()).collect();
        assert_eq!(headers, wanted, "{topic}");
    }
    // Whole millimetres.
    let depth = all
        .iter()
        .find(|m| m.topic == "/front/depth/image")
        .unwrap();
    assert!(depth.message.windows(5).any(|bytes| bytes == b"16UC1"));
}

#[test]
fn diagnostics_name_what_is_lacking() {
    let mut robot = Robot::new(config("drive.mcap", None));
    let all = messages("drive.mcap");
    let has =
        |message: &[u8], text: &str| message.windows(text.len()).any(|w| w == text.as_bytes());
    // Nothing has come.
    robot.clock.set(1);
    robot.clock.advance(Duration::from_secs(1));
    robot.node.turn();
    let found = robot.published("/diagnostics");
    assert!(has(&found[0], "no images on /camera/image_raw/compressed"));
    // No transforms.
    let without: Vec<_> = all
        .iter()
        .filter(|message| !message.topic.starts_with("/tf"))
        .cloned()
        .collect();
    robot.play(&without);
    robot.clock.advance(Duration::from_secs(1));
    robot.node.turn();
    let found = robot.published("/diagnostics");
    assert!(
        found
            .iter()
            .any(|message| has(message, "no transforms lead from"))
    );
    assert_eq!(robot.node.status().completed, 0);
    // All is there, and the clock is set back.
    robot.play(&earlier(&all, 1000));
    robot.clock.advance(Duration::from_secs(1));
    robot.node.turn();
    let found = robot.published("/diagnostics");
    assert!(found.iter().any(|message| has(message, "clock set back")));
    assert!(robot.node.status().completed > 0);
    assert_eq!(robot.node.status().lacking, None);
}

/// Images that come while one is worked on: the newest is completed, the others are counted.
#[test]
fn the_newest_image_wins() {
    let mut robot = Robot::new(config("drive.mcap", None));
    let all = messages("drive.mcap");
    for message in &all {
        robot.clock.set(message.log as i64);
        robot.bus.send(&message.topic, &message.data);
    }
    robot.node.turn();
    let status = robot.node.status();
    assert_eq!(status.completed, 1, "{status:?}");
    assert!(status.left_out["superseded by a newer image"] >= 3);
    let stamps = robot.published("/lsdc/depth/image");
    let expected = depths_of_file("drive.mcap", None);
    assert!(stamps == expected[expected.len() - 1..]);
}
