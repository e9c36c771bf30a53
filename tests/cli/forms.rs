//! File formats that `lsdc complete` reads and writes.

use super::*;
use lsdc_eval::data::{Camera, Sparse, read_rgb, write_rgb};

/// A camera at (1, 2, 3) looking along the world's x axis; z is up.
const CAMERA: &str = "fx = 200\nfy = 200\ncx = 99.5\ncy = 79.5\n\
    camera_to_world = [[0, 0, 1, 1], [-1, 0, 0, 2], [0, -1, 0, 3]]\n";

/// A folder with the room, [`CAMERA`], and the points as a cloud in world coordinates.
fn scanned(cloud: &str) -> tempfile::TempDir {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("camera.toml"), CAMERA).unwrap();
    let camera = Camera::read(&at("camera.toml")).unwrap();
    let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
    let points: Vec<[f64; 3]> = sparse
        .points()
        .map(|p| {
            let pixel = [p.x as f64, p.y as f64];
            camera.unproject(pixel, f64::from(p.depth)).unwrap()
        })
        .collect();
    let lines: Vec<String> = points
        .iter()
        .map(|[x, y, z]| format!("{x} {y} {z}"))
        .collect();
    let head = match cloud {
        "ply" => format!(
            "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
             property double z\nend_header\n",
            points.len()
        ),
        _ => format!(
            "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {n}\nHEIGHT 1\n\
             VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA ascii\n",
            n = points.len()
        ),
    };
    std::fs::write(
        at(&format!("scan.{cloud}")),
        head + &lines.join("\n") + "\n",
    )
    .unwrap();
    folder
}

fn complete(folder: &Path, args: &[&str]) -> String {
    let run = lsdc(folder).arg("complete").args(args).assert().success();
    text(&run)
}

#[test]
fn clouds_are_seen_by_the_camera() {
    for cloud in ["ply", "pcd"] {
        let folder = scanned(cloud);
        let at = |name: &str| folder.path().join(name);
        let scan = format!("scan.{cloud}");
        let camera = Camera::read(&at("camera.toml")).unwrap();
        let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
        let size = (sparse.width(), sparse.height());
        let found = Sparse::read(&at(&scan), None, Some(&camera), size).unwrap();
        // Few points are taken for hidden: the cloud was measured from the place of the camera.
        assert!(
            found.hidden * 50 < sparse.count(),
            "{} hidden",
            found.hidden
        );
        for point in found.map().unwrap().points() {
            let given = sparse.at(point.x, point.y);
            assert!((point.depth - given).abs() < 1e-5, "{given}");
        }
        let told = complete(
            folder.path(),
            &["rgb.png", &scan, "--camera", "camera.toml"],
        );
        // Clouds are assumed to be in metres, as documented.
        assert!(told.contains("unit      metres\n"), "{told}");
        refused(
            folder.path(),
            &["complete", "rgb.png", &scan],
            &["--camera"],
        );
        let away = [
            "complete",
            "rgb.png",
            &scan,
            "--camera",
            "200,200,9999,9999",
        ];
        refused(folder.path(), &away, &["none of its 500 points"]);
        let broken = ["complete", "rgb.png", &scan, "--camera", "nowhere.toml"];
        refused(folder.path(), &broken, &["nowhere.toml"]);
    }
}

