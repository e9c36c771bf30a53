//! The program as a user runs it.

#![allow(clippy::unwrap_used)]

use assert_cmd::Command;
use lsdc::data::{DepthMap, read_npy, write_npy};
use std::path::{Path, PathBuf};

fn lsdc(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lsdc"));
    command
        .current_dir(folder)
        .env_remove("LSDC_DATA")
        .env_remove("LSDC_DEVICE");
    command
}

fn asset(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("assets/room")
        .join(name)
}

/// A scratch folder with the rendered room.
fn room() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["rgb.png", "sparse.npy"] {
        std::fs::copy(asset(name), folder.path().join(name)).unwrap();
    }
    folder
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Runs a command that must fail with exit code 2, one `error:` line with `words`, and no output.
fn refused(folder: &Path, args: &[&str], words: &[&str]) {
    let before = names(folder);
    let output = lsdc(folder).args(args).output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {text}");
    assert!(!text.contains("panicked"), "{text}");
    for word in words {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
    assert_eq!(names(folder), before, "{args:?} left files behind");
}

#[test]
fn complete_writes_depth_as_npy_and_two_pictures() {
    let folder = room();
    let run = lsdc(folder.path())
        .args(["complete", "rgb.png", "sparse.npy"])
        .assert()
        .success();
    let text = String::from_utf8(run.get_output().stdout.clone()).unwrap();
    for word in [
        "points    500",
        "depth",
        "residual",
        "left out",
        "network",
        "fit",
        "dense",
    ] {
        assert!(text.contains(word), "{text}");
    }
    assert_eq!(
        names(folder.path()),
        [
            "rgb.png",
            "rgb_depth.npy",
            "rgb_depth.png",
            "rgb_depth_color.png",
            "sparse.npy"
        ]
    );
    let depth = read_npy(&folder.path().join("rgb_depth.npy"), 1.0).unwrap();
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    assert_eq!(
        (depth.width(), depth.height()),
        (truth.width(), truth.height())
    );
    assert_eq!(depth.count(), depth.values().len());
    let png = lsdc::data::read_depth_png(&folder.path().join("rgb_depth.png"), 0.001).unwrap();
    for (a, b) in png.values().iter().zip(depth.values()) {
        assert!((a - b).abs() <= 0.00051, "{a} {b}");
    }
    // The same again is no conflict; another result is.
    lsdc(folder.path())
        .args(["complete", "rgb.png", "sparse.npy"])
        .assert()
        .success();
    let other = ["complete", "rgb.png", "sparse.npy", "--method", "linear"];
    refused(folder.path(), &other, &["exists", "--force"]);
    lsdc(folder.path())
        .args(other)
        .arg("--force")
        .assert()
        .success();
}

#[test]
fn every_instruction_set_gives_the_same_depths() {
    let folder = room();
    let mut results = Vec::new();
    for level in lsdc::simd::Level::ALL {
        if !level.is_available() {
            continue;
        }
        let run = lsdc(folder.path())
            .env("LSDC_SIMD", level.name())
            .args(["bench", "--json", "--runs", "1", "--size", "64x48"])
            .assert()
            .success();
        let text = String::from_utf8(run.get_output().stdout.clone()).unwrap();
        let bench: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(bench["instructions"], level.name());
        lsdc(folder.path())
            .env("LSDC_SIMD", level.name())
            .args(["complete", "rgb.png", "sparse.npy", "-o", level.name()])
            .assert()
            .success();
        let path = folder.path().join(level.name()).join("rgb_depth.npy");
        results.push(read_npy(&path, 1.0).unwrap());
    }
    for other in &results[1..] {
        for (a, b) in results[0].values().iter().zip(other.values()) {
            assert!((a - b).abs() < 1e-4 * a, "{a} {b}");
        }
    }
}

#[test]
fn any_output_size_works() {
    let folder = room();
    let args = [
        "complete",
        "rgb.png",
        "sparse.npy",
        "-o",
        "out",
        "--size",
        "401x299",
    ];
    lsdc(folder.path()).args(args).assert().success();
    let depth = read_npy(&folder.path().join("out/rgb_depth.npy"), 1.0).unwrap();
    assert_eq!((depth.width(), depth.height()), (401, 299));
}

#[test]
fn scaling_the_points_scales_the_result() {
    let folder = room();
    let sparse = read_npy(&asset("sparse.npy"), 1.0).unwrap();
    let completed = |factor: f32, flags: &[&str]| {
        let scaled = sparse.values().iter().map(|v| v * factor).collect();
        let scaled = DepthMap::new(sparse.width(), sparse.height(), scaled).unwrap();
        write_npy(&folder.path().join("scaled.npy"), &scaled).unwrap();
        lsdc(folder.path())
            .args(["complete", "rgb.png", "scaled.npy", "-o", "out", "--force"])
            .args(flags)
            .assert()
            .success();
        read_npy(&folder.path().join("out/rgb_depth.npy"), 1.0).unwrap()
    };
    for flags in [&[][..], &["--prior", "none"], &["--space", "log"]] {
        let plain = completed(1.0, flags);
        for factor in [0.1, 3.7, 10.0] {
            let scaled = completed(factor, flags);
            for (a, b) in plain.values().iter().zip(scaled.values()) {
                assert!(
                    (a * factor - b).abs() <= 1e-5 * b,
                    "{flags:?} {factor}: {a} {b}"
                );
            }
        }
    }
}

#[test]
fn any_number_of_points_will_do() {
    let folder = room();
    let sparse = read_npy(&asset("sparse.npy"), 1.0).unwrap();
    for count in [1, 2, 7, 60] {
        let points: Vec<_> = sparse.points().take(count).collect();
        let few = DepthMap::from_points(sparse.width(), sparse.height(), &points);
        write_npy(&folder.path().join("few.npy"), &few).unwrap();
        lsdc(folder.path())
            .args([
                "complete",
                "rgb.png",
                "few.npy",
                "-o",
                "out",
                "--force",
                "--uncertainty",
            ])
            .assert()
            .success();
        let depth = read_npy(&folder.path().join("out/rgb_depth.npy"), 1.0).unwrap();
        let sigma = read_npy(&folder.path().join("out/rgb_sigma.npy"), 1.0).unwrap();
        let pixels = sparse.width() * sparse.height();
        assert_eq!(
            (depth.count(), sigma.count()),
            (pixels, pixels),
            "{count} points"
        );
        if count == 1 {
            // The mean map, scaled to meet the point.
            let (found, p) = (depth.at(points[0].x, points[0].y), points[0].depth);
            assert!((found - p).abs() < 1e-4 * p, "{found} {p}");
        }
    }
}

#[test]
fn points_can_be_kept_judged_and_weighted() {
    let folder = room();
    let sparse = read_npy(&asset("sparse.npy"), 1.0).unwrap();
    let (width, height) = (sparse.width(), sparse.height());
    let wrong = sparse.points().nth(77).unwrap();
    let mut values = sparse.values().to_vec();
    values[wrong.y * width + wrong.x] *= 2.0;
    let spoiled = DepthMap::new(width, height, values).unwrap();
    write_npy(&folder.path().join("spoiled.npy"), &spoiled).unwrap();
    let run = |out: &str, flags: &[&str]| {
        lsdc(folder.path())
            .args(["complete", "rgb.png", "spoiled.npy", "-o", out])
            .args(flags)
            .assert()
            .success();
        read_npy(&folder.path().join(out).join("rgb_depth.npy"), 1.0).unwrap()
    };

    let robust = run(
        "robust",
        &["--outliers", "--robust", "tukey", "--uncertainty"],
    );
    let list = std::fs::read_to_string(folder.path().join("robust/rgb_outliers.csv")).unwrap();
    assert!(
        list.starts_with("x,y,depth,depth_by_the_others,score,weight\n"),
        "{list}"
    );
    let line = format!("{},{},", wrong.x, wrong.y);
    let line = list
        .lines()
        .find(|l| l.starts_with(&line))
        .expect("the point is listed");
    let weight: f64 = line.rsplit(',').next().unwrap().parse().unwrap();
    assert!(weight < 0.1, "{line}");
    assert_eq!(names(&folder.path().join("robust")).len(), 5);

    // What is there is not replaced unasked, and nothing is written beside it.
    let list = folder.path().join("robust/rgb_outliers.csv");
    std::fs::write(&list, "mine").unwrap();
    std::fs::remove_file(folder.path().join("robust/rgb_depth.npy")).unwrap();
    lsdc(folder.path())
        .args([
            "complete",
            "rgb.png",
            "spoiled.npy",
            "-o",
            "robust",
            "--outliers",
        ])
        .assert()
        .code(2);
    assert_eq!(std::fs::read_to_string(&list).unwrap(), "mine");
    assert!(!folder.path().join("robust/rgb_depth.npy").exists());

    for how in ["exact", "blend"] {
        let kept = run(how, &["--preserve-input", how]);
        for p in spoiled.points() {
            assert!((kept.at(p.x, p.y) - p.depth).abs() < 1e-4, "{how}");
        }
    }

    // A point with a large deviation counts as if it were not there.
    let sigma = |far: f32| {
        let values = spoiled.values().iter().enumerate().map(|(i, d)| {
            let own = if i == wrong.y * width + wrong.x {
                far
            } else {
                0.01
            };
            if *d > 0.0 { own } else { 0.0 }
        });
        let sigma = DepthMap::new(width, height, values.collect()).unwrap();
        write_npy(&folder.path().join("sigma.npy"), &sigma).unwrap();
        run(
            "sigma",
            &["--sigma", "sigma.npy", "--prior", "none", "--force"],
        )
    };
    let off = |map: &DepthMap| (map.at(wrong.x, wrong.y) - wrong.depth).abs();
    let (ignored, trusted) = (sigma(10.0), sigma(0.01));
    assert!(
        off(&ignored) < 0.9 * off(&trusted),
        "{} {}",
        off(&ignored),
        off(&trusted)
    );
    assert!(off(&robust) < 0.5 * wrong.depth);
    refused(
        folder.path(),
        &[
            "complete",
            "rgb.png",
            "spoiled.npy",
            "--method",
            "wls",
            "--outliers",
        ],
        &["need method `lsdc`"],
    );
}

#[test]
fn depth_is_made_of_base_functions_a_field_or_both() {
    let folder = room();
    let at = folder.path();
    let mut residuals = Vec::new();
    for fit in ["lse", "wls", "joint"] {
        let run = lsdc(at)
            .args([
                "complete",
                "rgb.png",
                "sparse.npy",
                "--fit",
                fit,
                "-o",
                fit,
                "--uncertainty",
            ])
            .assert()
            .success();
        let line = text(&run)
            .lines()
            .find(|l| l.starts_with("residual"))
            .unwrap()
            .to_owned();
        residuals.push(
            line.split_whitespace()
                .nth(1)
                .unwrap()
                .parse::<f64>()
                .unwrap(),
        );
        let sigma = read_npy(&at.join(fit).join("rgb_sigma.npy"), 1.0).unwrap();
        assert_eq!(
            sigma.count(),
            sigma.values().len(),
            "{fit}: a deviation everywhere"
        );
        let sparse = read_npy(&asset("sparse.npy"), 1.0).unwrap();
        // Pixels with a point are known better than those far from one.
        let mean = |known: bool| {
            let pairs = sigma.values().iter().zip(sparse.values());
            let some: Vec<f32> = pairs
                .filter(|(_, d)| (**d > 0.0) == known)
                .map(|p| *p.0)
                .collect();
            some.iter().sum::<f32>() / some.len() as f32
        };
        assert!(mean(true) < mean(false), "{fit}");
    }
    // Base functions miss points, fields meet them.
    assert!(residuals[0] > 10.0 * residuals[1] && residuals[0] > 10.0 * residuals[2]);
    refused(
        at,
        &[
            "complete",
            "rgb.png",
            "sparse.npy",
            "--fit",
            "joint",
            "--space",
            "log",
        ],
        &["fit.space"],
    );
}

#[test]
fn weights_are_listed_described_and_converted() {
    let folder = room();
    let at = folder.path();
    let list = text(&lsdc(at).args(["weights", "list"]).assert().success());
    assert!(list.starts_with("default "), "{list}");
    let info = lsdc(at)
        .args(["weights", "info", "--json"])
        .output()
        .unwrap();
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert!(info["parameters"].as_u64().unwrap() > 100_000, "{info}");
    assert!(info["training"]["steps"].as_u64().unwrap() > 0, "{info}");

    let convert = [
        "weights",
        "convert",
        "default",
        "wide.safetensors",
        "--precision",
        "f32",
    ];
    lsdc(at).args(convert).assert().success();
    refused(at, &convert, &["exists", "--force"]);
    // The wider numbers are the same numbers.
    for (weights, output) in [("default", "a"), ("wide.safetensors", "b")] {
        let complete = [
            "complete",
            "rgb.png",
            "sparse.npy",
            "--weights",
            weights,
            "-o",
            output,
        ];
        lsdc(at).args(complete).assert().success();
    }
    let depth = |folder: &str| read_npy(&at.join(folder).join("rgb_depth.npy"), 1.0).unwrap();
    assert_eq!(depth("a"), depth("b"));
    refused(at, &["weights", "info", "nothing"], &["nothing", "default"]);
}

#[test]
fn bad_input_is_refused_in_one_line() {
    let folder = room();
    let path = |name: &str| folder.path().join(name);
    let map = |values: Vec<f32>, w, h| DepthMap::new(w, h, values).unwrap();
    write_npy(&path("small.npy"), &map(vec![1.0; 30], 6, 5)).unwrap();
    write_npy(&path("none.npy"), &DepthMap::empty(304, 228)).unwrap();
    std::fs::write(path("text.npy"), "no array").unwrap();
    let whole = std::fs::read(asset("rgb.png")).unwrap();
    std::fs::write(path("cut.png"), &whole[..whole.len() / 2]).unwrap();
    let array = std::fs::read(asset("sparse.npy")).unwrap();
    std::fs::write(path("cut.npy"), &array[..array.len() / 2]).unwrap();
    std::fs::write(path("huge.npy"), huge_header()).unwrap();
    std::fs::write(path("bad.toml"), "[train]\nsteps = 3\nspeed = 1\n").unwrap();
    std::fs::write(path("bad.safetensors"), "nothing").unwrap();

    let complete = |rgb, sparse| ["complete", rgb, sparse];
    let at = folder.path();
    refused(
        at,
        &complete("missing.png", "sparse.npy"),
        &["error: cannot read `missing.png`"],
    );
    refused(
        at,
        &complete("rgb.png", "missing.npy"),
        &["error: cannot read `missing.npy`"],
    );
    refused(
        at,
        &complete("rgb.png", "small.npy"),
        &["304x228", "6x5", "hint:"],
    );
    refused(
        at,
        &complete("rgb.png", "none.npy"),
        &["no sparse depth", "hint:"],
    );
    refused(
        at,
        &complete("rgb.png", "text.npy"),
        &["text.npy", "not a NumPy array", "hint:"],
    );
    refused(at, &complete("rgb.png", "cut.npy"), &["cut.npy", "hint:"]);
    refused(at, &complete("rgb.png", "huge.npy"), &["huge.npy", "hint:"]);
    refused(
        at,
        &complete("cut.png", "sparse.npy"),
        &["cut.png", "hint:"],
    );
    refused(
        at,
        &complete("rgb.png", "rgb.png"),
        &["colour image", "hint:"],
    );
    refused(
        at,
        &["complete", "rgb.png", "sparse.npy", "--device", "abacus"],
        &["abacus", "hint:"],
    );
    let weights = [
        "complete",
        "rgb.png",
        "sparse.npy",
        "--weights",
        "bad.safetensors",
    ];
    refused(at, &weights, &["bad.safetensors", "hint:"]);
    refused(at, &["train", "--config", "bad.toml"], &["line 3", "speed"]);
    refused(
        at,
        &["train", "--config", "absent.toml"],
        &["absent.toml", "hint:"],
    );
    refused(
        at,
        &["eval", "--dataset", "rooms", "--points", "grid:0"],
        &["grid:0", "no pattern", "bernoulli-all:N"],
    );
    refused(
        at,
        &["eval", "--dataset", "nyu"],
        &["needs a folder", "--root", "hint:"],
    );
    refused(
        at,
        &["eval", "--dataset", "nyu", "--root", "."],
        &["no `val` frame", "known forms", "hint:"],
    );
}

/// An npy file whose header declares a terabyte.
fn huge_header() -> Vec<u8> {
    let mut header =
        b"{'descr': '<f4', 'fortran_order': False, 'shape': (500000, 500000), }".to_vec();
    header.resize(117, b' ');
    header.push(b'\n');
    let mut file = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    file.extend(header);
    file
}

#[test]
fn values_that_are_no_depth_are_counted_and_ignored() {
    let folder = room();
    let sparse = read_npy(&asset("sparse.npy"), 1.0).unwrap();
    let mut values = sparse.values().to_vec();
    let free: Vec<usize> = (0..values.len())
        .filter(|&i| values[i] == 0.0)
        .take(3)
        .collect();
    for (&i, bad) in free.iter().zip([f32::NAN, f32::INFINITY, -2.0]) {
        values[i] = bad;
    }
    let mut file = Vec::new();
    {
        use npyz::WriterBuilder as _;
        let shape = [sparse.height() as u64, sparse.width() as u64];
        let options = npyz::WriteOptions::new().default_dtype().shape(&shape);
        let mut writer = options.writer(&mut file).begin_nd().unwrap();
        writer.extend(values).unwrap();
        writer.finish().unwrap();
    }
    std::fs::write(folder.path().join("bad.npy"), file).unwrap();
    for (name, out) in [("sparse.npy", "a"), ("bad.npy", "b")] {
        let run = lsdc(folder.path())
            .args(["complete", "rgb.png", name, "-o", out])
            .assert();
        let text = String::from_utf8(run.success().get_output().stdout.clone()).unwrap();
        assert_eq!(
            text.contains("3 NaN, infinite or negative values ignored"),
            out == "b"
        );
    }
    let read = |out: &str| read_npy(&folder.path().join(out).join("rgb_depth.npy"), 1.0).unwrap();
    assert_eq!(read("a"), read("b"));
}

/// `eval` on four small rooms.
const ROOMS: [&str; 9] = [
    "eval",
    "--dataset",
    "rooms",
    "--set",
    "data.rooms.width=96",
    "--set",
    "data.rooms.height=72",
    "--limit",
    "4",
];

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn text(run: &assert_cmd::assert::Assert) -> String {
    String::from_utf8(run.get_output().stdout.clone()).unwrap()
}

#[test]
fn eval_reports_methods_side_by_side() {
    let folder = tempfile::tempdir().unwrap();
    let files = ["--points", "300", "--json", "r.json", "--csv", "r.csv"];
    let run = lsdc(folder.path())
        .args(ROOMS)
        .args(files)
        .assert()
        .success();
    let text = text(&run);
    for word in [
        "rooms val, 4 frames",
        "exactly 300",
        "seed 0",
        "lsdc",
        "linear",
        "RMSE",
        "linear - lsdc",
    ] {
        assert!(text.contains(word), "{word}: {text}");
    }
    let json = json(&folder.path().join("r.json"));
    assert_eq!(json["frames"].as_array().unwrap().len(), 4);
    let mean = |method: &str| json["means"][method]["mean"]["rmse"].as_f64().unwrap();
    let frame = |i: usize| {
        json["frames"][i]["scores"]["linear"]["rmse"]
            .as_f64()
            .unwrap()
    };
    assert!((mean("linear") - (0..4).map(frame).sum::<f64>() / 4.0).abs() < 1e-12);
    assert!(mean("lsdc") > 0.0);
    let csv = std::fs::read_to_string(folder.path().join("r.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 4 * 2);
}

#[test]
fn shards_join_to_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let eval = |args: &[&str]| {
        let methods = ["--method", "linear,nearest", "--seeds", "2"];
        lsdc(folder.path())
            .args(ROOMS)
            .args(methods)
            .args(args)
            .assert()
            .success();
    };
    eval(&["-o", "whole"]);
    eval(&["--shard", "0/2", "--json", "a.json"]);
    eval(&["--shard", "1/2", "-o", "parts"]);
    let merge = [
        "report",
        "merge",
        "parts/1-of-2/report.json",
        "a.json",
        "-o",
        "joined",
    ];
    let run = lsdc(folder.path()).args(merge).assert().success();
    assert!(text(&run).contains("4 frames"));
    assert_eq!(
        json(&at("joined/report.json")),
        json(&at("whole/report.json"))
    );
    let page = std::fs::read_to_string(at("whole/report.html")).unwrap();
    assert!(page.contains("worst: ") && page.contains("data:image/png;base64,"));
    refused(
        folder.path(),
        &["report", "merge", "a.json", "a.json"],
        &["twice", "hint:"],
    );
    refused(folder.path(), &merge, &["exists", "--force"]);
}

#[test]
fn an_evaluation_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let eval = |args: &[&str]| {
        let mut command = lsdc(folder.path());
        command
            .args(ROOMS)
            .args(["--method", "linear", "-o", "run"])
            .args(args);
        command
    };
    eval(&[]).assert().success();
    let report = std::fs::read(folder.path().join("run/report.json")).unwrap();
    let journal = folder.path().join("run/journal.jsonl");
    let lines = std::fs::read_to_string(&journal).unwrap();
    // Killed in the middle of the third frame. What is kept is not measured again: a false number
    // of points in it shows.
    let kept = lines.replacen("\"points\":500", "\"points\":499", 1);
    let cut = kept.match_indices('\n').nth(2).unwrap().0 + 20;
    std::fs::write(&journal, &kept[..cut]).unwrap();
    eval(&[]).assert().success();
    let again = std::fs::read_to_string(folder.path().join("run/report.json")).unwrap();
    assert_eq!(
        again
            .replace("\"points\": 499", "\"points\": 500")
            .into_bytes(),
        report
    );
    assert!(again.contains("\"points\": 499"));
    let other = [
        &ROOMS[..],
        &["--method", "linear", "-o", "run", "--points", "77"],
    ]
    .concat();
    refused(folder.path(), &other, &["another evaluation", "--force"]);
    eval(&["--points", "77", "--force"]).assert().success();
}

#[test]
fn predictions_of_others_are_scored_on_the_same_frames_and_points() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let run = |args: &[&str]| {
        lsdc(folder.path()).args(args).assert().success();
    };
    let eval = |args: &[&str]| run(&[&ROOMS[..], args].concat());
    eval(&[
        "--method",
        "linear",
        "--seeds",
        "2",
        "--json",
        "ours.json",
        "--save",
        "saved",
    ]);
    eval(&[
        "--predictions",
        "theirs=saved/linear",
        "--seeds",
        "2",
        "--json",
        "theirs.json",
    ]);
    let (ours, theirs) = (json(&at("ours.json")), json(&at("theirs.json")));
    assert_eq!(ours["means"]["linear"], theirs["means"]["theirs"]);

    // Exported frames and points measure the same.
    let export = ["export", "--points", "500", "-o", "frames"];
    run(&[&export[..], &ROOMS[1..]].concat());
    eval(&["--method", "linear", "--json", "one.json"]);
    let means = |path: &str| json(&at(path))["means"]["linear"].clone();
    run(&[
        "eval",
        "--dataset",
        "marigold",
        "--root",
        "frames",
        "--method",
        "linear",
        "--json",
        "m.json",
    ]);
    assert_eq!(means("m.json"), means("one.json"));
    eval(&[
        "--method",
        "linear",
        "--points",
        "files:frames/sparse",
        "--json",
        "f.json",
    ]);
    assert_eq!(means("f.json"), means("one.json"));
    let lone = [&ROOMS[..], &["--predictions", "x=nowhere"]].concat();
    refused(folder.path(), &lone, &["no folder `nowhere`"]);
}

