//! Results are not lost, damaged or written where they were not requested.

use super::*;
use lsdc_eval::data::{Unit, read_depth_png, stored_unit};

/// Writes the points of the room with depths multiplied by `factor`.
fn scaled(folder: &Path, factor: f32) -> DepthMap {
    let sparse = read_npy(&folder.join("sparse.npy"), 1.0).unwrap();
    let values = sparse.values().iter().map(|d| d * factor).collect();
    let scaled = DepthMap::new(sparse.width(), sparse.height(), values).unwrap();
    write_npy(&folder.join("scaled.npy"), &scaled).unwrap();
    scaled
}

#[test]
fn depths_beyond_65_metres_are_not_zeros_in_a_png() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let linear = ["rgb.png", "scaled.npy", "--method", "nearest", "--json"];
    for (factor, per_metre, name) in [
        (1.0, 1000.0, "millimetres"),
        (20.0, 256.0, "1/256 m"),
        (50.0, 100.0, "centimetres"),
        (0.0001, 1e6, "1/1000000 m"),
    ] {
        scaled(folder.path(), factor);
        let out = format!("out{per_metre}");
        let run = lsdc(folder.path())
            .arg("complete")
            .args(linear)
            .args(["-o", &out])
            .assert()
            .success();
        let said: serde_json::Value = serde_json::from_str(&text(&run)).unwrap();
        assert_eq!(said["png_units_per_metre"], per_metre);
        let path = at(&out).join("rgb_depth.png");
        assert_eq!(stored_unit(&path), Unit::per_metre(per_metre));
        let png = read_depth_png(&path, 1.0 / per_metre).unwrap();
        let npy = read_npy(&at(&out).join("rgb_depth.npy"), 1.0).unwrap();
        assert_eq!(png.count(), npy.count());
        for (a, b) in png.values().iter().zip(npy.values()) {
            assert!(f64::from((a - b).abs()) <= 0.501 / per_metre, "{a} {b}");
        }
        // Read again without a given unit, the map is the same.
        let again = path.to_str().unwrap();
        let again = [
            "complete", "rgb.png", again, "--method", "nearest", "--json", "-o", "again",
        ];
        let run = lsdc(folder.path()).args(again).arg("--force").assert();
        let said: serde_json::Value = serde_json::from_str(&text(&run.success())).unwrap();
        assert_eq!(said["points"]["unit"], name);
        assert_eq!(said["points"]["unit_guessed"], false);
        assert_eq!(read_npy(&at("again/rgb_depth.npy"), 1.0).unwrap(), png);
    }
    scaled(folder.path(), 20.0);
    let told = ["rgb.png", "scaled.npy", "--method", "nearest", "-o", "told"];
    let run = lsdc(folder.path()).arg("complete").args(told).assert();
    assert!(text(&run.success()).contains("png       1/256 m"));
    scaled(folder.path(), 1e6);
    let far = [&["complete"], &linear[..], &["-o", "far"]].concat();
    refused(
        folder.path(),
        &far,
        &["does not fit into a 16-bit PNG", "hint:"],
    );
}

#[test]
fn a_pipe_takes_one_file_of_one_image() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("points")).unwrap();
    std::fs::copy(at("sparse.npy"), at("points/rgb.npy")).unwrap();
    std::fs::write(at("list.txt"), "rgb.png sparse.npy\n").unwrap();
    for images in ["list.txt", "rg*.png", "."] {
        let args = ["complete", images, "points", "-o", "-"];
        refused(
            folder.path(),
            &args,
            &["only one file fits", "several images"],
        );
    }
    for more in [
        &["--uncertainty"][..],
        &["--outliers"],
        &["--json"],
        &["--formats", "npy,png"],
        &["--uncertainty", "--formats", "tiff"],
    ] {
        let args = [&["complete", "rgb.png", "sparse.npy", "-o", "-"], more].concat();
        refused(folder.path(), &args, &["only one file fits", "hint:"]);
    }
    // An archive holds both.
    let both = [
        "rgb.png",
        "sparse.npy",
        "-o",
        "-",
        "--uncertainty",
        "--formats",
        "npz",
    ];
    let run = lsdc(folder.path())
        .arg("complete")
        .args(both)
        .assert()
        .success();
    std::fs::write(at("both.npz"), &run.get_output().stdout).unwrap();
    let size = (304, 228);
    let found = lsdc_eval::data::Sparse::read(&at("both.npz"), None, None, size).unwrap();
    assert_eq!(found.points.len(), 304 * 228);
    assert!(found.points.iter().all(|point| point.sigma.is_some()));
}