#[test]
fn a_result_is_a_cloud_in_the_world() {
    let folder = scanned("ply");
    let at = |name: &str| folder.path().join(name);
    let camera = ["--camera", "camera.toml"];
    let run = |more: &[&str]| {
        let args = [&["rgb.png", "sparse.npy"], &camera[..], more].concat();
        complete(folder.path(), &args);
    };
    let all = ["--keep-flying", "--max-relative-sigma", "1e6"];
    run(&[&["-o", "whole.ply"], &all[..]].concat());
    run(&["-o", "whole.npy"]);
    run(&["-o", "sure.ply", "--max-sigma", "0.2"]);
    // Projected into the same camera, the cloud reproduces its map.
    let seen = Camera::read(&at("camera.toml")).unwrap();
    let depth = read_npy(&at("whole.npy"), 1.0).unwrap();
    let size = (depth.width(), depth.height());
    let again = Sparse::read(&at("whole.ply"), None, Some(&seen), size).unwrap();
    assert!(
        again.points.len() * 100 >= depth.count() * 99,
        "{}",
        again.points.len()
    );
    for point in again.map().unwrap().points() {
        assert!((point.depth - depth.at(point.x, point.y)).abs() < 1e-5);
    }
    let sure = Sparse::read(&at("sure.ply"), None, Some(&seen), size).unwrap();
    assert!((1..again.points.len()).contains(&sure.points.len()));

    let none = [
        "complete",
        "rgb.png",
        "sparse.npy",
        "-o",
        "more",
        "--formats",
        "ply",
    ];
    refused(folder.path(), &none, &["a cloud needs a camera"]);
    for option in [&["--voxel", "0.01"][..], &["--keep-flying"]] {
        let args = [&["complete", "rgb.png", "sparse.npy", "-o", "more"], option].concat();
        refused(folder.path(), &args, &[option[0], "ply"]);
    }
    for edge in ["0", "-1", "nan", "inf", "wide"] {
        let args = ["complete", "rgb.png", "sparse.npy", "--voxel", edge];
        refused(folder.path(), &args, &["edge length of a voxel", "0.01"]);
    }
    let twice = [
        "complete",
        "rgb.png",
        "sparse.npy",
        "-o",
        "a.npy",
        "--formats",
        "npy",
    ];
    refused(folder.path(), &twice, &["twice"]);
}

/// Pixels whose standard deviation is above a tenth of the depth are left out of clouds, and on request of maps.
#[test]
fn pixels_that_count_as_not_measured_are_in_no_cloud() {
    let folder = scanned("ply");
    let at = |name: &str| folder.path().join(name);
    let camera = ["--camera", "camera.toml", "--json"];
    let run = |points: &str, more: &[&str]| -> serde_json::Value {
        let args = [&["rgb.png", points], &camera[..], more].concat();
        serde_json::from_str(&complete(folder.path(), &args)).unwrap()
    };
    // Ten points leave much of the room unmeasured.
    let mut few = read_npy(&at("sparse.npy"), 1.0).unwrap().into_values();
    let measured: Vec<usize> = (0..few.len()).filter(|&i| few[i] > 0.0).collect();
    for (number, &pixel) in measured.iter().enumerate() {
        if number % (measured.len() / 10) > 0 {
            few[pixel] = 0.0;
        }
    }
    write_npy(&at("few.npy"), &DepthMap::new(304, 228, few).unwrap()).unwrap();
    run(
        "few.npy",
        &["-o", "all", "--uncertainty", "--formats", "npy"],
    );
    let depth = read_npy(&at("all/rgb_depth.npy"), 1.0).unwrap();
    let sigma = read_npy(&at("all/rgb_sigma.npy"), 1.0).unwrap();
    let above = |most: f32| {
        let pairs = depth.values().iter().zip(sigma.values());
        pairs
            .filter(|(depth, sigma)| *sigma / *depth > most)
            .count()
    };
    assert!((1000..60_000).contains(&above(0.1)), "{}", above(0.1));
    let cloud = run("few.npy", &["-o", "cloud", "--formats", "ply,npy"]);
    assert_eq!(cloud["cloud"]["uncertain"], above(0.1));
    assert!(cloud["left_empty"].is_null());
    // The map is full.
    let full = read_npy(&at("cloud/rgb_depth.npy"), 1.0).unwrap();
    assert!(full == depth);
    let most = ["--max-relative-sigma", "0.2", "--formats", "ply,npy"];
    let masked = run("few.npy", &[&["-o", "masked"], &most[..]].concat());
    assert_eq!(masked["left_empty"]["pixels"], above(0.2));
    assert_eq!(masked["cloud"]["uncertain"], above(0.2));
    let map = read_npy(&at("masked/rgb_depth.npy"), 1.0).unwrap();
    let expected = depth.values().iter().zip(sigma.values());
    let expected = expected.map(|(depth, sigma)| if sigma / depth > 0.2 { 0.0 } else { *depth });
    assert_eq!(map.values(), expected.collect::<Vec<f32>>());
    let none = [
        "complete",
        "rgb.png",
        "few.npy",
        "-o",
        "none",
        "--max-relative-sigma",
        "1e-9",
    ];
    refused(
        folder.path(),
        &none,
        &["above 0.000000001 of its depth", "--max-relative-sigma"],
    );
    std::fs::write(at("one.csv"), "u,v,depth\n150,110,2\n").unwrap();
    let one = run("one.csv", &["-o", "one", "--formats", "ply"]);
    assert!(
        one["cloud"]["uncertain"].as_u64().unwrap() > 60_000,
        "{one}"
    );
}

