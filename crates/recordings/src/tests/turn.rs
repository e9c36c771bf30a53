//! A scanner that sweeps over a wall while driving and turning: each point has its own time.

use super::{expected, golden, numbers};
use crate::message::MessageType;
use crate::{DecodedFrame, FrameOptions, Frames, Recording, Writer};
use lsdc_core::Observations;

/// Number of points of a cloud.
const COUNT: usize = 480;
const DRIVERS: [&str; 4] = ["ouster", "velodyne", "hesai", "livox"];

fn frames(driver: &str, deskew: bool) -> (Recording, Frames) {
    let mut recording = Recording::open(&golden("turn.mcap")).unwrap();
    let options = FrameOptions {
        points: Some(format!("/{driver}/points")),
        deskew,
        ..FrameOptions::default()
    };
    let frames = Frames::of(&mut recording, &options).unwrap();
    (recording, frames)
}

/// Alters the times of a driver: `change` gets the index of the cloud, the index of the point, and its time.
fn altered(driver: &str, change: impl Fn(usize, usize, &mut [u8])) -> (Recording, Frames) {
    let name = format!("/{driver}/points");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("altered.mcap");
    let mut writer = Writer::create(&path).unwrap();
    let mut clouds = 0;
    let mut source = Recording::open(&golden("turn.mcap")).unwrap();
    let visited = source.visit(&|_| true, &mut |topic, message| {
        let mut data = message.data.to_vec();
        if topic.name == name {
            // Times follow x, y, z and the laser; one byte follows the points.
            let step = if matches!(driver, "hesai" | "livox") {
                22
            } else {
                18
            };
            let end = data.len() - 1;
            let points = data[end - COUNT * step..end].chunks_exact_mut(step);
            let times = points.map(|point| &mut point[14..]).enumerate();
            times.for_each(|(point, time)| change(clouds, point, time));
            clouds += 1;
        }
        writer.write(
            &topic.name,
            MessageType::of(&topic.kind).unwrap(),
            message.times,
            &data,
        )
    });
    visited.unwrap();
    writer.finish().unwrap();
    let mut recording = Recording::open(&path).unwrap();
    let options = FrameOptions {
        points: Some(name),
        ..FrameOptions::default()
    };
    let frames = Frames::of(&mut recording, &options).unwrap();
    (recording, frames)
}

fn loaded(recording: &mut Recording, frames: &Frames, number: usize) -> DecodedFrame {
    let stored = frames.read(recording, &frames.found[number]).unwrap();
    stored.decode(frames).unwrap()
}

/// Returns the largest distance of the points from the wall, by the depth of the wall at their pixels.
fn off_the_wall(loaded: &DecodedFrame, number: usize) -> f64 {
    let frame = &expected()["turn"]["frames"][number];
    assert_eq!(frame["stamp"].as_i64(), Some(loaded.header.stamp));
    let plane = numbers(&frame["plane"]);
    let deviation = loaded.points.points.iter().map(|point| {
        let ray = [(point.u - 23.5) / 40.0, (point.v - 17.5) / 40.0, 1.0];
        let along: f64 = ray.iter().zip(&plane).map(|(a, b)| a * b).sum();
        (f64::from(point.depth) - plane[3] / along).abs()
    });
    deviation.fold(0.0, f64::max)
}

#[test]
fn a_wall_is_flat_whatever_the_scanner_does() {
    for driver in DRIVERS {
        let (mut recording, frames) = frames(driver, true);
        assert!(frames.remarks.is_empty(), "{:?}", frames.remarks);
        let point_times = frames.point_times().unwrap();
        assert!(
            (point_times.seconds - 0.079).abs() < 1e-6,
            "{point_times:?}"
        );
        let found = loaded(&mut recording, &frames, 0);
        let count = found.points.points.len();
        let deviation = off_the_wall(&found, 0);
        assert!(count > 200 && found.unplaced == 0, "{driver}: {count}");
        assert!(deviation < 1e-4, "{driver}: {deviation}");
    }
}

/// Without deskewing, the wall is where the car was at the stamp of the cloud.
#[test]
fn without_times_the_wall_is_bent() {
    for driver in DRIVERS {
        let (mut recording, frames) = self::frames(driver, false);
        assert_eq!(frames.point_times(), None);
        let deviation = off_the_wall(&loaded(&mut recording, &frames, 0), 0);
        assert!(deviation > 0.2, "{driver}: {deviation}");
    }
    // No transform moves, or dynamic transforms are not read.
    let mut recording = Recording::open(&golden("turn.mcap")).unwrap();
    let options = FrameOptions {
        points: Some("/ouster/points".to_owned()),
        tf: vec!["/tf_static".to_owned()],
        ..FrameOptions::default()
    };
    let frames = Frames::of(&mut recording, &options).unwrap();
    assert_eq!(frames.point_times(), None);
    assert!(frames.remarks[0].contains("(`t`)"), "{:?}", frames.remarks);
}

/// The transforms end 40 ms after the second turn begins: 41 of its 80 columns have a known pose.
#[test]
fn points_beyond_the_transforms_are_left_out_and_counted() {
    let (mut recording, frames) = frames("ouster", true);
    assert_eq!(frames.found.len(), 2);
    let found = loaded(&mut recording, &frames, 1);
    assert_eq!(found.unplaced, 39 * 6);
    let points = &found.points;
    assert_eq!(
        points.points.len() + points.outside + points.hidden,
        41 * 6,
        "{} {}",
        points.outside,
        points.hidden
    );
    assert!(off_the_wall(&found, 1) < 1e-4);
    // The stamp of this driver is that of the last point.
    let (_, frames) = self::frames("velodyne", true);
    assert_eq!((frames.found.len(), frames.dropped.len()), (1, 1));
}

