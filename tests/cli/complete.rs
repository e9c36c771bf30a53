//! `lsdc complete` on one image.

use super::*;

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
        "to expect between the points (leave-one-out)",
        "at the points",
        "written   rgb_depth.npy, rgb_depth.png, rgb_depth_color.png",
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
    let png = lsdc_eval::data::read_depth_png(&folder.path().join("rgb_depth.png"), 0.001).unwrap();
    for (a, b) in png.values().iter().zip(depth.values()) {
        assert!((a - b).abs() <= 0.00051, "{a} {b}");
    }
    // Repeating the command is no conflict; a different result is.
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
    for level in lsdc_kernels::simd::Level::ALL {
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
fn the_best_quality_is_the_mean_with_the_mirror_image() {
    let (folder, mirror) = (room(), tempfile::tempdir().unwrap());
    let rgb = lsdc_eval::data::read_rgb(&folder.path().join("rgb.png")).unwrap();
    let flipped = image::imageops::flip_horizontal(&rgb);
    flipped.save(mirror.path().join("rgb.png")).unwrap();
    let sparse = read_npy(&folder.path().join("sparse.npy"), 1.0).unwrap();
    let (width, height) = (sparse.width(), sparse.height());
    let mut points: Vec<_> = sparse.points().collect();
    for point in &mut points {
        point.x = width - 1 - point.x;
    }
    let flipped = DepthMap::from_points(width, height, &points);
    write_npy(&mirror.path().join("sparse.npy"), &flipped).unwrap();

    let completed = |at: &Path, quality: &str| {
        let run = lsdc(at)
            .args(["complete", "rgb.png", "sparse.npy", "-o", quality])
            .args(["--formats", "npy,json", "--quality", quality])
            .assert()
            .success();
        let is_best = quality == "best";
        assert_eq!(text(&run).contains("\nquality   best\n"), is_best);
        let report = json(&at.join(quality).join("rgb_report.json"));
        assert_eq!(report["quality"] == "best", is_best, "{report}");
        read_npy(&at.join(quality).join("rgb_depth.npy"), 1.0).unwrap()
    };
    let standard = completed(folder.path(), "standard");
    let best = completed(folder.path(), "best");
    let mirrored = completed(mirror.path(), "standard");
    let mut apart: f32 = 0.0;
    for (i, best) in best.values().iter().enumerate() {
        let (x, y) = (i % width, i / width);
        let (one, other) = (standard.at(x, y), mirrored.at(width - 1 - x, y));
        let mean = 0.5 * (one + other);
        assert!(
            (best - mean).abs() <= 1e-4 * mean,
            "{x}, {y}: {best} {mean}"
        );
        apart = apart.max((best / one - 1.0).abs());
    }
    assert!(apart > 0.01, "{apart}");
}

#[test]
fn a_size_for_an_encoder_that_is_not_there_is_refused() {
    let folder = room();
    for (side, more, words) in [
        ("400", &[][..], "no encoder"),
        ("600", &[][..], "not 252 to 518 pixels"),
        ("400", &["--method", "wls"][..], "`--encoder-side`"),
    ] {
        let mut command = lsdc(folder.path());
        command.args([
            "complete",
            "rgb.png",
            "sparse.npy",
            "-o",
            "out",
            "--encoder-side",
            side,
        ]);
        let run = command.args(more).assert().failure();
        let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(said.contains(words), "{said}");
        assert!(!folder.path().join("out").exists());
    }
}

#[test]
fn the_best_quality_is_timed_and_named() {
    let folder = room();
    let bench = |more: &[&str]| {
        let mut command = lsdc(folder.path());
        command.args(["bench", "--runs", "1", "--size", "64x48"]);
        text(&command.args(more).assert().success())
    };
    let printed = bench(&["--quality", "best"]);
    let words = "64x48, 500 points, quality best, median of 1 runs\n";
    assert!(printed.contains(words), "{printed}");
    let outcome: serde_json::Value =
        serde_json::from_str(&bench(&["--quality", "best", "--json"])).unwrap();
    assert_eq!(outcome["quality"], "best");
    assert!(outcome["total_ms"].as_f64().unwrap() > 0.0);
    assert!(!bench(&["--json"]).contains("quality"));
}

#[test]
fn training_steps_of_a_configuration_are_timed() {
    let folder = room();
    let bench = |more: &[&str]| {
        let mut command = lsdc(folder.path());
        command.args(["bench", "--runs", "1", "--size", "64x48", "--json"]);
        command.args(more).assert()
    };
    let joint = [
        "--training",
        "--config",
        "nyu-joint.toml",
        "--set",
        "train.batch=3",
    ];
    let run = bench(&joint).success();
    let outcome: serde_json::Value = serde_json::from_slice(&run.get_output().stdout).unwrap();
    assert_eq!(outcome["batch"], 3);
    assert!(outcome["step_ms"].as_f64().unwrap() > 0.0);
    // Settings without effect are refused.
    for (args, word) in [
        (&joint[1..], "--training"),
        (&[&joint[..], &["--weights", "small"]].concat(), "--weights"),
        (&["--training", "--config", "s2d.toml"], "metrics.jsonl"),
        (&["--training", "--fit", "lse"], "fit.method"),
    ] {
        let run = bench(args).failure();
        let error = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(error.contains(word), "{error}");
    }
}

#[test]
fn only_guides_that_are_predicted_are_timed() {
    let folder = room();
    let refuses = |args: &[&str], words: &[&str]| {
        let bench = ["bench", "--runs", "1", "--size", "64x48", "--guide"];
        refused(folder.path(), &[&bench[..], args].concat(), words);
    };
    refuses(
        &["map.npy"],
        &["read, not predicted", "depth-anything:SIDE"],
    );
    let two = ["depth-anything:252,depth-anything"];
    refuses(&two, &["`lsdc weights get anything`"]);
    let classic = ["depth-anything", "--method", "linear"];
    refuses(&classic, &["`--guide`", "need method `lsdc`"]);
    refuses(&["depth-anything", "--training"], &["--training"]);
}

#[test]
fn a_training_that_cannot_begin_leaves_no_folder() {
    let folder = room();
    let at = folder.path();
    let train = |setting: &str, words: &[&str]| {
        let args = [
            "train",
            "--config",
            "smoke.toml",
            "-o",
            "run",
            "--set",
            setting,
        ];
        refused(at, &args, words);
        assert!(!at.join("run").exists(), "{setting}");
    };
    train("train.start=absent.safetensors", &["absent.safetensors"]);
    train("train.backbone.rate=0.5", &["train.backbone", "lite"]);
    train("train.part=map", &["train.loss.mean", "nyu-map.toml"]);
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
    for flags in [&[][..], &["--prior", "none"]] {
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
        list.starts_with("u,v,depth,depth_by_the_others,score,probability,weight\n"),
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

    // An existing file is not replaced unasked, and no other file is written.
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

    // A point with a large standard deviation has no influence.
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
    for fit in ["lse", "field", "joint"] {
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
                "--json",
            ])
            .assert()
            .success();
        let report: serde_json::Value = serde_json::from_str(&text(&run)).unwrap();
        residuals.push(report["fit"]["residual"].as_f64().unwrap());
        let sigma = read_npy(&at.join(fit).join("rgb_sigma.npy"), 1.0).unwrap();
        assert_eq!(
            sigma.count(),
            sigma.values().len(),
            "{fit}: a deviation everywhere"
        );
        let sparse = read_npy(&asset("sparse.npy"), 1.0).unwrap();
        // Standard deviations are smaller at pixels with a point.
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
    // The residual of basis functions is larger than that of fields.
    assert!(residuals[0] > 10.0 * residuals[1] && residuals[0] > 10.0 * residuals[2]);
}

#[test]
fn bad_input_is_refused_in_one_line() {
    let folder = room();
    let path = |name: &str| folder.path().join(name);
    let map = |values: Vec<f32>, w, h| DepthMap::new(w, h, values).unwrap();
    write_npy(&path("small.npy"), &map(vec![1.0; 30], 5, 6)).unwrap();
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
        &["304x228", "5x6", "hint:"],
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
            text.contains("(3 without a usable depth or standard deviation)"),
            out == "b"
        );
    }
    let read = |out: &str| read_npy(&folder.path().join(out).join("rgb_depth.npy"), 1.0).unwrap();
    assert_eq!(read("a"), read("b"));
}

#[test]
fn an_unknown_fit_is_refused() {
    let folder = room();
    refused(
        folder.path(),
        &["complete", "rgb.png", "sparse.npy", "--fit", "none"],
        &["lse, field, joint"],
    );
}
