//! `lsdc complete` on folders and models.

use super::*;

/// A folder with images `a.png` and `b/c.png` and their points, one of them as a list.
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
    // A list of the same points gives the same map.
    for name in ["out/a_depth.npy", "out/b/c_depth.npy"] {
        assert_eq!(read_npy(&at(name), 1.0).unwrap(), one);
    }

    // A third image without points fails while the others exist; then only it remains to be done.
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

    // A run interrupted between the files of a frame is finished, whichever files are missing.
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

    // Two shards together are the whole.
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
    refused(folder.path(), &none, &["holds no image"]);
}

#[test]
fn every_image_of_a_colmap_model_is_completed() {
    let folder = folders();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("model")).unwrap();
    let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
    // The camera of `a.png` is at the origin; points lie on its rays at their depths.
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
    let images = format!("1 1 0 0 0 0 0 0 1 a.png\n{seen}\n2 1 0 0 0 -0.5 0 0 1 ../a.png\n\n");
    std::fs::write(at("model/images.txt"), images).unwrap();
    std::fs::write(at("model/points3D.txt"), points.join("\n")).unwrap();
    let run = lsdc(folder.path())
        .args(["complete", "images", "model", "-o", "out"])
        .assert()
        .success();
    // An image that was not given is no failure; an image that the model does not have is named.
    let output = run.get_output();
    let text = String::from_utf8([&output.stdout[..], &output.stderr].concat()).unwrap();
    assert!(
        text.contains("model     2 images, 1 of them not in the folder"),
        "{text}"
    );
    assert!(
        text.contains("1 image is not in the model: b/c.png"),
        "{text}"
    );
    std::fs::write(at("model/images.txt"), "1 1 0 0 0 0 0 0 1 left/9.png\n\n").unwrap();
    let none = ["complete", "images", "model", "-o", "more"];
    refused(
        folder.path(),
        &none,
        &[
            "none of 2 images is in the model",
            "a.png, b/c.png",
            "left/9.png",
        ],
    );
    let found = read_npy(&at("out/a_depth.npy"), 1.0).unwrap();
    // Errors grow with the square of the depth, so far points have less weight than in a map without standard deviations.
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let pairs = found.values().iter().zip(truth.values());
    let rel: f32 = pairs.map(|(a, b)| (a - b).abs() / b).sum();
    assert!(rel / truth.values().len() as f32 * 100.0 < 10.0, "{rel}");
    assert_eq!(names(&at("out")).len(), 3);
}

/// Number of frames of a video: the same image with different points.
const FRAMES: usize = 24;

#[test]
fn a_video_goes_on_where_it_stopped() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
    for part in ["images", "points"] {
        std::fs::create_dir(at(part)).unwrap();
    }
    let all: Vec<_> = sparse.points().collect();
    for frame in 0..FRAMES {
        let image = at(&format!("images/{frame:02}.png"));
        std::fs::copy(at("rgb.png"), image).unwrap();
        let few: Vec<_> = all.iter().skip(frame * 8).take(8).copied().collect();
        let few = DepthMap::from_points(sparse.width(), sparse.height(), &few);
        write_npy(&at(&format!("points/{frame:02}.npy")), &few).unwrap();
    }
    let run = |out: &str, more: &[&str]| {
        let args = [
            "complete",
            "images",
            "points",
            "-o",
            out,
            "--formats",
            "npy",
        ];
        lsdc(folder.path()).args(args).args(more).assert().success();
        let depth = |i| read_npy(&at(&format!("{out}/{i:02}_depth.npy")), 1.0).unwrap();
        (0..FRAMES).map(depth).collect::<Vec<_>>()
    };
    let alone = run("alone", &[]);
    let chain = run("chain", &["--temporal"]);
    assert_eq!(alone[0], chain[0], "nothing comes before the first");
    let apart = |[a, b]: &[DepthMap; 2]| -> f32 {
        let pairs = a.values().iter().zip(b.values());
        pairs.map(|(a, b)| (a - b).abs()).sum()
    };
    let flicker = |video: &[DepthMap]| video.array_windows().map(apart).sum::<f32>();
    assert!(flicker(&chain) < 0.9 * flicker(&alone));

    // Only results: the files that a run resumes from are hidden.
    let expected: Vec<_> = (0..FRAMES).map(|i| format!("{i:02}_depth.npy")).collect();
    assert_eq!(names(&at("chain")), expected);
    for name in ["01_depth.npy", ".lsdc/01.png.weights.json", "02_depth.npy"] {
        std::fs::remove_file(at("chain").join(name)).unwrap();
    }
    assert_eq!(run("chain", &["--temporal"]), chain);
    let part = [
        "complete",
        "images",
        "points",
        "-o",
        "more",
        "--temporal",
        "--shard",
        "0/2",
    ];
    refused(folder.path(), &part, &["cannot be combined"]);
    let one = ["complete", "rgb.png", "sparse.npy", "--temporal"];
    refused(
        folder.path(),
        &one,
        &["one image has none before it", "hint:"],
    );
    let untrained = [
        "complete",
        "images",
        "points",
        "-o",
        "more",
        "--temporal",
        "--method",
        "wls",
    ];
    refused(folder.path(), &untrained, &["need method `lsdc`"]);
    for otherwise in [
        &["--prior", "none"][..],
        &["--prior", "flat"],
        &["--fit", "field"],
    ] {
        let video = ["complete", "images", "points", "-o", "more", "--temporal"];
        let words = ["`--temporal` would change nothing", otherwise[1], "hint:"];
        refused(folder.path(), &[&video[..], otherwise].concat(), &words);
    }
}