#[test]
fn what_files_leave_out_is_counted() {
    let folder = scanned("ply");
    let at = |name: &str| folder.path().join(name);
    let pixels = 304 * 228;
    let camera = ["--camera", "camera.toml", "--formats", "ply,png"];
    let args = [&["rgb.png", "sparse.npy"], &camera[..]].concat();
    let run = |more: &[&str]| complete(folder.path(), &[&args[..], more].concat());
    let told = run(&["-o", "sure", "--max-sigma", "0.2"]);
    let report = run(&["-o", "again", "--max-sigma", "0.2", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let count = |name: &str| report["cloud"][name].as_u64().unwrap();
    assert_eq!(
        count("points") + count("uncertain") + count("flying"),
        pixels
    );
    assert!(count("uncertain") > 0 && count("flying") > 0 && count("unseen") == 0);
    assert_eq!(report["left_empty"]["pixels"], count("uncertain"));
    let words = format!("{} pixels left empty: standard", count("uncertain"));
    let flying = format!("{} pixels left out at depth edges", count("flying"));
    assert!(told.contains(&words) && told.contains(&flying), "{told}");
    let thin = run(&["-o", "thin", "--voxel", "0.05", "--keep-flying", "--json"]);
    let thin: serde_json::Value = serde_json::from_str(&thin).unwrap();
    let [points, merged, uncertain, none] = ["points", "merged", "uncertain", "flying"]
        .map(|name| thin["cloud"][name].as_u64().unwrap());
    assert_eq!((points + merged + uncertain, none), (pixels, 0));
    assert!((1..pixels / 10).contains(&uncertain), "{uncertain}");
    assert!(merged > points);
    let seen = Camera::read(&at("camera.toml")).unwrap();
    let cloud = Sparse::read(&at("sure/rgb_cloud.ply"), None, Some(&seen), (304, 228)).unwrap();
    assert!(cloud.points.len() as u64 <= count("points"));
    // For several images, the sum is reported.
    for part in ["images", "points"] {
        std::fs::create_dir(at(part)).unwrap();
    }
    std::fs::copy(at("rgb.png"), at("images/a.png")).unwrap();
    std::fs::copy(at("sparse.npy"), at("points/a.npy")).unwrap();
    let many = ["images", "points", "-o", "many", "--max-sigma", "0.2"];
    let told = complete(folder.path(), &[&many[..], &camera].concat());
    assert!(told.contains(&words), "{told}");

    // With a model that folds, the lens sees only a part of the image.
    let lens = "fx = 100\nfy = 100\ncx = 151.5\ncy = 113.5\nmodel = 'fisheye'\n\
        distortion = [-0.4, 0.0, 0.0, 0.0]\n";
    std::fs::write(at("camera.toml"), lens).unwrap();
    let report = run(&["-o", "fisheye", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let count = |name: &str| report["cloud"][name].as_u64().unwrap();
    let parts = ["points", "unseen", "uncertain", "flying"].map(count);
    assert_eq!(parts.iter().sum::<u64>(), pixels);
    assert!(count("unseen") > 0);
}

#[test]
fn depths_nearer_than_half_a_unit_of_a_png_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    image::RgbImage::new(32, 24).save(at("a.png")).unwrap();
    std::fs::write(at("a.csv"), "u,v,depth\n2,12,0.0001\n29,12,60\n").unwrap();
    let args = ["a.png", "a.csv", "--method", "nearest"];
    let told = complete(folder.path(), &args);
    let near = read_npy(&at("a_depth.npy"), 1.0).unwrap();
    let near = near.values().iter().filter(|&&d| d < 0.0005).count();
    let words = format!("png       {near} pixels nearer than half a unit hold one");
    assert!(near > 0 && told.contains(&words), "{told}");
    let report = complete(folder.path(), &[&args[..], &["--json"]].concat());
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["png_raised"], near);
}

#[test]
fn what_deviations_are_good_for_is_said_as_it_is() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let lines = "u,v,depth,sigma\n100,80,2,0.1\n100,80,2.05,0.2\n200,30,3,0.1\n";
    std::fs::write(at("a.csv"), lines).unwrap();
    let told = complete(folder.path(), &["rgb.png", "a.csv", "--method", "nearest"]);
    assert!(told.contains("only weigh points of one pixel"), "{told}");
    // They are weighted 4 to 1.
    let depth = read_npy(&at("rgb_depth.npy"), 1.0).unwrap().at(100, 80);
    assert!((depth - 2.01).abs() < 1e-6, "{depth}");
}

#[test]
fn inputs_and_results_go_through_pipes() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    complete(folder.path(), &["rgb.png", "sparse.npy", "-o", "depth.npy"]);
    let expected = std::fs::read(at("depth.npy")).unwrap();
    let points = std::fs::read(at("sparse.npy")).unwrap();
    let image = std::fs::read(at("rgb.png")).unwrap();
    for (args, input) in [(["rgb.png", "-"], points), (["-", "sparse.npy"], image)] {
        let run = lsdc(folder.path())
            .arg("complete")
            .args(args)
            .args(["-o", "-"])
            .write_stdin(input)
            .assert()
            .success();
        assert_eq!(run.get_output().stdout, expected);
        let said = String::from_utf8(run.get_output().stderr.clone()).unwrap();
        assert!(said.contains("points    500"), "{said}");
    }
    assert_eq!(names(folder.path()).len(), 3);
    let run = lsdc(folder.path())
        .args(["complete", "rgb.png", "sparse.npy", "-o", "-", "--quiet"])
        .assert()
        .success();
    assert!(run.get_output().stderr.is_empty());
    refused(folder.path(), &["complete", "-", "-"], &["only one input"]);
    refused(
        folder.path(),
        &["complete", "-", "sparse.npy"],
        &["in no folder", "-o DIR"],
    );
    refused(folder.path(), &["complete", "rgb.png", "-"], &["is empty"]);
}

