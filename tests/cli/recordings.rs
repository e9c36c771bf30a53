//! Recordings: `lsdc inspect` and `lsdc complete`.

use super::*;
use lsdc_eval::data::write_rgb;
use lsdc_recordings::{FrameOptions, Frames, Header, Recording};
use std::fmt::Write as _;

fn golden(name: &str) -> String {
    let place = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/recordings");
    place.join(name).display().to_string()
}

fn told(run: &assert_cmd::assert::Assert, words: &[&str]) {
    let output = run.get_output();
    let text = [&output.stdout[..], &output.stderr].concat();
    let text = String::from_utf8(text).unwrap();
    for word in words {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
}

#[test]
fn recordings_are_inspected() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let run = lsdc(at)
        .args(["inspect", &golden("drive.mcap")])
        .assert()
        .success();
    told(
        &run,
        &[
            "5 topics, 30 messages",
            "duration  0.604 s",
            "20.00 Hz",
            "/camera/image_raw/compressed",
        ],
    );
    let run = lsdc(at)
        .args(["inspect", "--json", &golden("bag")])
        .assert()
        .success();
    let value: serde_json::Value = serde_json::from_slice(&run.get_output().stdout).unwrap();
    assert_eq!(value["topics"].as_array().unwrap().len(), 37);
    assert!(value["cut_off"].is_null());
    let bytes = std::fs::read(golden("drive.mcap")).unwrap();
    std::fs::write(at.join("cut.mcap"), &bytes[..bytes.len() / 2]).unwrap();
    let run = lsdc(at).args(["inspect", "cut.mcap"]).assert().success();
    told(&run, &["the recording is cut off"]);
}

/// Each image is either completed or counted as left out, and results equal those from files.
#[test]
fn a_folder_holds_what_files_of_the_same_frames_give() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let run = [
        "complete",
        &golden("drive.mcap"),
        "-o",
        "out",
        "--formats",
        "npy",
    ];
    let first = lsdc(folder.path()).args(run).assert().success();
    told(
        &first,
        &[
            "6 images: 4 with points, 2 left out",
            "0.080 s away",
            "4 completed, 0 there already, 0 failed",
        ],
    );
    std::fs::remove_file(at("out/1700000000400000000_depth.npy")).unwrap();
    let again = lsdc(folder.path()).args(run).assert().success();
    told(&again, &["1 completed, 3 there already, 0 failed"]);

    let mut recording = Recording::open(Path::new(&golden("drive.mcap"))).unwrap();
    let frames = Frames::of(&mut recording, &FrameOptions::default()).unwrap();
    for folder in ["images", "points"] {
        std::fs::create_dir(at(folder)).unwrap();
    }
    for frame in &frames.found {
        let loaded = frames
            .read(&mut recording, frame)
            .unwrap()
            .decode(&frames)
            .unwrap();
        write_rgb(&at(&format!("images/{}.png", frame.stamp)), &loaded.image).unwrap();
        let mut lines = "u,v,depth\n".to_owned();
        for point in &loaded.points.points {
            let _ = writeln!(lines, "{},{},{}", point.u, point.v, point.depth);
        }
        std::fs::write(at(&format!("points/{}.csv", frame.stamp)), lines).unwrap();
    }
    let files = [
        "complete",
        "images",
        "points",
        "-o",
        "files",
        "--formats",
        "npy",
    ];
    lsdc(folder.path()).args(files).assert().success();
    assert_eq!(names(&at("files")), names(&at("out")));
    for name in names(&at("files")) {
        let [one, other] =
            ["files", "out"].map(|folder| read_npy(&at(folder).join(&name), 1.0).unwrap());
        assert!(one == other, "{name}");
    }
}

