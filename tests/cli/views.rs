//! `lsdc complete --views`: points of neighbouring images are used through their poses.

use super::*;
use lsdc_eval::data::write_rgb;
use lsdc_recordings::{FrameOptions, Frames, Header, Recording};
use serde_json::Value;
use std::fmt::Write as _;
use std::io::{BufRead as _, BufReader};

const WIDTH: usize = 96;
const HEIGHT: usize = 72;
const FRAMES: usize = 4;
const CAMERA: &str = "80,80,47.5,35.5";

/// Position of the camera of a frame along x: it moves to the right in front of a wall at 3 m without turning.
fn place(frame: usize) -> f64 {
    0.15 * frame as f64
}

/// Depth of a wavy wall, z = 3 + 0.3 sin(2.4 x + 2 y), at a pixel of a frame. The 46 points of a frame miss much of the waves,
/// so points of neighbours improve the result by more than two standard errors.
fn wall(frame: usize, [u, v]: [usize; 2]) -> f64 {
    let (right, down) = ((u as f64 - 47.5) / 80.0, (v as f64 - 35.5) / 80.0);
    // A contraction, because the waves are less steep than the rays.
    (0..100).fold(3.0, |z, _| relief(place(frame) + right * z, down * z))
}

fn relief(x: f64, y: f64) -> f64 {
    3.0 + 0.3 * (2.4 * x + 2.0 * y).sin()
}

/// A folder with images `N.png`, points at different places of the wall, and a trajectory `poses.txt`.
fn sequence() -> tempfile::TempDir {
    sequence_of(FRAMES)
}

fn sequence_of(count: usize) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for part in ["images", "points"] {
        std::fs::create_dir(at(part)).unwrap();
    }
    let mut poses = String::from("# timestamp tx ty tz qx qy qz qw\n");
    for frame in 0..count {
        let pixel = |x: u32, y: u32| image::Rgb([x as u8 * 2, y as u8 * 3, frame as u8]);
        let image = image::RgbImage::from_fn(WIDTH as u32, HEIGHT as u32, pixel);
        image.save(at(&format!("images/{frame}.png"))).unwrap();
        let pixels = (frame * 13..WIDTH * HEIGHT).step_by(151);
        let lines = pixels.map(|i| {
            let (u, v) = (i % WIDTH, i / WIDTH);
            format!("{u},{v},{}\n", wall(frame, [u, v]))
        });
        let lines: String = lines.collect();
        std::fs::write(
            at(&format!("points/{frame}.csv")),
            format!("u,v,depth\n{lines}"),
        )
        .unwrap();
        writeln!(poses, "{frame} {} 0 0 0 0 0 1", place(frame)).unwrap();
    }
    std::fs::write(at("poses.txt"), poses).unwrap();
    folder
}

fn args<'a>(views: &'a str, output: &'a str) -> Vec<&'a str> {
    vec![
        "complete",
        "images",
        "points",
        "-o",
        output,
        "--camera",
        CAMERA,
        "--formats",
        "npy",
        "--json",
        "--weights",
        "small",
        views,
    ]
}

/// Runs a command, and returns the reports of the frames and the standard error.
fn reports(folder: &Path, args: &[&str]) -> (Vec<Value>, String) {
    let run = lsdc(folder).args(args).assert().success();
    let told = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    let lines = text(&run);
    let frames = lines
        .lines()
        .map(|line| serde_json::from_str(line).unwrap());
    (
        frames
            .filter(|frame: &Value| frame["depth"].is_object())
            .collect(),
        told,
    )
}