#[test]
fn an_unknown_ending_makes_no_folder() {
    let folder = room();
    std::fs::create_dir(folder.path().join("points")).unwrap();
    for output in ["x.jpg", "depth.h5", "below/x.jpeg"] {
        let args = ["complete", "rgb.png", "sparse.npy", "-o", output];
        refused(folder.path(), &args, &["no known format", ".npy", "hint:"]);
        let many = ["complete", ".", "points", "-o", output];
        refused(folder.path(), &many, &["no known format"]);
    }
    for (output, file) in [("run.1", "run.1"), ("x.jpg/", "x.jpg")] {
        lsdc(folder.path())
            .args([
                "complete",
                "rgb.png",
                "sparse.npy",
                "--method",
                "nearest",
                "-o",
                output,
            ])
            .assert()
            .success();
        assert!(folder.path().join(file).join("rgb_depth.npy").is_file());
    }
}

#[test]
fn an_output_that_cannot_be_written_is_noticed_before_anything_is_computed() {
    let folder = room();
    std::fs::create_dir(folder.path().join("points")).unwrap();
    std::fs::copy(
        folder.path().join("sparse.npy"),
        folder.path().join("points/rgb.npy"),
    )
    .unwrap();
    std::fs::write(folder.path().join("file"), "in the way").unwrap();
    for input in [["rgb.png", "missing.npy"], [".", "points"]] {
        let run = lsdc(folder.path())
            .arg("complete")
            .args(input)
            .args(["-o", "file/out"])
            .assert()
            .code(1);
        let said = String::from_utf8(run.get_output().stderr.clone()).unwrap();
        assert!(said.contains("cannot write `file/out`"), "{said}");
        assert_eq!(said.matches("error:").count(), 1, "{said}");
    }
}

#[test]
fn a_range_of_negative_depths_is_refused() {
    let folder = room();
    for range in [
        "--range=-1,3",
        "--range=3,1",
        "--range=0,inf",
        "--range=nan,3",
    ] {
        let args = ["complete", "rgb.png", "sparse.npy", range];
        refused(folder.path(), &args, &["no range of depths"]);
    }
}

#[test]
fn a_size_that_no_memory_holds_is_refused() {
    let folder = room();
    let args = ["complete", "rgb.png", "sparse.npy", "--size", "65536x65536"];
    refused(folder.path(), &args, &["65536x65536 pixels are too many"]);
}

#[test]
fn options_that_would_change_nothing_are_refused() {
    let folder = room();
    for (options, words) in [
        (
            &["--range=0,3", "--formats=npy"][..],
            ["`--range`", "colour maps"],
        ),
        (
            &["--method=linear", "--max-sigma=0.1"],
            ["`--max-sigma`", "need method `lsdc`"],
        ),
        (
            &["--method=linear", "--robust=huber"],
            ["`--robust`", "need method `lsdc`"],
        ),
        (
            &["--method=linear", "--full"],
            ["`--full`", "need method `lsdc`"],
        ),
        (
            &["--method=linear", "--quality=best"],
            ["`--quality`", "need method `lsdc`"],
        ),
        (
            &["--weights=none", "--quality=best"],
            ["`--quality best`", "without a network"],
        ),
    ] {
        let args = [&["complete", "rgb.png", "sparse.npy"], options].concat();
        refused(folder.path(), &args, &words);
    }
}