#[test]
fn broken_frames_are_reported_and_the_rest_measured() {
    let folder = tempfile::tempdir().unwrap();
    let export = ["export", "-o", "frames"];
    lsdc(folder.path())
        .args(export)
        .args(&ROOMS[1..])
        .assert()
        .success();
    let at = |name: &str| folder.path().join("frames").join(name);
    let image = std::fs::read(at("rgb/val/00000.png")).unwrap();
    std::fs::write(at("rgb/val/00000.png"), &image[..image.len() / 2]).unwrap();
    std::fs::remove_file(at("gt/val/00001.npy")).unwrap();
    std::fs::write(at("sparse/val/00002.npy"), huge_header()).unwrap();
    let eval = [
        "eval",
        "--dataset",
        "marigold",
        "--root",
        "frames",
        "--method",
        "linear",
    ];
    let output = lsdc(folder.path()).args(eval).output().unwrap();
    assert_eq!(output.status.code(), Some(3));
    let errors = String::from_utf8(output.stderr).unwrap();
    for word in ["00000.png", "00001.npy", "00002.npy", "500000x500000"] {
        assert!(errors.contains(word), "{word}: {errors}");
    }
    assert!(
        String::from_utf8(output.stdout)
            .unwrap()
            .contains("1 of 4 frames")
    );
}

