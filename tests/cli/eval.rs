//! `lsdc eval` and `lsdc report`.

use super::*;

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
fn the_best_quality_is_evaluated_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let eval = |quality: &str| {
        let file = format!("{quality}.json");
        let run = lsdc(folder.path())
            .args(ROOMS)
            .args(["--method", "lsdc", "--weights", "small"])
            .args(["--quality", quality, "--json", &file])
            .assert()
            .success();
        let report = json(&folder.path().join(file));
        assert_eq!(text(&run).contains("; quality best\n"), quality == "best");
        report["means"]["lsdc"]["mean"]["rmse"].as_f64().unwrap()
    };
    // A different error of the same size.
    let ratio = eval("best") / eval("standard");
    assert!(ratio != 1.0 && (0.8..1.25).contains(&ratio), "{ratio}");
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
    let one = ["report", "merge", "a.json", "-o", "half"];
    refused(folder.path(), &one, &["parts are missing: 1-of-2", "hint:"]);
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
    // Killed while writing the third frame. A false number of points shows that kept frames are not measured again.
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

    // Exported frames and points give the same measures.
    let export = ["export", "--points", "500", "-o", "frames"];
    run(&[&export[..], &ROOMS[1..]].concat());
    eval(&["--method", "linear", "--json", "one.json"]);
    let means = |path: &str| json(&at(path))["means"]["linear"].clone();
    run(&[&EVAL_EXPORTED[..], &["--json", "m.json"]].concat());
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
    // A single prediction does not suffice for two draws.
    let once = ["--predictions", "theirs=saved/linear/seed0"];
    eval(&once);
    refused(
        folder.path(),
        &[&ROOMS[..], &once, &["--seeds", "2"]].concat(),
        &["`theirs` has no folder", "seed0/seed0", "2 draws", "hint:"],
    );
    let lone = [&ROOMS[..], &["--predictions", "x=nowhere"]].concat();
    refused(folder.path(), &lone, &["no folder `nowhere`"]);
}

#[test]
fn guides_are_given_to_the_frames_of_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let export = ["export", "-o", "frames"];
    lsdc(folder.path())
        .args([&export[..], &ROOMS[1..]].concat())
        .assert()
        .success();
    let measured = |args: &[&str]| {
        let all = [
            &ROOMS[..],
            &["--points", "exactly:50", "--json", "r.json", "--force"],
            args,
        ];
        lsdc(folder.path()).args(all.concat()).assert().success();
        json(&at("r.json"))["means"]["lsdc"]["mean"]["rmse"]
            .as_f64()
            .unwrap()
    };
    let method = ["--method", "lsdc"];
    let plain = measured(&method);
    // The ground truth as a guide of unknown scale.
    let guided = measured(&[&method[..], &["--guide", "frames/gt"]].concat());
    assert!(guided < 0.5 * plain, "{guided} {plain}");
    let refuses = |args: &[&str], words: &[&str]| {
        refused(folder.path(), &[&ROOMS[..], args].concat(), words);
    };
    let field = ["--guide", "frames/gt", "--fit", "field"];
    refuses(&field, &["would change nothing"]);
    let classic = ["--guide", "frames/gt", "--method", "linear"];
    refuses(&classic, &["would change nothing"]);
    refuses(
        &["--guide", "frames/none"],
        &["no folder of guides", "hint:"],
    );
    refuses(&["--guide", "frames"], &["no guide of that name"]);
    refuses(
        &["--guide", "depth-anything"],
        &["Depth Anything V2 Small", "`lsdc weights get anything`"],
    );
    refuses(
        &["--guide", "frames/gt", "--head", "published"],
        &["`--head`", "--guide depth-anything"],
    );
}