#[cfg(unix)]
fn shell(folder: &Path, command: &str) -> std::process::Command {
    let mut shell = std::process::Command::new("sh");
    shell
        .args(["-c", command])
        .current_dir(folder)
        .env("LSDC", env!("CARGO_BIN_EXE_lsdc"));
    shell
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_standard_output_is_an_error() {
    let folder = room();
    let complete = "$LSDC complete rgb.png sparse.npy --method nearest";
    for (command, code) in [
        (format!("{complete} --json > /dev/full"), 1),
        (format!("{complete} -o - > /dev/full"), 1),
        ("$LSDC weights list > /dev/full".to_owned(), 1),
        (format!("{complete} --json > /dev/null"), 0),
    ] {
        let run = shell(folder.path(), &command).output().unwrap();
        let said = String::from_utf8(run.stderr).unwrap();
        assert_eq!(run.status.code(), Some(code), "{command}: {said}");
        assert_eq!(
            code == 1,
            said.contains("cannot write to standard output"),
            "{said}"
        );
    }
    // The reader of a pipe may stop early.
    let command = format!("{{ {complete} --json; echo $? > code; }} | true");
    shell(folder.path(), &command).status().unwrap();
    let code = std::fs::read_to_string(folder.path().join("code")).unwrap();
    assert_eq!(code.trim(), "0");
}

/// A signal that was ignored when the program started, as under nohup, does not end it.
#[cfg(unix)]
#[test]
fn a_hangup_does_not_end_what_was_started_with_nohup() {
    let folder = tempfile::tempdir().unwrap();
    // The tests may run under nohup, which no shell can undo.
    let usual = if cfg!(target_os = "linux") {
        "env --default-signal=HUP"
    } else {
        ""
    };
    let eval = |way: &str| {
        format!(
            "exec {way} $LSDC eval --dataset rooms --set data.rooms.width=64 \
             --set data.rooms.height=48 --method linear --seeds 20 -o run"
        )
    };
    let ignored = format!("trap '' HUP; {}", eval(""));
    for (command, code) in [(ignored, 0), (eval(usual), 130)] {
        let _ = std::fs::remove_dir_all(folder.path().join("run"));
        let mut run = shell(folder.path(), &command)
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        // Two lines in the journal show that the run has begun.
        let journal = folder.path().join("run/journal.jsonl");
        let lines = || {
            let text = std::fs::read_to_string(&journal).unwrap_or_default();
            text.matches('\n').count()
        };
        while lines() < 2 && run.try_wait().unwrap().is_none() {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let kill = format!("kill -HUP {}", run.id());
        assert!(shell(folder.path(), &kill).status().unwrap().success());
        assert_eq!(run.wait().unwrap().code(), Some(code), "{command}");
    }
}

/// Links are kept and their targets written; a dangling link counts as an existing file.
#[test]
#[cfg(unix)]
fn results_go_through_links() {
    use std::os::unix::fs::symlink;
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("kept")).unwrap();
    std::fs::write(at("kept/v3.safetensors"), b"old").unwrap();
    symlink("kept/v3.safetensors", at("latest.safetensors")).unwrap();
    symlink("kept/next.npy", at("depth.npy")).unwrap();
    symlink("kept/report.json", at("report.json")).unwrap();
    let convert = ["weights", "convert", "small", "latest.safetensors"];
    let complete = [
        "complete",
        "rgb.png",
        "sparse.npy",
        "-o",
        "depth.npy",
        "--method",
        "nearest",
    ];
    let eval = [
        "eval",
        "--dataset",
        "rooms",
        "--set",
        "data.rooms.width=64",
        "--set",
        "data.rooms.height=48",
        "--limit",
        "1",
        "--method",
        "nearest",
        "--json",
        "report.json",
    ];
    for (command, link) in [
        (&convert[..], "latest.safetensors"),
        (&complete, "depth.npy"),
        (&eval, "report.json"),
    ] {
        refused(folder.path(), command, &["exists", "--force"]);
        lsdc(folder.path())
            .args(command)
            .arg("--force")
            .assert()
            .success();
        assert!(at(link).is_symlink(), "{link}");
    }
    assert_eq!(
        names(&at("kept")),
        ["next.npy", "report.json", "v3.safetensors"]
    );
    assert!(std::fs::read(at("kept/v3.safetensors")).unwrap().len() > 1 << 20);
    assert!(read_npy(&at("kept/next.npy"), 1.0).is_ok());
}

/// A named pipe receives the result and remains a pipe.
#[test]
#[cfg(unix)]
fn results_go_into_pipes() {
    use std::os::unix::fs::FileTypeExt as _;
    let folder = room();
    let pipe = folder.path().join("depth.npy");
    let made = std::process::Command::new("mkfifo")
        .arg(&pipe)
        .status()
        .unwrap();
    assert!(made.success());
    let reader = std::thread::spawn({
        let pipe = pipe.clone();
        move || std::fs::read(pipe).unwrap()
    });
    let complete = [
        "complete",
        "rgb.png",
        "sparse.npy",
        "--method",
        "nearest",
        "-o",
    ];
    lsdc(folder.path())
        .args(complete)
        .arg("depth.npy")
        .assert()
        .success();
    lsdc(folder.path())
        .args(complete)
        .arg("file.npy")
        .assert()
        .success();
    let file = std::fs::read(folder.path().join("file.npy")).unwrap();
    assert_eq!(reader.join().unwrap(), file);
    assert!(pipe.metadata().unwrap().file_type().is_fifo());
}