#[test]
fn a_recording_goes_into_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let source = golden("drive.mcap");
    lsdc(folder.path())
        .args(["complete", &source, "-o", "out", "--formats", "npy"])
        .assert()
        .success();
    let run = [
        "complete",
        &source,
        "-o",
        "out.mcap",
        "--copy",
        "--cloud",
        "--uncertainty",
    ];
    let written = lsdc(folder.path()).args(run).assert().success();
    told(
        &written,
        &[
            "6 images: 4 with points, 2 left out",
            "4 completed, 0 there already, 0 failed",
        ],
    );
    refused(folder.path(), &run, &["exists", "--force"]);

    let read = |path: &Path| {
        let mut found = Vec::new();
        let visited = Recording::open(path)
            .unwrap()
            .visit(&|_| true, &mut |topic, message| {
                found.push((topic.name.clone(), message.times.log, message.data.to_vec()));
                Ok(())
            });
        assert_eq!(visited.unwrap(), lsdc_recordings::Defects::default());
        found
    };
    let found = read(&at("out.mcap"));
    let copied: Vec<_> = found
        .iter()
        .filter(|(name, ..)| !name.starts_with("/lsdc/"))
        .cloned()
        .collect();
    assert!(copied == read(Path::new(&source)));
    let depths: Vec<_> = found
        .iter()
        .filter(|(name, ..)| name == "/lsdc/depth")
        .collect();
    assert_eq!(depths.len(), 4);
    for (place, (name, time, data)) in found.iter().enumerate() {
        if name != "/lsdc/depth" {
            continue;
        }
        // Each depth follows its image, with the same time, stamp and frame.
        assert_eq!(
            (found[place - 1].0.as_str(), found[place - 1].1),
            ("/camera/image_raw/compressed", *time)
        );
        assert_eq!(
            (found[place + 1].0.as_str(), found[place + 2].0.as_str()),
            ("/lsdc/sigma", "/lsdc/points")
        );
        let header = Header::of(data).unwrap();
        assert_eq!(header, Header::of(&found[place - 1].2).unwrap());
        let depth = read_npy(&at(&format!("out/{}_depth.npy", header.stamp)), 1.0).unwrap();
        let bytes: Vec<u8> = depth
            .values()
            .iter()
            .flat_map(|depth| depth.to_le_bytes())
            .collect();
        assert!(data.ends_with(&bytes));
    }
    let millimetres = ["complete", &source, "-o", "mm.mcap", "--units", "mm"];
    lsdc(folder.path()).args(millimetres).assert().success();
    let found = read(&at("mm.mcap"));
    assert_eq!(found.len(), 4);
    assert_eq!(
        found[0].2.len() - 96 * 72 * 2,
        depths[0].2.len() - 96 * 72 * 4
    );
    assert_eq!(names(folder.path()), ["mm.mcap", "out", "out.mcap"]);
}

/// Points are taken at their own times and left out without one, and both are reported; on request, all are taken at the stamp
/// of the cloud.
#[test]
fn what_becomes_of_turns_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let turn = golden("turn.mcap");
    let run = |points: &str, more: &[&str], words: &[&str]| {
        let args = [&["complete", &turn, "--points", points, "-o", "out"], more].concat();
        let run = lsdc(folder.path()).args(args).assert().success();
        told(&run, words);
    };
    run(
        "/ouster/points",
        &["--formats", "npy"],
        &[
            "each point counts at its own time: `t`, 0.0790 s",
            "2 completed, 0 there already, 0 failed",
            "234 without a time, or transforms at it",
        ],
    );
    // The results differ: the earlier ones are not reused.
    run(
        "/ouster/points",
        &["--formats", "npy", "--no-deskew", "--force"],
        &[
            "deskewed  no: all points of a cloud count at its stamp",
            "2 completed, 0 there already, 0 failed",
        ],
    );
    run(
        "/hesai/points",
        &["--formats", "npy", "--tf", "/tf_static", "--force"],
        &["warning: the points have times of their own (`timestamp`), but no transforms that move"],
    );
}

#[test]
fn what_is_wrong_is_said() {
    let folder = room();
    let drive = golden("drive.mcap");
    let refused = |args: &[&str], words: &[&str]| {
        let args = [&["complete"], args].concat();
        super::refused(folder.path(), &args, words);
    };
    refused(
        &[&drive, "--image", "/left", "-o", "out"],
        &["no topic `/left`", "/camera/image_raw/compressed"],
    );
    refused(
        &[&golden("bag"), "-o", "out"],
        &["several topics", "--points", "/points/plain"],
    );
    refused(&[&drive], &["-o DIR"]);
    refused(&[&drive, "-o", "out", "--copy"], &["`--copy`", ".mcap"]);
    refused(
        &[&drive, "-o", "out.mcap", "--formats", "npy"],
        &["`--formats`", "-o DIR"],
    );
    refused(&[&drive, "-o", "out", "--temporal"], &["`--temporal`"]);
    refused(
        &["rgb.png", "sparse.npy", "--image", "/left"],
        &["`--image` is for a recording"],
    );
    refused(
        &["rgb.png", "sparse.npy", "--no-deskew"],
        &["`--no-deskew` is for a recording"],
    );
    refused(
        &["rgb.png"],
        &["is no recording", "an image and its points"],
    );
    refused(
        &[&drive, "-o", "out", "--tolerance", "0"],
        &["none of the 6 images", "--tolerance"],
    );
    refused(&["missing.mcap", "-o", "out"], &["missing.mcap"]);
}