#[test]
fn broken_frames_are_reported_and_the_rest_measured() {
    let folder = tempfile::tempdir().unwrap();
    export_rooms(folder.path());
    let at = |name: &str| folder.path().join("frames").join(name);
    let image = std::fs::read(at("rgb/val/00000.png")).unwrap();
    std::fs::write(at("rgb/val/00000.png"), &image[..image.len() / 2]).unwrap();
    std::fs::remove_file(at("gt/val/00001.npy")).unwrap();
    std::fs::write(at("sparse/val/00002.npy"), huge_header()).unwrap();
    let output = lsdc(folder.path()).args(EVAL_EXPORTED).output().unwrap();
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

/// Writes a scan of a road from 1.6 m above it, with rings 0 to 11 from top to bottom, up to a wall at 12 m.
fn write_road(folder: &Path, name: &str) {
    let image = image::RgbImage::from_fn(320, 240, |x, y| image::Rgb([(x / 2) as u8, y as u8, 90]));
    let mut returns = Vec::new();
    for ring in 0..12 {
        let v = 70.0 + 12.5 * f32::from(ring);
        let road = 1.6 * 400.0 / (v - 50.0);
        returns.extend((0..32).map(|i| (10.0 * i as f32, v, road.min(12.0), ring)));
    }
    // Outside the image, and without a depth.
    returns.extend([(-3.0, 20.0, 5.0, 0), (3.0, 20.0, f32::NAN, 0)]);
    scans::write_scan(folder, name, &image, &returns);
}

#[test]
fn rings_of_a_scan_are_held_out() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["town/a", "town/b", "field/a"] {
        write_road(folder.path(), name);
    }
    let eval = ["eval", "--dataset", "scans", "--root", "."];
    let methods = ["--method", "linear-inverse,linear"];
    let held = ["--hold-out", "ring:2", "-o", "run"];
    let run = lsdc(folder.path())
        .args(eval)
        .args(methods)
        .args(held)
        .assert()
        .success();
    let said = text(&run);
    for word in [
        "scans val, 3 frames",
        "1158 returns; left out: 3 outside of the image, 3 without a positive depth, 0 behind",
        "held out  all rings but every 2nd",
        "truth without returns beyond 1.1 x the nearest of 7x11 pixels + 0.3 m",
        "RMSE by scene",
        "field (1)",
        "town (2)",
        "0 to 10 m, 384 pixels (66.7 %)",
        "10 to 20 m, 192 pixels (33.3 %)",
        "phantom, %",
    ] {
        assert!(said.contains(word), "{word}: {said}");
    }
    let report = json(&folder.path().join("run/report.json"));
    // Rings 0, 2, ..., 10 of 32 returns each.
    assert_eq!(report["frames"][0]["points"], 192);
    assert_eq!(report["heading"]["made_from"]["hold_out"], "ring:2");
    let scenes = &report["scenes"];
    assert_eq!(scenes["field"], scenes["town"]);
    let counted = |method: &str| -> u64 {
        let ranges = report["ranges"][method]["all"].as_array().unwrap();
        ranges.iter().map(|range| range[0].as_u64().unwrap()).sum()
    };
    assert_eq!((counted("linear"), counted("linear-inverse")), (576, 576));
    let page = std::fs::read_to_string(folder.path().join("run/report.html")).unwrap();
    assert!(page.contains("Errors by depth") && page.contains("MAE by scene"));

    // The returns that are not given are scored: 384 - 100 of each scan.
    let drawn = ["--points", "100", "--json", "drawn.json"];
    lsdc(folder.path())
        .args(eval)
        .args(methods)
        .args(drawn)
        .assert()
        .success();
    let drawn = json(&folder.path().join("drawn.json"));
    let pixels = drawn["by_depth"][0]["title"].as_str().unwrap();
    assert_eq!(pixels, "all depths, 852 pixels");
    let all_given = [&eval[..], &["--method", "linear"]].concat();
    refused(folder.path(), &all_given, &["not given", "--hold-out"]);
    let unknown = [&all_given[..], &["--hold-out", "rings"]].concat();
    refused(folder.path(), &unknown, &["ring:K", "clusters:N"]);
    let rooms = [&ROOMS[..], &["--hold-out", "ring:2"]].concat();
    refused(folder.path(), &rooms, &["no rings", "clusters:N"]);
}

#[test]
fn certain_pixels_are_counted_by_depth() {
    let folder = tempfile::tempdir().unwrap();
    let eval = |args: &[&str]| {
        let mut command = lsdc(folder.path());
        command
            .args(ROOMS)
            .args(["--method", "lsdc,linear", "--json", "r.json", "--force"])
            .args(args)
            .assert()
            .success();
        json(&folder.path().join("r.json"))
    };
    let kept = |report: &serde_json::Value| -> u64 {
        let ranges = report["ranges"]["lsdc"]["certain"].as_array().unwrap();
        ranges.iter().map(|range| range[0].as_u64().unwrap()).sum()
    };
    let (strict, usual) = (
        eval(&["--uncertainty", "--sigma-cut", "0.01"]),
        eval(&["--uncertainty"]),
    );
    let all = 4 * 96 * 72;
    assert!(0 < kept(&strict) && kept(&strict) < kept(&usual) && kept(&usual) <= all);
    assert_eq!(strict["means"], usual["means"]);
    assert!(usual["ranges"]["linear"].get("certain").is_none());
    let alone = [&ROOMS[..], &["--sigma-cut", "0.1"]].concat();
    refused(folder.path(), &alone, &["--uncertainty"]);
    let none = [&ROOMS[..], &["--uncertainty", "--sigma-cut", "0"]].concat();
    refused(folder.path(), &none, &["sigma_cut"]);
}
