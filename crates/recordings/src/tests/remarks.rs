//! Assumptions, contradictions and omissions are reported, and points are projected correctly.

use crate::cdr::CdrWriter as Message;
use crate::container::MessageLocation;
use crate::message::{Header, MessageType};
use crate::{
    DecodedFrame, FrameOptions, Frames, MessageTimes, Recording, Topic, Writer, write_cloud,
};
use lsdc_files::ColoredPoint;
use lsdc_files::error::Result;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

const STAMP: i64 = 1_700_000_000_000_000_000;
const TIMES: MessageTimes = MessageTimes {
    log: STAMP as u64,
    publish: STAMP as u64,
};

/// A message that starts with a header.
fn message(frame: &str) -> Message {
    let mut message = Message::with_capacity(0);
    let header = Header {
        stamp: STAMP,
        frame: frame.to_owned(),
    };
    header.write(&mut message);
    message
}

fn image(frame: &str, encoding: &str, (width, height): (u32, u32), data: &[u8]) -> Vec<u8> {
    let mut message = message(frame);
    message.u32(height);
    message.u32(width);
    message.string(encoding);
    message.u8(0);
    message.u32(data.len() as u32 / height);
    message.bytes(data.iter().copied());
    message.finish()
}

fn grey(frame: &str, size: (u32, u32)) -> Vec<u8> {
    let data: Vec<u8> = (0..size.0 * size.1).map(|i| (i * 7) as u8).collect();
    image(frame, "mono8", size, &data)
}

/// A depth image in metres.
fn depth(frame: &str, size: (u32, u32), at: impl Fn(u32, u32) -> f32) -> Vec<u8> {
    let pixels = (0..size.1).flat_map(|v| (0..size.0).map(move |u| (u, v)));
    let data: Vec<u8> = pixels.flat_map(|(u, v)| at(u, v).to_le_bytes()).collect();
    image(frame, "32FC1", size, &data)
}

/// `CameraInfo` of a sensor of 160x120 pixels, without distortion.
#[derive(Clone)]
struct Info {
    frame: &'static str,
    size: (u32, u32),
    model: &'static str,
    d: Vec<f64>,
    k: [f64; 9],
    r: [f64; 9],
    p: [f64; 12],
}

