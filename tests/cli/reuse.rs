//! Earlier results are reused only if the same command would reproduce them.

use super::*;

/// Arguments of `eval` with the small network on two small rooms.
const SMALL: [&str; 11] = [
    "eval",
    "--dataset",
    "rooms",
    "--set",
    "data.rooms.width=64",
    "--set",
    "data.rooms.height=48",
    "--limit",
    "2",
    "--weights",
    "small",
];

fn said(run: &assert_cmd::assert::Assert) -> String {
    String::from_utf8(run.get_output().stderr.clone()).unwrap()
}

#[test]
fn an_evaluation_with_another_fit_does_not_print_the_old_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let fit = ["--set", "fit.joint.cosines=0", "--set", "fit.joint.data=1"];
    let eval = |more: &[&str]| lsdc(at).args(SMALL).args(more).assert();
    let first = eval(&["-o", "run"]).success();
    assert!(!said(&first).contains("earlier run"));
    let again = eval(&["-o", "run"]).success();
    assert!(said(&again).contains("2 results of an earlier run are used again"));
    assert_eq!(text(&first), text(&again));

    let other = [&SMALL[..], &["-o", "run"], &fit].concat();
    refused(at, &other, &["another evaluation", "fit.joint", "--force"]);
    let best = [&SMALL[..], &["-o", "run", "--quality", "best"]].concat();
    refused(at, &best, &["another evaluation", "quality", "best"]);
    let fresh = eval(&[&["-o", "fresh"], &fit[..]].concat()).success();
    let anew = eval(&[&["-o", "run", "--force"], &fit[..]].concat()).success();
    assert_eq!(text(&fresh), text(&anew));
    let rmse = |name: &str| {
        let report = json(&at.join(name));
        report["means"]["lsdc"]["mean"]["rmse"].as_f64().unwrap()
    };
    eval(&["--json", "first.json"]).success();
    assert_ne!(rmse("first.json"), rmse("run/report.json"));
    // The constants of a robust loss are settings as well as its name.
    let robust = |count: &str| {
        let rounds = format!("fit.robust.iterations={count}");
        [
            &SMALL[..],
            &["-o", "robust", "--set", "fit.robust.loss=huber", "--set"],
            &[&rounds],
        ]
        .concat()
        .iter()
        .map(ToString::to_string)
        .collect::<Vec<_>>()
    };
    lsdc(at).args(robust("2")).assert().success();
    let five = robust("5");
    let five: Vec<&str> = five.iter().map(String::as_str).collect();
    refused(at, &five, &["fit.robust.iterations"]);
}

#[test]
fn predictions_that_changed_are_measured_anew() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let eval = |more: &[&str]| lsdc(at).args(ROOMS).args(more).assert();
    eval(&["--method", "linear", "--save", "saved"]).success();
    let scored = ["--predictions", "theirs=saved/linear", "-o", "run"];
    eval(&scored).success();
    eval(&scored).success();
    let path = at.join("saved/linear/seed0/val/00001.npy");
    let depth = read_npy(&path, 1.0).unwrap();
    let twice = depth.values().iter().map(|d| 2.0 * d).collect();
    let twice = DepthMap::new(depth.width(), depth.height(), twice).unwrap();
    write_npy(&path, &twice).unwrap();
    let changed = [&ROOMS[..], &scored].concat();
    refused(at, &changed, &["another evaluation", "theirs.files"]);
    eval(&[&scored[..], &["--force"]].concat()).success();
}

#[test]
fn predictions_without_a_depth_are_failures_not_perfect() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let eval = |more: &[&str]| lsdc(at).args(ROOMS).args(more).assert();
    eval(&["--method", "linear", "--save", "saved"]).success();
    let empty = |name: &str| {
        let path = at.join("saved/linear/seed0/val").join(name);
        let depth = read_npy(&path, 1.0).unwrap();
        write_npy(&path, &DepthMap::empty(depth.width(), depth.height())).unwrap();
    };
    let scored = ["--predictions", "theirs=saved/linear", "--json", "r.json"];
    empty("00000.npy");
    let one = eval(&scored).code(3);
    assert!(said(&one).contains("has no depth where there is a true one"));
    assert_eq!(
        json(&at.join("r.json"))["failures"][0]["frame"],
        "val/00000"
    );
    for name in ["00001.npy", "00002.npy", "00003.npy"] {
        empty(name);
    }
    let all = eval(&["--predictions", "theirs=saved/linear"]).code(2);
    assert!(said(&all).contains("has no depth"));
}