#[test]
fn reports_say_in_json_what_is_told_in_words() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let args = [
        "rgb.png",
        "sparse.npy",
        "--json",
        "--formats",
        "json",
        "-o",
        "out",
    ];
    let printed = complete(folder.path(), &args);
    let printed: serde_json::Value = serde_json::from_str(&printed).unwrap();
    let written = json(&at("out/rgb_report.json"));
    assert_eq!(printed, written);
    assert_eq!(written["image"], "rgb.png");
    assert_eq!(written["points"]["used"], 500);
    assert_eq!(written["points"]["unit"], "metres");
    assert_eq!(written["points"]["unit_guessed"], false);
    assert_eq!(written["fit"]["method"], "joint");
    let depth = &written["depth"];
    assert!(depth["lowest"].as_f64() < depth["highest"].as_f64());
    assert!(written["fit"]["leave_one_out"].as_f64() > written["fit"]["residual"].as_f64());
    // Times differ between runs, which is no conflict.
    complete(folder.path(), &args);
    let other = [&["complete"], &args[..], &["--fit", "lse"]].concat();
    refused(folder.path(), &other, &["exists"]);
    assert_eq!(
        complete(folder.path(), &["rgb.png", "sparse.npy", "-q"]),
        ""
    );
}

#[test]
fn a_sensor_of_fewer_pixels_is_placed_on_the_image() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let (width, height) = (truth.width() / 4, truth.height() / 4);
    let values = (0..width * height)
        .map(|i| truth.at(i % width * 4 + 2, i / width * 4 + 2))
        .collect();
    let small = DepthMap::new(width, height, values).unwrap();
    write_npy(&at("small.npy"), &small).unwrap();
    let told = complete(folder.path(), &["rgb.png", "small.npy", "-o", "depth.npy"]);
    assert!(
        told.contains(&format!("points    {}", width * height)),
        "{told}"
    );
    let depth = read_npy(&at("depth.npy"), 1.0).unwrap();
    assert_eq!(
        (depth.width(), depth.height()),
        (truth.width(), truth.height())
    );
    let pairs = depth.values().iter().zip(truth.values());
    let off: f32 = pairs.map(|(a, b)| (a - b).abs() / b).sum();
    assert!(off / (truth.values().len() as f32) < 0.03, "{off}");
}