const EYE: [f64; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

fn info(frame: &'static str, f: f64) -> Info {
    Info {
        frame,
        size: (160, 120),
        model: "plumb_bob",
        d: vec![0.0; 5],
        k: [f, 0.0, 80.0, 0.0, f, 60.0, 0.0, 0.0, 1.0],
        r: EYE,
        p: [f, 0.0, 80.0, 0.0, 0.0, f, 60.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
}

impl Info {
    fn message(&self) -> Vec<u8> {
        let mut message = message(self.frame);
        message.u32(self.size.1);
        message.u32(self.size.0);
        message.string(self.model);
        message.u32(self.d.len() as u32);
        let matrices = self.k.iter().chain(&self.r).chain(&self.p);
        self.d.iter().chain(matrices).for_each(|v| message.f64(*v));
        // Neither binned nor cropped.
        (0..6).for_each(|_| message.u32(0));
        message.u8(0);
        message.finish()
    }
}

fn cloud(frame: &str, points: &[[f64; 3]]) -> Vec<u8> {
    let header = Header {
        stamp: STAMP,
        frame: frame.to_owned(),
    };
    let colored = |position: &[f64; 3]| ColoredPoint {
        position: *position,
        color: [0; 3],
        sigma: None,
    };
    write_cloud(&header, &points.iter().map(colored).collect::<Vec<_>>())
}

/// A transform that places `child` in `parent`.
fn transform(parent: &str, child: &str, position: [f64; 3]) -> Vec<u8> {
    let mut message = Message::with_capacity(0);
    message.u32(1);
    let header = Header {
        stamp: STAMP,
        frame: parent.to_owned(),
    };
    header.write(&mut message);
    message.string(child);
    let rotation = [0.0, 0.0, 0.0, 1.0];
    position
        .iter()
        .chain(&rotation)
        .for_each(|v| message.f64(*v));
    message.finish()
}

type Messages<'a> = &'a [(&'a str, MessageType, Vec<u8>)];

fn written(path: &Path, messages: Messages<'_>) -> Recording {
    let mut writer = Writer::create(path).unwrap();
    for (topic, kind, data) in messages {
        writer.write(topic, *kind, TIMES, data).unwrap();
    }
    writer.finish().unwrap();
    Recording::open(path).unwrap()
}

/// The only frame of a recording with these topics of images and points, and the remarks about the recording.
fn completed(
    [image, points]: [&str; 2],
    messages: Messages<'_>,
) -> Result<(DecodedFrame, Vec<String>)> {
    let folder = tempfile::tempdir().unwrap();
    let mut recording = written(&folder.path().join("a.mcap"), messages);
    let options = FrameOptions {
        image: Some(image.to_owned()),
        points: Some(points.to_owned()),
        ..FrameOptions::default()
    };
    let frames = Frames::of(&mut recording, &options)?;
    assert_eq!((frames.found.len(), frames.dropped.len()), (1, 0));
    let loaded = frames
        .read(&mut recording, &frames.found[0])?
        .decode(&frames)?;
    Ok((loaded, frames.remarks))
}

fn positions(loaded: &DecodedFrame) -> Vec<[f64; 3]> {
    let points = loaded.points.points.iter();
    points
        .map(|point| [point.u, point.v, f64::from(point.depth)])
        .collect()
}

/// Checks that the only point is at a position, in pixels and metres.
fn found(loaded: &DecodedFrame, expected: [f64; 3]) {
    let found = positions(loaded);
    assert_eq!(found.len(), 1, "{found:?}");
    let deviation = found[0].iter().zip(expected).map(|(a, b)| (a - b).abs());
    assert!(
        deviation.fold(0.0, f64::max) < 1e-4,
        "{found:?} {expected:?}"
    );
}

/// Checks the number of remarks, and that one of them contains all words.
fn assert_remarks(remarks: &[String], count: usize, words: &[&str]) {
    assert_eq!(remarks.len(), count, "{remarks:?}");
    let all = |remark: &String| words.iter().all(|word| remark.contains(word));
    assert!(
        count == 0 || remarks.iter().any(all),
        "{words:?} {remarks:?}"
    );
}

/// A point 4 m away and 0.5 m to the right of the first camera of a stereo pair.
const POINT: [f64; 3] = [0.5, -0.25, 4.0];
const BASELINE: f64 = 0.12;

/// P of the second camera: fx X / Z + cx + Tx / Z, with Tx = -fx times the baseline (`sensor_msgs/CameraInfo`).
fn second(frame: &'static str) -> Info {
    let mut info = info(frame, 140.0);
    info.p[3] = -140.0 * BASELINE;
    info
}

#[test]
fn the_second_camera_of_a_stereo_pair_is_beside_the_frame_of_the_first() {
    let expected = [
        80.0 + 140.0 * (0.5 - BASELINE) / 4.0,
        60.0 - 140.0 * 0.25 / 4.0,
        4.0,
    ];
    let topics = ["/right/image_rect_color", "/points"];
    let messages = |frame: &'static str, more: Vec<(&'static str, MessageType, Vec<u8>)>| {
        let own = [
            (topics[0], MessageType::Image, grey(frame, (160, 120))),
            (
                "/right/camera_info",
                MessageType::CameraInfo,
                second(frame).message(),
            ),
            (topics[1], MessageType::PointCloud2, cloud("left", &[POINT])),
        ];
        own.into_iter().chain(more).collect::<Vec<_>>()
    };
    // Both cameras use the frame of the first.
    let (loaded, remarks) = completed(topics, &messages("left", Vec::new())).unwrap();
    found(&loaded, expected);
    assert_remarks(
        &remarks,
        1,
        &["fourth column of P", "0.1200 m", "moved by the baseline"],
    );
    // Back-projected points are in that frame, too.
    let camera = loaded.camera.unwrap();
    let back = camera.unproject([expected[0], expected[1]], 4.0).unwrap();
    assert!(
        back.iter().zip(POINT).all(|(a, b)| (a - b).abs() < 1e-5),
        "{back:?}"
    );
    // The second camera has its own frame, placed by transforms.
    let beside = transform("left", "right", [BASELINE, 0.0, 0.0]);
    let own = messages(
        "right",
        vec![("/tf_static", MessageType::Transforms, beside)],
    );
    let (loaded, remarks) = completed(topics, &own).unwrap();
    found(&loaded, expected);
    assert_remarks(
        &remarks,
        1,
        &[
            "fourth column of P",
            "beside `left`",
            "at the origin of `right`",
        ],
    );
    // Of unrectified images, only the baseline is read from P.
    let raw = ["/right/image_raw", "/points"];
    let mut unrectified = messages("left", Vec::new());
    unrectified[0].0 = raw[0];
    let (loaded, _) = completed(raw, &unrectified).unwrap();
    assert_remarks(
        &loaded.points.remarks,
        1,
        &["taken for unrectified", "stereo baseline of 0.1200 m"],
    );
}

/// Whether images are rectified follows from the name of their topic; contradicting parameters are reported.
#[test]
fn rectified_images_are_those_of_topics_called_so() {
    for (image, p_counts) in [
        ("/direct_view/image_raw", false),
        ("/rect/image", false),
        ("/cam/image_rect", true),
        ("/cam/image_rect_color", true),
    ] {
        let above = image.rsplit_once('/').unwrap().0;
        let name = format!("{above}/camera_info");
        let run = |info: &Info| {
            let messages = [
                (image, MessageType::Image, grey("cam", (160, 120))),
                (&name[..], MessageType::CameraInfo, info.message()),
                ("/points", MessageType::PointCloud2, cloud("cam", &[POINT])),
            ];
            completed([image, "/points"], &messages)
        };
        let mut differing = info("cam", 140.0);
        (differing.p[0], differing.p[5]) = (112.0, 112.0);
        let (loaded, remarks) = run(&differing).unwrap();
        let f = if p_counts { 112.0 } else { 140.0 };
        found(&loaded, [80.0 + f * 0.5 / 4.0, 60.0 - f * 0.25 / 4.0, 4.0]);
        assert_eq!(remarks, Vec::<String>::new());
        let (taken, applied) = if p_counts {
            ("taken for rectified", "R and D are not applied")
        } else {
            ("taken for unrectified", "R and P are not applied")
        };
        let words = [
            &name[..],
            taken,
            applied,
            "P (fx 112, cx 80) differs from K (fx 140, cx 80)",
        ];
        assert_remarks(&loaded.points.remarks, 1, &words);
        // No contradiction.
        let (loaded, _) = run(&info("cam", 140.0)).unwrap();
        assert_remarks(&loaded.points.remarks, 0, &[]);
        // 30 degrees about the optical axis.
        let mut turned = info("cam", 140.0);
        let (sine, cosine) = (0.5, 0.75_f64.sqrt());
        turned.r = [cosine, -sine, 0.0, sine, cosine, 0.0, 0.0, 0.0, 1.0];
        let (loaded, _) = run(&turned).unwrap();
        assert_remarks(
            &loaded.points.remarks,
            1,
            &["R is a rotation of 30.00 degrees"],
        );
        // An uncalibrated camera.
        let mut blind = info("cam", 140.0);
        if p_counts {
            blind.p = [0.0; 12];
        } else {
            blind.k = [0.0; 9];
        }
        let error = run(&blind).err().unwrap().to_string();
        let words = if p_counts {
            "has no P"
        } else {
            "K of zeros: the camera is not calibrated"
        };
        assert!(error.contains(words), "{error}");
    }
}

const BOTH: [&str; 2] = ["/color/image_raw", "/depth/image"];

/// Decodes an image and a depth image with one pixel at 2 m, both in the frame `cam`.
fn depth_camera(color: &Info, depths: Option<&Info>) -> Result<(DecodedFrame, Vec<String>)> {
    let one = |u, v| if (u, v) == (100, 30) { 2.0 } else { 0.0 };
    let mut messages = vec![
        (BOTH[0], MessageType::Image, grey("cam", (160, 120))),
        (
            "/color/camera_info",
            MessageType::CameraInfo,
            color.message(),
        ),
        (BOTH[1], MessageType::Image, depth("cam", (160, 120), one)),
    ];
    messages.extend(depths.map(|info| {
        (
            "/depth/camera_info",
            MessageType::CameraInfo,
            info.message(),
        )
    }));
    completed(BOTH, &messages)
}

#[test]
fn depths_in_the_frame_of_the_image_are_registered_only_if_the_cameras_agree() {
    let own = info("cam", 140.0);
    let (loaded, remarks) = depth_camera(&own, Some(&own)).unwrap();
    found(&loaded, [100.0, 30.0, 2.0]);
    assert_remarks(&remarks, 0, &[]);
    // Half the focal length: 20 pixels right of the centre are 40 in the image.
    let (loaded, remarks) = depth_camera(&own, Some(&info("cam", 70.0))).unwrap();
    found(&loaded, [80.0 + 40.0, 60.0 - 60.0, 2.0]);
    assert_remarks(
        &remarks,
        1,
        &[
            "differ by up to",
            "both are in the frame `cam`",
            "projected by both cameras",
        ],
    );
    // x (1 + k1 r²), by plumb_bob, of a ray at 20 / 140 and -30 / 140.
    let mut bent = own.clone();
    bent.d[0] = -0.9;
    let (x, y) = (20.0 / 140.0, -30.0 / 140.0);
    let radial = 1.0 - 0.9 * (x * x + y * y);
    let (loaded, remarks) = depth_camera(&bent, Some(&own)).unwrap();
    found(
        &loaded,
        [80.0 + 140.0 * x * radial, 60.0 + 140.0 * y * radial, 2.0],
    );
    assert_remarks(&remarks, 1, &["differ by up to", "radtan"]);
    // No camera to compare with.
    let (loaded, remarks) = depth_camera(&own, None).unwrap();
    found(&loaded, [100.0, 30.0, 2.0]);
    assert_remarks(
        &remarks,
        1,
        &["taken for registered", "no camera of the depths"],
    );
}

#[test]
fn a_given_camera_is_compared_with_that_of_the_depths() {
    let folder = tempfile::tempdir().unwrap();
    let one = |u, v| if (u, v) == (100, 30) { 2.0 } else { 0.0 };
    let mut recording = written(
        &folder.path().join("a.mcap"),
        &[
            (BOTH[0], MessageType::Image, grey("color", (160, 120))),
            (BOTH[1], MessageType::Image, depth("depth", (160, 120), one)),
            (
                "/depth/camera_info",
                MessageType::CameraInfo,
                info("depth", 140.0).message(),
            ),
        ],
    );
    for (f, expected, said) in [(140.0, [100.0, 30.0, 2.0], 0), (70.0, [90.0, 45.0, 2.0], 1)] {
        let options = FrameOptions {
            image: Some(BOTH[0].to_owned()),
            points: Some(BOTH[1].to_owned()),
            camera: Some(format!("{f},{f},80,60").parse().unwrap()),
            ..FrameOptions::default()
        };
        let frames = Frames::of(&mut recording, &options).unwrap();
        let read = frames.read(&mut recording, &frames.found[0]).unwrap();
        found(&read.decode(&frames).unwrap(), expected);
        assert_remarks(&frames.remarks, said, &["the camera is given"]);
    }
}

#[test]
fn frames_and_sizes_that_differ_are_said() {
    let run = |frame: &'static str, info: &Info| {
        completed(
            ["/cam/image_raw", "/points"],
            &[
                ("/cam/image_raw", MessageType::Image, grey(frame, (80, 60))),
                ("/cam/camera_info", MessageType::CameraInfo, info.message()),
                ("/points", MessageType::PointCloud2, cloud(frame, &[POINT])),
            ],
        )
    };
    let (loaded, remarks) = run("cam", &info("cam", 140.0)).unwrap();
    assert_remarks(&remarks, 0, &[]);
    assert_remarks(
        &loaded.points.remarks,
        1,
        &["`/cam/camera_info`", "160x120 is scaled to 80x60"],
    );
    let (_, remarks) = run("cam", &info("other", 140.0)).unwrap();
    assert_remarks(
        &remarks,
        1,
        &[
            "`/cam/camera_info` is in the frame `other`",
            "`cam`, which is used",
        ],
    );
    let (_, remarks) = run("", &info("", 140.0)).unwrap();
    assert_remarks(&remarks, 1, &["name no frame of reference"]);
}

#[test]
fn lenses_that_are_not_named_or_known_are_said() {
    let run = |model: &'static str, d: &[f64]| {
        let info = Info {
            model,
            d: d.to_vec(),
            ..info("cam", 140.0)
        };
        let messages = [
            (
                "/cam/image_raw",
                MessageType::Image,
                grey("cam", (160, 120)),
            ),
            ("/cam/camera_info", MessageType::CameraInfo, info.message()),
            ("/points", MessageType::PointCloud2, cloud("cam", &[POINT])),
        ];
        completed(["/cam/image_raw", "/points"], &messages)
    };
    let bent = [0.05, -0.02, 0.01, -0.003];
    let (loaded, _) = run("", &bent).unwrap();
    assert_remarks(
        &loaded.points.remarks,
        1,
        &["names no distortion model", "plumb_bob", "fisheye"],
    );
    let (loaded, _) = run("equidistant", &bent).unwrap();
    assert_remarks(&loaded.points.remarks, 0, &[]);
    // A fisheye lens may have no coefficients: r = f theta.
    let (loaded, _) = run("equidistant", &[0.0; 4]).unwrap();
    let radius = (POINT[0] / POINT[2]).hypot(POINT[1] / POINT[2]);
    let factor = 140.0 * radius.atan() / radius;
    found(
        &loaded,
        [
            80.0 + factor * POINT[0] / 4.0,
            60.0 + factor * POINT[1] / 4.0,
            4.0,
        ],
    );
    let (loaded, _) = run("thin_prism", &[0.0; 4]).unwrap();
    assert_remarks(
        &loaded.points.remarks,
        1,
        &["`thin_prism` is not known", "without"],
    );
    let error = run("thin_prism", &bent).err().unwrap().to_string();
    assert!(
        error.contains("`thin_prism`, which is not known"),
        "{error}"
    );
}

/// Encodings of Foxglove, and of ROS 1 bags.
#[test]
fn messages_of_another_encoding_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for (encoding, kind, words) in [
        (
            "protobuf",
            "foxglove.CompressedImage",
            "encoded as `protobuf`",
        ),
        ("json", "sensor_msgs/msg/Image", "encoded as `json`"),
        ("ros1", "sensor_msgs/Image", "encoded as `ros1`"),
    ] {
        let path = folder.path().join(format!("{encoding}.mcap"));
        let mut writer = Writer::create(&path).unwrap();
        writer
            .write(
                "/points",
                MessageType::PointCloud2,
                TIMES,
                &cloud("cam", &[POINT]),
            )
            .unwrap();
        let topic = Arc::new(Topic {
            name: "/image".to_owned(),
            kind: kind.to_owned(),
            encoding: encoding.to_owned(),
            definition: None,
            metadata: BTreeMap::new(),
        });
        let message = crate::Message {
            location: MessageLocation {
                file: 0,
                at: 0,
                within: 0,
            },
            times: MessageTimes { log: 0, publish: 0 },
            sequence: 0,
            data: b"{}",
        };
        writer.copy(&topic, &message).unwrap();
        writer.finish().unwrap();
        let error = Frames::of(
            &mut Recording::open(&path).unwrap(),
            &FrameOptions::default(),
        );
        let error = error.err().unwrap();
        let text = format!("{error} {}", error.advice().unwrap());
        assert!(
            text.contains(words) && text.contains("rosbags-convert"),
            "{text}"
        );
    }
}

#[test]
fn files_that_a_bag_lists_and_does_not_hold_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let metadata = "rosbag2_bagfile_information:\n  relative_file_paths:\n    - a_0.mcap\n    - a_1.mcap\n    - a_2.mcap.zstd\n";
    std::fs::write(at("metadata.yaml"), metadata).unwrap();
    let error = Recording::open(folder.path()).err().unwrap().to_string();
    assert!(
        error.contains("a_0.mcap, a_1.mcap, a_2.mcap.zstd"),
        "{error}"
    );
    written(
        &at("a_0.mcap"),
        &[("/points", MessageType::PointCloud2, cloud("cam", &[POINT]))],
    );
    std::fs::write(at("a_2.mcap.zstd"), b"packed").unwrap();
    let mut recording = Recording::open(folder.path()).unwrap();
    let defects = recording.visit(&|_| true, &mut |_, _| Ok(())).unwrap();
    let lines: Vec<String> = defects.lines().collect();
    assert_remarks(&lines, 1, &["a_1.mcap", "zstd -d"]);
}

