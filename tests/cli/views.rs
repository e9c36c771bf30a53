//! `lsdc complete --views`: points of neighbouring images join by their poses.

use super::*;
use serde_json::Value;
use std::fmt::Write as _;

const WIDTH: usize = 96;
const HEIGHT: usize = 72;
const FRAMES: usize = 4;
const CAMERA: &str = "80,80,47.5,35.5";

/// Where the camera of a frame is: it moves to the right in front of a wall at 3 m, and does not turn.
fn place(frame: usize) -> f64 {
    0.15 * frame as f64
}

/// The depth of a wall with waves, z = 3 + 0.3 sin(1.8 x + 1.5 y), at a pixel of a frame.
fn wall(frame: usize, [u, v]: [usize; 2]) -> f64 {
    let (right, down) = ((u as f64 - 47.5) / 80.0, (v as f64 - 35.5) / 80.0);
    // A contraction: waves are less steep than rays.
    (0..100).fold(3.0, |z, _| relief(place(frame) + right * z, down * z))
}

fn relief(x: f64, y: f64) -> f64 {
    3.0 + 0.3 * (1.8 * x + 1.5 * y).sin()
}

/// Images `N.png`, their points, other places of the wall each, and a trajectory `poses.txt`.
fn sequence() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for part in ["images", "points"] {
        std::fs::create_dir(at(part)).unwrap();
    }
    let mut poses = String::from("# timestamp tx ty tz qx qy qz qw\n");
    for frame in 0..FRAMES {
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

/// The report of each frame, by the name of its image.
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
        // Those of the image itself.
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
    // Two shards are the whole.
    for shard in ["0/2", "1/2"] {
        let all = [args("--views=poses.txt", "parts"), vec!["--shard", shard]].concat();
        reports(folder.path(), &all);
    }
    let parts = names
        .iter()
        .map(|name| bytes(&name.replace("out", "parts")));
    assert!(first == parts.collect::<Vec<_>>());
    // The points of others change the result.
    let (_, _) = reports(folder.path(), &args("--no-alignment", "alone"));
    assert!(bytes("alone/1_depth.npy") != first[1]);
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
    // All four see the last image.
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
    // The third stands a metre before where it was.
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

/// Images of a model share points, which are measured once.
#[test]
fn points_that_images_of_a_model_share_are_counted_once() {
    let folder = sequence();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("model")).unwrap();
    let camera = format!("1 PINHOLE {WIDTH} {HEIGHT} 80 80 48 36\n");
    std::fs::write(at("model/cameras.txt"), camera).unwrap();
    // A grid of points; each image has found every point but another quarter.
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
        // Of the points of the other image a third are new.
        assert!(count("doubled") > 300, "{frame}");
        assert!(
            (50..=200).contains(&views["images"][0]["carried"].as_u64().unwrap()),
            "{frame}"
        );
    }
}