/// A folder with images `a.png` and `b/c.png` and their points, one as a list.
fn folders() -> tempfile::TempDir {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(at("images/b")).unwrap();
    std::fs::create_dir_all(at("points/b")).unwrap();
    for image in ["images/a.png", "images/b/c.png"] {
        std::fs::copy(at("rgb.png"), at(image)).unwrap();
    }
    std::fs::copy(at("sparse.npy"), at("points/a.npy")).unwrap();
    let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
    let lines = sparse.points();
    let lines: Vec<String> = lines
        .map(|p| format!("{},{},{}", p.x, p.y, p.depth))
        .collect();
    std::fs::write(at("points/b/c.csv"), lines.join("\n")).unwrap();
    folder
}

#[test]
fn folders_are_completed_and_gone_on_with() {
    let folder = folders();
    let at = |name: &str| folder.path().join(name);
    let run = ["complete", "images", "points", "-o", "out"];
    let told = |code: i32, words: &[&str]| {
        let run = lsdc(folder.path()).args(run).assert().code(code);
        let output = run.get_output();
        let text = [&output.stdout[..], &output.stderr].concat();
        let text = String::from_utf8(text).unwrap();
        for word in words {
            assert!(text.contains(word), "{text}");
        }
    };
    told(0, &["2 completed, 0 there already, 0 failed"]);
    lsdc(folder.path())
        .args(["complete", "rgb.png", "sparse.npy"])
        .assert()
        .success();
    let one = read_npy(&at("rgb_depth.npy"), 1.0).unwrap();
    // A list of the same points is the same map.
    for name in ["out/a_depth.npy", "out/b/c_depth.npy"] {
        assert_eq!(read_npy(&at(name), 1.0).unwrap(), one);
    }

    // A third without points fails, the others are there; then it is all that is left.
    std::fs::copy(at("rgb.png"), at("images/d.png")).unwrap();
    std::fs::copy(at("rgb.png"), at("images/e.png")).unwrap();
    std::fs::write(at("points/e.npy"), b"nothing").unwrap();
    let failed = [
        "2 there already, 2 failed",
        "failed: d.png",
        "failed: e.png",
    ];
    told(3, &failed);
    for name in ["points/d.npy", "points/e.npy"] {
        std::fs::copy(at("sparse.npy"), at(name)).unwrap();
    }
    told(0, &["2 completed, 2 there already, 0 failed"]);

    // What was interrupted between the files of a frame is finished, whichever are missing.
    let formats = ["npy", "npz", "png", "tiff", "exr", "pfm", "color"];
    let every = ["complete", "images", "points", "-o", "every", "--formats"];
    let run = || {
        let run = lsdc(folder.path())
            .args(every)
            .arg(formats.join(","))
            .assert();
        run.success();
    };
    run();
    let whole = names(&at("every"));
    assert_eq!(whole.len(), 3 * formats.len() + 1);
    for name in ["a_depth.npy", "d_depth.tiff", "e_depth_color.png"] {
        std::fs::remove_file(at("every").join(name)).unwrap();
    }
    run();
    assert_eq!(names(&at("every")), whole);

    // Two parts are the whole.
    for part in ["0/2", "1/2"] {
        lsdc(folder.path())
            .args(["complete", "images", "points", "-o", "parts"])
            .args(["--method", "nearest", "--shard", part])
            .assert()
            .success();
    }
    assert_eq!(names(&at("parts")), names(&at("out")));
    assert_eq!(names(&at("parts/b")), names(&at("out/b")));
    refused(
        folder.path(),
        &["complete", "images", "points"],
        &["-o DIR"],
    );
    let none = ["complete", "images", "nowhere", "-o", "more"];
    refused(folder.path(), &none, &["is no folder of points"]);
    std::fs::create_dir(at("empty")).unwrap();
    let none = ["complete", "empty", "points", "-o", "more"];
    refused(folder.path(), &none, &["holds no JPEG or PNG image"]);
}