#[test]
fn bags_of_ros_1_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.bag");
    std::fs::write(&path, b"#ROSBAG V2.0\n").unwrap();
    assert!(Recording::is_at(&path));
    let error = Recording::open(&path).err().unwrap();
    assert!(error.to_string().contains("ROS 1"), "{error}");
    assert!(error.advice().unwrap().contains("rosbags-convert"));
}

/// Decodes a depth image of 160x120 pixels, in the frame and with the camera of the image.
fn depths(message: Vec<u8>, kind: MessageType) -> DecodedFrame {
    let own = info("cam", 140.0).message();
    let messages = [
        (BOTH[0], MessageType::Image, grey("cam", (160, 120))),
        ("/color/camera_info", MessageType::CameraInfo, own.clone()),
        (BOTH[1], kind, message),
        ("/depth/camera_info", MessageType::CameraInfo, own),
    ];
    completed(BOTH, &messages).unwrap().0
}

/// An image of 16-bit integers.
fn whole(encoding: &str, at: impl Fn(u32) -> u16) -> Vec<u8> {
    let data: Vec<u8> = (0..160 * 120).flat_map(|i| at(i).to_le_bytes()).collect();
    image("cam", encoding, (160, 120), &data)
}

#[test]
fn depths_of_messages_are_doubted_as_those_of_files() {
    // Millimetres stored as floating-point numbers.
    let loaded = depths(
        depth("cam", (160, 120), |u, _| 2000.0 + u as f32),
        MessageType::Image,
    );
    assert_remarks(
        &loaded.points.remarks,
        1,
        &[
            "`/depth/image`",
            "the median depth is 2080 m",
            "--depth-unit",
        ],
    );
    // The largest value of the type is not a measurement.
    let marked = whole("16UC1", |i| {
        if i < 4000 {
            65535
        } else {
            1500 + (i % 160) as u16
        }
    });
    let loaded = depths(marked, MessageType::Image);
    assert_remarks(
        &loaded.points.remarks,
        1,
        &["4000 depths (21 %) are 65535", "left out"],
    );
    assert_eq!(
        (loaded.points.points.len(), loaded.points.ignored),
        (160 * 120 - 4000, 4000)
    );
    let intact = whole("16UC1", |i| 1500 + (i % 160) as u16);
    assert_remarks(&depths(intact, MessageType::Image).points.remarks, 0, &[]);
}