#[test]
fn neighbours_join_and_an_interrupted_run_goes_on_with_the_same_bits() {
    let folder = sequence();
    let at = |name: &str| folder.path().join(name);
    let (frames, told) = reports(folder.path(), &args("--views=poses.txt", "out"));
    assert_eq!(frames.len(), FRAMES, "{told}");
    for frame in &frames {
        let views = &frame["views"];
        assert_eq!(
            (&views["outcome"], &views["considered"]),
            (&"used".into(), &3.into()),
            "{frame}"
        );
        assert!(views["carried"].as_u64().unwrap() > 100, "{frame}");
        // Points of the image itself.
        let own = frame["points"]["used"].as_u64().unwrap();
        assert!((45..=46).contains(&own), "{frame}");
    }
    assert!(told.contains("views     "), "{told}");
    let bytes = |name: &str| std::fs::read(at(name)).unwrap();
    let names = [
        "out/0_depth.npy",
        "out/1_depth.npy",
        "out/2_depth.npy",
        "out/3_depth.npy",
    ];
    let first: Vec<Vec<u8>> = names.iter().map(|name| bytes(name)).collect();
    for name in &names[1..3] {
        std::fs::remove_file(at(name)).unwrap();
    }
    let (_, told) = reports(folder.path(), &args("--views=poses.txt", "out"));
    assert!(told.contains("2 completed, 2 there already"), "{told}");
    let again: Vec<Vec<u8>> = names.iter().map(|name| bytes(name)).collect();
    assert!(first == again);
    // Two shards together are the whole.
    for shard in ["0/2", "1/2"] {
        let all = [args("--views=poses.txt", "parts"), vec!["--shard", shard]].concat();
        reports(folder.path(), &all);
    }
    let parts = names
        .iter()
        .map(|name| bytes(&name.replace("out", "parts")));
    assert!(first == parts.collect::<Vec<_>>());
    // Points of other images change the result.
    let (_, _) = reports(folder.path(), &args("--no-alignment", "alone"));
    assert!(bytes("alone/1_depth.npy") != first[1]);
}

/// Runs a command until the first frame is reported, then ends it as `kill -9` does.
fn kill_after_a_frame(folder: &Path, args: &[&str]) {
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_lsdc"))
        .args(args)
        .current_dir(folder)
        .env("LSDC_WEIGHTS", folder.join("nowhere"))
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let told = BufReader::new(child.stdout.take().unwrap());
    let first = told.lines().map(Result::unwrap);
    let first = { first }.find(|line| line.contains("\"completed\""));
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(first.is_some());
}

/// Names and bytes of the depth maps of a folder.
fn maps(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let names = names(folder).into_iter();
    let names = names.filter(|name| name.ends_with("_depth.npy"));
    names
        .map(|name| {
            let bytes = std::fs::read(folder.join(&name)).unwrap();
            (name, bytes)
        })
        .collect()
}

#[test]
fn a_killed_run_goes_on_with_the_same_bits() {
    const MANY: usize = 12;
    let folder = sequence_of(MANY);
    let at = folder.path();
    reports(at, &args("--views=poses.txt", "whole"));
    let all = args("--views=poses.txt", "out");
    kill_after_a_frame(at, &all);
    let (frames, told) = reports(at, &all);
    assert_eq!(frames.len(), MANY, "{told}");
    let whole = maps(&at.join("whole"));
    assert_eq!(whole.len(), MANY);
    assert!(whole == maps(&at.join("out")), "{told}");
}

#[test]
fn only_earlier_images_join_if_that_is_asked_for() {
    let folder = sequence();
    let past = [args("--views=poses.txt", "out"), vec!["--views-past"]].concat();
    let (frames, _) = reports(folder.path(), &past);
    for frame in &frames {
        let image = frame["image"].as_str().unwrap();
        let others = frame["views"]["images"].as_array().unwrap();
        let others = others.iter().map(|view| view["image"].as_str().unwrap());
        let mut others: Vec<&str> = others.collect();
        others.sort_unstable();
        let earlier = ["0.png", "1.png", "2.png", "3.png"].into_iter();
        let earlier: Vec<&str> = earlier.take_while(|other| *other != image).collect();
        assert_eq!(others, earlier, "{image}");
    }
    let one = [args("--views=poses.txt", "one"), vec!["--views-count", "1"]].concat();
    let (frames, _) = reports(folder.path(), &one);
    assert!(frames.iter().all(|frame| frame["views"]["considered"] == 1));
    // Other neighbours give other results.
    let all = args("--views=poses.txt", "out");
    refused(folder.path(), &all, &["4 results of other settings"]);
    let alone = ["complete", "images", "points", "-o", "more", "--views-past"];
    refused(folder.path(), &alone, &["--views"]);
}