/// A folder of images `a.png`, `b.png` and their points, with results in `out`.
fn completed() -> tempfile::TempDir {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    for part in ["images", "points"] {
        std::fs::create_dir(at(part)).unwrap();
    }
    for name in ["a", "b"] {
        std::fs::copy(at("rgb.png"), at(&format!("images/{name}.png"))).unwrap();
        std::fs::copy(at("sparse.npy"), at(&format!("points/{name}.npy"))).unwrap();
    }
    lsdc(folder.path()).args(COMPLETE).assert().success();
    folder
}

const COMPLETE: [&str; 7] = [
    "complete",
    "images",
    "points",
    "-o",
    "out",
    "--weights",
    "small",
];

#[test]
fn results_of_other_settings_are_not_gone_on_with() {
    let folder = completed();
    let at = folder.path();
    let same = lsdc(at).args(COMPLETE).assert().success();
    assert!(text(&same).contains("0 completed, 2 there already"));
    for (more, word) in [
        (&["--robust", "cauchy"][..], "fit.robust"),
        (&["--weights", "default"], "fit.lambda"),
        (&["--depth-unit", "mm"], "depth_unit"),
        (&["--depth-kind", "z"], "depth_kind"),
        (&["--range", "0,20"], "range"),
        (&["--preserve-input", "exact"], "preserve_input"),
        (&["--quality", "best"], "quality"),
        (&["--method", "linear"], "method"),
    ] {
        let all: Vec<&str> = match more {
            ["--weights", _] => COMPLETE[..5].to_vec(),
            _ => COMPLETE.to_vec(),
        };
        let before = std::fs::read(at.join("out/a_depth.npy")).unwrap();
        let all = [&all[..], more].concat();
        refused(at, &all, &["2 results of other settings", word, "--force"]);
        assert_eq!(before, std::fs::read(at.join("out/a_depth.npy")).unwrap());
    }
    let forced = [&COMPLETE[..], &["--robust", "cauchy", "--force"]].concat();
    lsdc(at).args(forced).assert().success();
    // Formats do not count as different settings.
    let robust = [&COMPLETE[..], &["--robust", "cauchy"]].concat();
    let more = [&robust[..], &["--formats", "npy,pfm"]].concat();
    lsdc(at).args(more).assert().success();
    assert!(at.join("out/b_depth.pfm").exists());
}

#[test]
fn results_of_the_best_quality_are_not_taken_for_standard_ones() {
    let folder = completed();
    let at = folder.path();
    let depth = || read_npy(&at.join("out/a_depth.npy"), 1.0).unwrap();
    let run = |more: &[&str]| {
        let run = lsdc(at).args(COMPLETE).args(more).assert();
        text(&run.success())
    };
    let standard = depth();
    run(&["--quality", "best", "--force"]);
    let best = depth();
    assert_ne!(best, standard);
    let again = run(&["--quality", "best"]);
    assert!(again.contains("0 completed, 2 there already"), "{again}");
    // The record of a standard result does not name its quality.
    let words = [
        "2 results of other settings",
        "quality: \"best\"",
        "--force",
    ];
    refused(at, &COMPLETE, &words);
    assert_eq!(depth(), best);
    let anew = run(&["--force"]);
    assert!(anew.contains("2 completed, 0 there already"), "{anew}");
    assert_eq!(depth(), standard);
}

fn replace(path: &Path, from: &str, to: &str) {
    let text = std::fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{text}");
    std::fs::write(path, text.replace(from, to)).unwrap();
}