#[test]
fn clouds_in_millimetres_are_doubted_and_read_in_the_unit_that_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let far = POINT.map(|v| v * 1000.0);
    let mut recording = written(
        &folder.path().join("a.mcap"),
        &[
            (
                "/cam/image_raw",
                MessageType::Image,
                grey("cam", (160, 120)),
            ),
            (
                "/cam/camera_info",
                MessageType::CameraInfo,
                info("cam", 140.0).message(),
            ),
            ("/points", MessageType::PointCloud2, cloud("cam", &[far])),
        ],
    );
    let position = [80.0 + 140.0 * 0.5 / 4.0, 60.0 - 140.0 * 0.25 / 4.0];
    for (unit, depth, count) in [
        (None, 4000.0, 1),
        (Some(lsdc_files::Unit::MILLIMETRE), 4.0, 0),
    ] {
        let options = FrameOptions {
            unit,
            ..FrameOptions::default()
        };
        let frames = Frames::of(&mut recording, &options).unwrap();
        let read = frames.read(&mut recording, &frames.found[0]).unwrap();
        let loaded = read.decode(&frames).unwrap();
        found(&loaded, [position[0], position[1], depth]);
        assert_remarks(
            &loaded.points.remarks,
            count,
            &["`/points`", "the median depth is 4000 m"],
        );
    }
}