#[test]
fn results_of_other_poses_or_points_of_neighbours_are_not_used_again() {
    let folder = sequence();
    let at = |name: &str| folder.path().join(name);
    reports(folder.path(), &args("--views=poses.txt", "out"));
    let poses = std::fs::read_to_string(at("poses.txt")).unwrap();
    std::fs::write(at("poses.txt"), poses.replace("1 0.15", "1 0.16")).unwrap();
    let all = args("--views=poses.txt", "out");
    refused(folder.path(), &all, &["poses.txt` has changed", "--force"]);
    std::fs::write(at("poses.txt"), poses).unwrap();
    let points = std::fs::read_to_string(at("points/3.csv")).unwrap();
    std::fs::write(at("points/3.csv"), points + "50,40,2.5\n").unwrap();
    // The last image is a neighbour of all four.
    refused(
        folder.path(),
        &all,
        &["4 results of other settings or inputs"],
    );
    refused(folder.path(), &args("--no-alignment", "out"), &["views"]);
}

#[test]
fn wrong_poses_are_left_out_and_warned_of() {
    let folder = sequence();
    let at = |name: &str| folder.path().join(name);
    // The third camera is 1.2 m ahead of its true position.
    let poses = std::fs::read_to_string(at("poses.txt")).unwrap();
    let wrong = poses.replace("2 0.3 0 0", "2 0.3 0 1.2");
    assert_ne!(wrong, poses);
    std::fs::write(at("poses.txt"), wrong).unwrap();
    let (frames, told) = reports(folder.path(), &args("--views=poses.txt", "out"));
    for frame in &frames {
        let others = frame["views"]["images"].as_array().unwrap();
        let third = others.iter().find(|view| view["image"] == "2.png");
        if frame["image"] != "2.png" {
            assert_eq!(third.unwrap()["outcome"], "inconsistent", "{frame}");
        }
    }
    assert!(
        told.contains("contradict its points") && told.contains("check poses"),
        "{told}"
    );
}

#[test]
fn images_without_a_pose_are_completed_alone() {
    let folder = sequence();
    let at = |name: &str| folder.path().join(name);
    let poses = std::fs::read_to_string(at("poses.txt")).unwrap();
    let lines: Vec<&str> = poses.lines().take(FRAMES).collect();
    std::fs::write(at("poses.txt"), lines.join("\n")).unwrap();
    let (frames, told) = reports(folder.path(), &args("--views=poses.txt", "out"));
    assert!(
        told.contains("1 image without a pose") && told.contains("3.png"),
        "{told}"
    );
    for frame in &frames {
        assert_eq!(frame["views"].is_null(), frame["image"] == "3.png");
    }
    std::fs::write(at("poses.txt"), "100 0 0 0 0 0 0 1\n").unwrap();
    let all = args("--views=poses.txt", "more");
    refused(
        folder.path(),
        &all,
        &["none of 4 images has a pose", "0.png"],
    );
}

#[test]
fn views_need_poses_and_a_camera_and_several_images() {
    let folder = sequence();
    let at = folder.path();
    let all = args("--views", "out");
    refused(at, &all, &["needs the poses", "--views=FILE"]);
    let temporal = [args("--views=poses.txt", "out"), vec!["--temporal"]].concat();
    refused(
        at,
        &temporal,
        &["`--views` cannot be combined with `--temporal`"],
    );
    let one = [
        "complete",
        "images/0.png",
        "points/0.csv",
        "--views=poses.txt",
    ];
    refused(at, &one, &["one image has no neighbours"]);
    let without = [
        "complete",
        "images",
        "points",
        "-o",
        "out",
        "--views=poses.txt",
    ];
    refused(at, &without, &["needs the camera", "--camera"]);
    let method = [&without[..], &["--method", "nearest"]].concat();
    refused(at, &method, &["--views", "need method `lsdc`"]);
    refused(at, &args("--views=nowhere.txt", "out"), &["nowhere.txt"]);
}