#[test]
fn results_of_other_numerics_are_not_gone_on_with() {
    let folder = completed();
    let at = folder.path();
    let again = lsdc(at).args(COMPLETE).assert().success();
    assert!(text(&again).contains("2 there already"));
    // The golden results identify a program that computes other depths.
    let golden = lsdc_weights::golden();
    replace(
        &at.join("out/.lsdc/b.png.json"),
        golden,
        "of another program",
    );
    refused(
        at,
        &COMPLETE,
        &["1 result of", "numerics.golden", "another program"],
    );
    replace(
        &at.join("out/.lsdc/b.png.json"),
        "of another program",
        golden,
    );
    lsdc(at).args(COMPLETE).assert().success();

    let eval = [&SMALL[..], &["-o", "run"]].concat();
    lsdc(at).args(&eval).assert().success();
    replace(&at.join("run/journal.jsonl"), golden, "of another program");
    refused(at, &eval, &["another evaluation", "numerics.golden"]);

    // Results of another instruction set are refused, too.
    if lsdc_kernels::simd::Level::here().name() == "portable" {
        return;
    }
    let mut portable = lsdc(at);
    portable.env("LSDC_SIMD", "portable").args(COMPLETE);
    failed(
        &mut portable,
        2,
        &["2 results", "numerics.simd", "portable"],
    );
}

#[test]
fn results_of_other_points_or_images_are_not_gone_on_with() {
    let folder = completed();
    let at = |name: &str| folder.path().join(name);
    let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
    let few: Vec<_> = sparse.points().take(100).collect();
    let few = DepthMap::from_points(sparse.width(), sparse.height(), &few);
    write_npy(&at("points/b.npy"), &few).unwrap();
    refused(
        folder.path(),
        &COMPLETE,
        &["1 result of other", "b.npy` has changed"],
    );
    let forced = [&COMPLETE[..], &["--force"]].concat();
    lsdc(folder.path()).args(forced).assert().success();
    // A copy with the same bytes counts as the same file.
    let image = std::fs::read(at("images/a.png")).unwrap();
    std::fs::write(at("images/a.png"), &image).unwrap();
    lsdc(folder.path()).args(COMPLETE).assert().success();
    let mut rgb = lsdc_eval::data::read_rgb(&at("images/a.png")).unwrap();
    rgb.put_pixel(3, 4, image::Rgb([1, 2, 3]));
    rgb.save(at("images/a.png")).unwrap();
    refused(folder.path(), &COMPLETE, &["a.png` has changed"]);
}

/// The change shows only in the contents: size and time of the file are the same.
#[test]
fn an_input_that_was_changed_and_dated_back_is_noticed() {
    let folder = completed();
    let at = |name: &str| folder.path().join(name);
    let path = at("points/b.npy");
    let before = std::fs::metadata(&path).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let size = bytes.len();
    let sparse = read_npy(&path, 1.0).unwrap();
    let value = sparse.points().next().unwrap().depth.to_le_bytes();
    let place = bytes.windows(4).position(|four| four == value).unwrap();
    bytes[place..place + 4].copy_from_slice(&3.25_f32.to_le_bytes());
    std::fs::write(&path, &bytes).unwrap();
    let file = std::fs::File::options().write(true).open(&path).unwrap();
    file.set_modified(before.modified().unwrap()).unwrap();
    drop(file);
    let after = std::fs::metadata(&path).unwrap();
    assert_eq!(after.len() as usize, size);
    assert_eq!(after.modified().unwrap(), before.modified().unwrap());
    refused(folder.path(), &COMPLETE, &["b.npy` has changed"]);
}

/// The same numbers are pixels in one format and a cloud in the other.
#[test]
fn an_input_of_another_ending_is_another_input() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    for part in ["images", "points"] {
        std::fs::create_dir(at(part)).unwrap();
    }
    std::fs::copy(at("rgb.png"), at("images/a.png")).unwrap();
    std::fs::write(at("points/a.txt"), "100 80 2.5\n200 30 3\n").unwrap();
    let run = [
        "complete", "images", "points", "-o", "out", "--method", "nearest",
    ];
    lsdc(folder.path()).args(run).assert().success();
    let again = lsdc(folder.path()).args(run).assert().success();
    assert!(text(&again).contains("1 there already"), "{}", text(&again));
    std::fs::rename(at("points/a.txt"), at("points/a.xyz")).unwrap();
    refused(folder.path(), &run, &["a.xyz` has changed"]);
}