/// Times that are NaN, far away or infinite do not affect the other points.
#[test]
fn wrong_times_are_those_of_their_points() {
    for (driver, wrong) in [
        ("ouster", u32::MAX.to_le_bytes().to_vec()),
        ("velodyne", f32::NAN.to_le_bytes().to_vec()),
        ("velodyne", (-0.9_f32).to_le_bytes().to_vec()),
        ("hesai", f64::NEG_INFINITY.to_le_bytes().to_vec()),
        ("livox", 0.0_f64.to_le_bytes().to_vec()),
    ] {
        let every_fifth = |_: usize, point: usize, time: &mut [u8]| {
            if point.is_multiple_of(5) {
                time.copy_from_slice(&wrong);
            }
        };
        let (mut recording, frames) = altered(driver, every_fifth);
        let found = loaded(&mut recording, &frames, 0);
        assert_eq!((found.unplaced, found.skewed), (COUNT / 5, false));
        let points = &found.points;
        let all = points.points.len() + points.outside + points.hidden + points.ignored;
        assert_eq!(all + found.unplaced, COUNT);
        let deviation = off_the_wall(&found, 0);
        assert!(deviation < 1e-4, "{driver} {wrong:?}: {deviation}");
    }
}

/// A cloud without times, or with times beyond the transforms, is not deskewed, and a remark reports it.
#[test]
fn a_cloud_without_times_counts_at_its_stamp() {
    let zero = |cloud, _, time: &mut [u8]| {
        if cloud == 0 {
            time.fill(0);
        }
    };
    let late = |cloud, _, time: &mut [u8]| {
        let later = u32::from_le_bytes(time.try_into().unwrap()) + 60_000_000;
        if cloud == 1 {
            time.copy_from_slice(&later.to_le_bytes());
        }
    };
    let altered = [altered("ouster", zero), altered("ouster", late)];
    for (number, (mut recording, frames)) in altered.into_iter().enumerate() {
        assert_eq!(frames.point_times().unwrap().field, "t");
        let found = loaded(&mut recording, &frames, number);
        assert!(found.skewed && found.unplaced == 0);
        assert!(found.points.remarks[0].contains("at the stamp of their cloud"));
        let (mut recording, frames) = self::frames("ouster", false);
        let plain = loaded(&mut recording, &frames, number);
        assert_eq!(found.points.points, plain.points.points);
        assert!(!plain.skewed && plain.points.remarks.is_empty());
    }
}

#[test]
fn times_of_no_cloud_are_remarked_once() {
    for driver in DRIVERS {
        let (mut recording, frames) = altered(driver, |_, _, time| time.fill(0));
        assert_eq!(frames.point_times(), None, "{driver}");
        let [remark] = &frames.remarks[..] else {
            panic!("{:?}", frames.remarks)
        };
        assert!(remark.contains("most of the first 2 clouds"), "{remark}");
        let found = loaded(&mut recording, &frames, 0);
        assert!(!found.skewed && found.points.remarks.is_empty());
    }
}

/// Many scanners write zeros for pulses without a return; as points they would be at the scanner itself.
#[test]
fn zeros_are_no_place() {
    let (mut recording, frames) = frames("ouster", true);
    let mut stored = frames.read(&mut recording, &frames.found[0]).unwrap();
    let end = stored.points.len() - 1;
    let points = stored.points[end - COUNT * 18..end].chunks_exact_mut(18);
    points.step_by(4).for_each(|point| point.fill(0));
    let found = stored.decode(&frames).unwrap();
    assert_eq!((found.points.ignored, found.unplaced), (COUNT / 4, 0));
    assert!(off_the_wall(&found, 0) < 1e-4);
}

/// At the stamp of the second image, the camera sees the wall where it is in that image.
#[test]
fn the_points_of_a_frame_are_seen_from_where_the_camera_is_later() {
    let (mut recording, frames) = frames("ouster", true);
    let [first, second] = [0, 1].map(|i| &frames.found[i]);
    let mut found = loaded(&mut recording, &frames, 0);
    let camera = found.camera.clone().unwrap();
    let seen = |points: &Observations, later| frames.seen_after(first, (points, &camera), later);
    let given = found.points.points.clone();
    let later = seen(&given, second.stamp - first.stamp).unwrap();
    assert_eq!(later.len(), given.len());
    found.points.points = later
        .iter()
        .copied()
        .filter(|point| point.depth.is_finite())
        .collect();
    assert!(found.points.points.len() > 200 && found.points.points != given);
    found.header.stamp = second.stamp;
    assert!(off_the_wall(&found, 1) < 1e-4);
    // At its own stamp nothing moves.
    let same = seen(&given, 0).unwrap();
    let pairs = same.iter().zip(given.iter());
    assert!(
        pairs
            .into_iter()
            .all(|(a, b)| (a.u - b.u).abs() < 1e-6 && (a.depth - b.depth).abs() < 1e-5)
    );
    // Beyond the transforms.
    assert_eq!(seen(&given, 60_000_000_000), None);
}