/// Images of a model share points that were measured once.
#[test]
fn points_that_images_of_a_model_share_are_counted_once() {
    let folder = sequence();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("model")).unwrap();
    let camera = format!("1 PINHOLE {WIDTH} {HEIGHT} 80 80 48 36\n");
    std::fs::write(at("model/cameras.txt"), camera).unwrap();
    // A grid of points, of which each image observes all but a different quarter.
    let grid = |i: usize| {
        let (x, y) = (0.06 * (i % 40) as f64 - 1.0, 0.1 * (i / 40) as f64 - 1.0);
        [x, y, relief(x, y)]
    };
    let (mut images, mut points) = (String::new(), String::new());
    for frame in 0..2 {
        let mut seen = Vec::new();
        for i in (0..800).filter(|i| i % 4 != frame) {
            let [x, y, z] = grid(i);
            let (u, v) = (48.0 + 80.0 * (x - place(frame)) / z, 36.0 + 80.0 * y / z);
            if (0.0..WIDTH as f64).contains(&u) && (0.0..HEIGHT as f64).contains(&v) {
                seen.push(format!("{u} {v} {i}"));
            }
        }
        let number = frame + 1;
        let (x, seen) = (-place(frame), seen.join(" "));
        writeln!(images, "{number} 1 0 0 0 {x} 0 0 1 {frame}.png\n{seen}").unwrap();
    }
    for i in 0..800 {
        let [x, y, z] = grid(i);
        writeln!(points, "{i} {x} {y} {z} 0 0 0 0.5 1 0 2 0").unwrap();
    }
    std::fs::write(at("model/images.txt"), images).unwrap();
    std::fs::write(at("model/points3D.txt"), points).unwrap();
    let run = [
        "complete",
        "images",
        "model",
        "-o",
        "out",
        "--formats",
        "npy",
        "--json",
        "--weights",
        "small",
        "--views",
    ];
    let (frames, told) = reports(folder.path(), &run);
    assert_eq!(frames.len(), 2, "{told}");
    for frame in &frames {
        let views = &frame["views"];
        let count = |name: &str| views[name].as_u64().unwrap();
        assert_eq!(views["considered"], 1, "{frame}");
        // A third of the points of the other image are new.
        assert!(count("doubled") > 300, "{frame}");
        assert!(
            (50..=200).contains(&views["images"][0]["carried"].as_u64().unwrap()),
            "{frame}"
        );
    }
}

/// Path of the recording of a car passing a wall (`scripts/recordings.py`).
fn drive() -> String {
    let place = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/recordings");
    place.join("drive.mcap").display().to_string()
}

/// Camera-to-world transform of the car's camera in `odom` after `t` seconds. The car is at (8 t, 2 t², 0), turned by
/// 0.4 t + 0.3 t²; the camera looks ahead from (0.8, 0.1, 1.4).
fn place_of_car(t: f64) -> [[f64; 4]; 3] {
    let (sin, cos) = (0.4 * t + 0.3 * t * t).sin_cos();
    let [x, y] = [
        8.0 * t + cos * 0.8 - sin * 0.1,
        2.0 * t * t + sin * 0.8 + cos * 0.1,
    ];
    // Columns: right, down, ahead, position.
    [
        [sin, 0.0, cos, x],
        [-cos, 0.0, sin, y],
        [0.0, -1.0, 0.0, 1.4],
    ]
}