/// A message of a JPEG or PNG image.
fn packed(format: &str, bytes: &[u8]) -> Vec<u8> {
    let mut message = message("cam");
    message.string(format);
    message.bytes(bytes.iter().copied());
    message.finish()
}

fn encoded(image: &image::DynamicImage, format: image::ImageFormat) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image.write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// Decodes a frame with an image of these bytes.
fn colours(kind: MessageType, data: Vec<u8>) -> Result<DecodedFrame> {
    let messages = [
        ("/cam/image", kind, data),
        (
            "/cam/camera_info",
            MessageType::CameraInfo,
            info("cam", 140.0).message(),
        ),
        ("/points", MessageType::PointCloud2, cloud("cam", &[POINT])),
    ];
    completed(["/cam/image", "/points"], &messages).map(|(loaded, _)| loaded)
}

#[test]
fn images_of_ten_bits_in_sixteen_are_stretched_and_said() {
    let ten = |i: u32| ((i % 160) * 1023 / 159) as u16;
    let grey = image::ImageBuffer::from_fn(160, 120, |x, _| image::Luma([ten(x)]));
    let png = encoded(
        &image::DynamicImage::ImageLuma16(grey),
        image::ImageFormat::Png,
    );
    for (kind, data) in [
        (MessageType::Image, whole("mono16", ten)),
        (
            MessageType::CompressedImage,
            packed("mono16; png compressed", &png),
        ),
    ] {
        let loaded = colours(kind, data).unwrap();
        assert_eq!(loaded.image.get_pixel(159, 5).0, [255; 3]);
        assert_eq!(loaded.image.get_pixel(0, 5).0, [0; 3]);
        assert_remarks(&loaded.points.remarks, 1, &["`/cam/image`", "stretched"]);
    }
}