#[test]
fn images_are_named_one_by_one_by_pattern_or_in_a_list() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let image = read_rgb(&at("rgb.png")).unwrap();
    for name in ["a.png", "b.png"] {
        write_rgb(&at(name), &image).unwrap();
    }
    image.save(at("c.tiff")).unwrap();
    std::fs::create_dir(at("points")).unwrap();
    for name in ["a", "b", "c"] {
        std::fs::copy(at("sparse.npy"), at(&format!("points/{name}.npy"))).unwrap();
    }
    std::fs::write(
        at("list.txt"),
        "# image, points\na.png sparse.npy\nb.png\nc.tiff\n",
    )
    .unwrap();
    let expected = ["a_depth.npy", "b_depth.npy", "c_depth.npy"];
    let way = ["--method", "nearest", "--formats", "npy"];
    for (out, images) in [
        ("one", &["a.png", "b.png", "c.tiff"][..]),
        ("two", &["[ab].png", "c.*"]),
        ("three", &["list.txt"]),
    ] {
        let args = [images, &["points", "-o", out], &way].concat();
        let told = complete(folder.path(), &args);
        assert!(told.contains("3 completed"), "{told}");
        assert_eq!(names(&at(out)), expected, "{out}");
    }
    let none = ["complete", "no*.png", "points", "-o", "more"];
    refused(folder.path(), &none, &["holds no image"]);
}

#[test]
fn colours_of_a_video_have_one_range() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let args = [
        "rgb.png",
        "sparse.npy",
        "--formats",
        "color,npy",
        "-o",
        "out",
    ];
    complete(folder.path(), &[&args[..], &["--range", "0,20"]].concat());
    let depth = read_npy(&at("out/rgb_depth.npy"), 1.0).unwrap();
    let found = read_rgb(&at("out/rgb_depth_color.png")).unwrap();
    let expected = lsdc_eval::report::colour_map(&depth, 0.0, 20.0, "m").unwrap();
    assert_eq!(found, expected);
    let wrong = [&["complete"], &args[..], &["--range", "4,2"]].concat();
    let run = lsdc(folder.path()).args(wrong).assert().code(2);
    let said = String::from_utf8(run.get_output().stderr.clone()).unwrap();
    assert!(said.contains("no range of depths"), "{said}");
}