const STAMPS: [i64; 4] = [
    1_700_000_000_100_000_000,
    1_700_000_000_200_000_000,
    1_700_000_000_400_000_000,
    1_700_000_000_500_000_000,
];

/// Poses from transforms match the closed form; points and cameras match those of files.
#[test]
fn a_recording_gives_what_files_with_its_poses_give() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut recording = Recording::open(Path::new(&drive())).unwrap();
    let frames = Frames::of(&mut recording, &FrameOptions::default()).unwrap();
    for folder in ["images", "points", "poses"] {
        std::fs::create_dir(at(folder)).unwrap();
    }
    let stamps: Vec<i64> = frames.found.iter().map(|frame| frame.stamp).collect();
    assert_eq!(stamps, STAMPS);
    for frame in &frames.found {
        let read = frames.read(&mut recording, frame).unwrap();
        let loaded = read.decode(&frames).unwrap();
        write_rgb(&at(&format!("images/{}.png", frame.stamp)), &loaded.image).unwrap();
        let mut lines = "u,v,depth\n".to_owned();
        for point in &loaded.points.points {
            writeln!(lines, "{},{},{}", point.u, point.v, point.depth).unwrap();
        }
        std::fs::write(at(&format!("points/{}.csv", frame.stamp)), lines).unwrap();
        let seconds = (frame.stamp - 1_700_000_000_000_000_000) as f64 * 1e-9;
        let mut rows = String::new();
        for row in place_of_car(seconds) {
            writeln!(rows, "{} {} {} {}", row[0], row[1], row[2], row[3]).unwrap();
        }
        let pose = at(&format!("poses/{}.pose.txt", frame.stamp));
        std::fs::write(pose, rows + "0 0 0 1\n").unwrap();
    }
    let camera = "width = 96\nheight = 72\nfx = 80.0\nfy = 80.0\ncx = 47.5\ncy = 35.5\nmodel = \"radtan\"\n\
                  distortion = [-0.1, 0.02, 0.001, -0.0005, 0.0]\n";
    std::fs::write(at("camera.toml"), camera).unwrap();
    let usual = ["--formats", "npy", "--json", "--weights", "small"];
    let files = [
        &[
            "complete",
            "images",
            "points",
            "-o",
            "files",
            "--views=poses",
        ][..],
        &["--camera", "camera.toml"],
        &usual,
    ];
    let (of_files, told) = reports(folder.path(), &files.concat());
    assert_eq!(of_files.len(), 4, "{told}");
    let drive = drive();
    let recorded = [&["complete", &drive, "-o", "out", "--views"][..], &usual].concat();
    let (of_recording, told) = reports(folder.path(), &recorded);
    assert!(told.contains("poses     4 images in `odom`"), "{told}");
    for (one, other) in of_files.iter().zip(&of_recording) {
        let count = |frame: &Value, name: &str| frame["views"][name].as_u64().unwrap();
        assert_eq!(count(other, "considered"), 3, "{other}");
        assert_eq!(one["views"]["outcome"], other["views"]["outcome"]);
        assert!(count(one, "carried").abs_diff(count(other, "carried")) <= 3);
    }
    for stamp in STAMPS {
        let [one, other] = ["files", "out"]
            .map(|folder| read_npy(&at(folder).join(format!("{stamp}_depth.npy")), 1.0).unwrap());
        let pairs = one.values().iter().zip(other.values());
        let off = pairs.map(|(a, b)| (a - b).abs() / a).sum::<f32>() / one.values().len() as f32;
        assert!(off < 1e-3, "{stamp}: {off}");
    }
    // A recording gets the same bits, also if the run was killed.
    let bag = [
        "complete",
        &drive,
        "-o",
        "out.mcap",
        "--views",
        "--weights",
        "small",
    ];
    lsdc(folder.path()).args(bag).assert().success();
    let mut found = 0;
    let visited = Recording::open(&at("out.mcap"))
        .unwrap()
        .visit(&|_| true, &mut |_, message| {
            let stamp = Header::of(message.data).unwrap().stamp;
            let depth = read_npy(&at(&format!("out/{stamp}_depth.npy")), 1.0).unwrap();
            let bytes = depth.values().iter().flat_map(|depth| depth.to_le_bytes());
            assert!(message.data.ends_with(&bytes.collect::<Vec<u8>>()));
            found += 1;
            Ok(())
        });
    visited.unwrap();
    assert_eq!(found, 4);
    let mut again = recorded.clone();
    again[3] = "killed";
    kill_after_a_frame(folder.path(), &again);
    reports(folder.path(), &again);
    assert!(maps(&at("out")) == maps(&at("killed")));
    // In two shards.
    again[3] = "parts";
    for shard in ["0/2", "1/2"] {
        reports(folder.path(), &[&again[..], &["--shard", shard]].concat());
    }
    assert!(maps(&at("out")) == maps(&at("parts")));
}