#[test]
fn jpegs_that_are_cut_off_are_refused() {
    let rgb = image::RgbImage::from_fn(160, 120, |x, y| {
        image::Rgb([x as u8, y as u8, (x * y) as u8])
    });
    let jpeg = encoded(&rgb.into(), image::ImageFormat::Jpeg);
    let whole = colours(
        MessageType::CompressedImage,
        packed("rgb8; jpeg compressed bgr8", &jpeg),
    )
    .unwrap();
    assert_remarks(&whole.points.remarks, 0, &[]);
    let half = &jpeg[..jpeg.len() / 2];
    let error = colours(MessageType::CompressedImage, packed("jpeg", half))
        .err()
        .unwrap()
        .to_string();
    assert!(error.contains("cut off"), "{error}");
}

/// `compression_mode: message` of rosbag2, in MCAP.
#[test]
fn messages_that_are_compressed_one_by_one_are_read() {
    let own = info("cam", 140.0).message();
    let plain = [
        ("/cam/image", MessageType::Image, grey("cam", (160, 120))),
        ("/cam/camera_info", MessageType::CameraInfo, own),
        ("/points", MessageType::PointCloud2, cloud("cam", &[POINT])),
    ];
    let topics = ["/cam/image", "/points"];
    let (expected, _) = completed(topics, &plain).unwrap();
    let packed = plain.map(|(topic, kind, data)| {
        let data = zstd::bulk::compress(&data, 3).unwrap();
        (topic, kind, data)
    });
    let (loaded, _) = completed(topics, &packed).unwrap();
    assert_eq!(positions(&loaded), positions(&expected));
    assert_eq!(loaded.image, expected.image);
}