/// A dataset whose files have changed since they were measured.
#[test]
fn frames_that_changed_are_not_taken_for_those_that_were_measured() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    export_rooms(at);
    let eval = [&EVAL_EXPORTED[..], &["-o", "run"]].concat();
    lsdc(at).args(&eval).assert().success();
    let again = lsdc(at).args(&eval).assert().success();
    assert!(said(&again).contains("4 results of an earlier run are used again"));
    let path = at.join("frames/gt/val/00001.npy");
    let truth = read_npy(&path, 1.0).unwrap();
    let twice = truth.values().iter().map(|d| 2.0 * d).collect();
    let twice = DepthMap::new(truth.width(), truth.height(), twice).unwrap();
    write_npy(&path, &twice).unwrap();
    refused(
        at,
        &eval,
        &["val/00001", "00001.npy` has changed", "--force"],
    );
    lsdc(at).args(&eval).arg("--force").assert().success();
}

#[test]
fn json_has_a_line_for_every_frame_whatever_became_of_it() {
    let folder = completed();
    let at = |name: &str| folder.path().join(name);
    std::fs::copy(at("rgb.png"), at("images/c.png")).unwrap();
    std::fs::copy(at("rgb.png"), at("images/d.png")).unwrap();
    std::fs::copy(at("sparse.npy"), at("points/d.npy")).unwrap();
    std::fs::write(at("points/c.npy"), b"nothing").unwrap();
    let run = lsdc(folder.path()).args(COMPLETE).arg("--json").assert();
    let printed = text(&run.code(3));
    let lines = printed
        .lines()
        .map(|line| serde_json::from_str(line).unwrap());
    let mut lines: Vec<serde_json::Value> = lines.collect();
    lines.sort_by_key(|line| line["image"].as_str().unwrap().to_owned());
    let statuses = lines.iter().map(|line| line["status"].as_str().unwrap());
    let statuses: Vec<&str> = statuses.collect();
    assert_eq!(statuses, ["unchanged", "unchanged", "failed", "completed"]);
    assert_eq!(lines[0]["points"]["used"], 500);
    assert!(lines[2]["error"].as_str().unwrap().contains("c.npy"));
    assert!(lines[2]["hint"].is_string());
    let one = ["complete", "images/c.png", "points/c.npy", "--json"];
    let one = text(&lsdc(folder.path()).args(one).assert().code(2));
    let one: serde_json::Value = serde_json::from_str(&one).unwrap();
    assert_eq!(
        (&one["image"], &one["status"]),
        (&"c.png".into(), &"failed".into())
    );
}

#[test]
fn a_forced_run_that_broke_off_leaves_no_wrong_record() {
    let folder = completed();
    let at = |name: &str| folder.path().join(name);
    // A folder prevents the last file of a frame from being written, after the first was replaced.
    std::fs::remove_file(at("out/a_depth_color.png")).unwrap();
    std::fs::create_dir(at("out/a_depth_color.png")).unwrap();
    let forced = [&COMPLETE[..], &["--method", "nearest", "--force"]].concat();
    lsdc(folder.path()).args(forced).assert().code(3);
    std::fs::remove_dir(at("out/a_depth_color.png")).unwrap();
    std::fs::write(at("out/a_depth_color.png"), "").unwrap();
    // The depths of `a` come from the other method and are not reused.
    std::fs::remove_file(at("points/b.npy")).unwrap();
    let run = lsdc(folder.path()).args(COMPLETE).assert().code(3);
    assert!(text(&run).contains("0 there already"), "{}", text(&run));
    assert!(said(&run).contains("a_depth.npy` exists"), "{}", said(&run));
}