/// Two images with the same cloud are not neighbours, because its points were measured once.
#[test]
fn points_of_a_cloud_are_carried_once() {
    let folder = tempfile::tempdir().unwrap();
    let drive = drive();
    let run = [
        "complete",
        &drive,
        "-o",
        "out",
        "--views",
        "--tolerance",
        "0.1",
        "--formats",
        "npy",
        "--json",
        "--weights",
        "small",
    ];
    let (frames, told) = reports(folder.path(), &run);
    assert_eq!(frames.len(), 5, "{told}");
    let shared = ["1700000000200000000", "1700000000300000000"];
    for frame in &frames {
        let image = frame["image"].as_str().unwrap();
        let others = frame["views"]["images"].as_array().unwrap();
        let others: Vec<&str> = others
            .iter()
            .map(|view| view["image"].as_str().unwrap())
            .collect();
        // The later image is 80 ms from the cloud, the earlier one 20 ms.
        assert!(!others.contains(&shared[1]), "{frame}");
        assert_eq!(
            others.contains(&shared[0]),
            !shared.contains(&image),
            "{frame}"
        );
    }
}

#[test]
fn images_of_a_recording_without_a_pose_are_completed_alone() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let drive = drive();
    // Poses without rotation: wrong, but present.
    let trajectory =
        "1700000000.1 0 0 0 0 0 0 1\n1700000000.2 1 0 0 0 0 0 1\n1700000000.4 3 0 0 0 0 0 1\n";
    std::fs::write(at.join("poses.txt"), trajectory).unwrap();
    let usual = ["--formats", "npy", "--json", "--weights", "small"];
    let run = [
        &["complete", &drive, "-o", "out", "--views=poses.txt"][..],
        &usual,
    ]
    .concat();
    let (frames, told) = reports(at, &run);
    assert!(told.contains("3 images in poses.txt"), "{told}");
    assert!(
        told.contains("1 image without a pose") && told.contains("1700000000500000000"),
        "{told}"
    );
    for frame in &frames {
        let is_last = frame["image"] == "1700000000500000000";
        assert_eq!(frame["views"].is_null(), is_last, "{frame}");
    }
    // The contents of the trajectory matter, not its name.
    let moved = trajectory.replace("0.4 3", "0.4 4");
    std::fs::write(at.join("poses.txt"), moved).unwrap();
    refused(at, &run, &["poses.txt` has changed"]);
    std::fs::write(at.join("poses.txt"), "5 0 0 0 0 0 0 1\n").unwrap();
    let run = [
        &["complete", &drive, "-o", "more", "--views=poses.txt"][..],
        &usual,
    ]
    .concat();
    refused(at, &run, &["none of 4 images has a pose"]);
    let turn = drive.replace("drive.mcap", "turn.mcap");
    let still = [
        "complete",
        &turn,
        "--points",
        "/hesai/points",
        "--tf",
        "/tf_static",
        "-o",
        "more",
        "--views",
    ];
    refused(at, &still, &["no transforms that move lead", "trajectory"]);
}