#[test]
fn every_image_of_a_colmap_model_is_completed() {
    let folder = folders();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("model")).unwrap();
    let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
    // The camera of `a.png` stands at the origin; points lie on its rays, at their depths.
    let (width, height) = (sparse.width(), sparse.height());
    let camera = format!("1 SIMPLE_PINHOLE {width} {height} 200 100 80\n");
    std::fs::write(at("model/cameras.txt"), camera).unwrap();
    let (mut seen, mut points) = (Vec::new(), Vec::new());
    for (i, p) in sparse.points().enumerate() {
        let (u, v, z) = (p.x as f64 + 0.5, p.y as f64 + 0.5, f64::from(p.depth));
        let (x, y) = ((u - 100.0) * z / 200.0, (v - 80.0) * z / 200.0);
        seen.push(format!("{u} {v} {i}"));
        points.push(format!("{i} {x} {y} {z} 0 0 0 0.5 1 0 2 0"));
    }
    let seen = seen.join(" ");
    let images = format!("1 1 0 0 0 0 0 0 1 a.png\n{seen}\n2 1 0 0 0 0 0 0 1 ../a.png\n\n");
    std::fs::write(at("model/images.txt"), images).unwrap();
    std::fs::write(at("model/points3D.txt"), points.join("\n")).unwrap();
    let run = lsdc(folder.path())
        .args(["complete", "images", "model", "-o", "out"])
        .assert()
        .code(3);
    let text = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    assert!(text.contains("its name leads out of the folder"), "{text}");
    let found = read_npy(&at("out/a_depth.npy"), 1.0).unwrap();
    // Errors grow with the depth, so that far points count less than in a map without deviations.
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let pairs = found.values().iter().zip(truth.values());
    let rel: f32 = pairs.map(|(a, b)| (a - b).abs() / b).sum();
    assert!(rel / truth.values().len() as f32 * 100.0 < 10.0, "{rel}");
    assert_eq!(names(&at("out")).len(), 3);
}
