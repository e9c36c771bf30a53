//! How `lsdc complete` finds and interprets its inputs.

use super::*;
use image::codecs::png::PngEncoder;
use image::{ImageEncoder as _, Rgb, RgbImage};
use lsdc_eval::data::write_npy;

/// Runs `complete` with the nearest point, which is fast and shows where points lie.
fn nearest(folder: &Path, args: &[&str]) -> assert_cmd::assert::Assert {
    let way = ["--method", "nearest", "--formats", "npy"];
    let mut command = lsdc(folder);
    command.arg("complete").args(args).args(way).assert()
}

/// The standard error of a run.
fn said(run: &assert_cmd::assert::Assert) -> String {
    String::from_utf8(run.get_output().stderr.clone()).unwrap()
}

/// Writes an image of 32x24 pixels whose EXIF record contains only an orientation.
fn write_turned(path: &Path, orientation: u8) {
    let head = [b'I', b'I', 42, 0, 8, 0, 0, 0, 1, 0];
    let tag = [0x12, 0x01, 3, 0, 1, 0, 0, 0, orientation, 0, 0, 0];
    let image = RgbImage::from_pixel(32, 24, Rgb([90, 120, 150]));
    let mut file = Vec::new();
    let mut encoder = PngEncoder::new(&mut file);
    let exif = [&head[..], &tag, &[0; 4]].concat();
    encoder.set_exif_metadata(exif).unwrap();
    image.write_with_encoder(encoder).unwrap();
    std::fs::write(path, file).unwrap();
}

/// Position of the stored pixel (x, y) of 32x24 in the upright image (EXIF 2.32).
fn turned(orientation: u8, x: usize, y: usize) -> (usize, usize) {
    match orientation {
        2 => (31 - x, y),
        3 => (31 - x, 23 - y),
        4 => (x, 23 - y),
        5 => (y, x),
        6 => (23 - y, x),
        7 => (23 - y, 31 - x),
        8 => (y, 31 - x),
        _ => (x, y),
    }
}

/// Keypoints of COLMAP and cameras refer to stored pixels; ignoring this made the error 1.61 m instead of 0.195 m.
#[test]
fn points_of_turned_photos_are_where_the_image_shows_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("model")).unwrap();
    // Points at stored pixels (4, 3) and (25, 17) of a camera with a focal length of 40 pixels.
    let pixels = [(4, 3, 2.0), (25, 17, 6.0)];
    let place = |(x, y, z): (usize, usize, f64)| {
        let along = |pixel: usize, centre: f64| (pixel as f64 - centre) * z / 40.0;
        [along(x, 15.5), along(y, 11.5), z]
    };
    let [a, b] = pixels.map(place);
    let files = [
        (
            "model/cameras.txt",
            "1 SIMPLE_PINHOLE 32 24 40 16 12\n".to_owned(),
        ),
        (
            "model/images.txt",
            "1 1 0 0 0 0 0 0 1 photo.png\n4.5 3.5 1 25.5 17.5 2\n".to_owned(),
        ),
        (
            "model/points3D.txt",
            [(1, a), (2, b)]
                .map(|(i, [x, y, z])| format!("{i} {x} {y} {z} 0 0 0 0.5 1 0 2 0\n"))
                .concat(),
        ),
        (
            "cloud.csv",
            [a, b].map(|[x, y, z]| format!("{x},{y},{z}\n")).concat(),
        ),
        (
            "camera.toml",
            "width = 32\nheight = 24\nfx = 40\nfy = 40\ncx = 15.5\ncy = 11.5\n".to_owned(),
        ),
    ];
    for (name, text) in files {
        let head = if name == "cloud.csv" { "x,y,z\n" } else { "" };
        std::fs::write(at(name), format!("{head}{text}")).unwrap();
    }
    for orientation in 1..=8 {
        write_turned(&at("photo.png"), orientation);
        for input in [&["model"][..], &["cloud.csv", "--camera", "camera.toml"]] {
            let args = [&["photo.png"], input, &["-o", "out", "--force"]].concat();
            let run = nearest(folder.path(), &args).success();
            let depth = read_npy(&at("out/photo_depth.npy"), 1.0).unwrap();
            for (x, y, z) in pixels {
                let (x, y) = turned(orientation, x, y);
                assert_eq!(depth.at(x, y), z as f32, "{orientation} {input:?}");
            }
            let warned = said(&run).contains("turned upright");
            assert_eq!(warned, orientation > 1 && input.len() > 1, "{}", said(&run));
            let told = text(&run);
            let unit = told.contains("unit      model units") && told.contains("6.000 units,");
            assert_eq!(unit, input == ["model"], "{}", text(&run));
        }
    }
    std::fs::write(
        at("square.toml"),
        "width = 24\nheight = 24\nfx = 40\nfy = 40\ncx = 11\ncy = 11\n",
    )
    .unwrap();
    let cut = [
        "complete",
        "photo.png",
        "cloud.csv",
        "--camera",
        "square.toml",
    ];
    refused(folder.path(), &cut, &["24x24", "another shape", "hint:"]);
}

/// Images `a/x.png` and `b/x.png` of 32x24.
fn same_names() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["images/a/x.png", "images/b/x.png"] {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_turned(&path, 1);
    }
    std::fs::create_dir(folder.path().join("points")).unwrap();
    folder
}

#[test]
fn one_file_of_points_is_not_given_to_two_images() {
    let folder = same_names();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("points/x.CSV"), "u,v,depth\n1,1,2\n").unwrap();
    let run = nearest(folder.path(), &["images", "points", "-o", "out"]).code(3);
    let told = said(&run);
    for words in [
        "a/x.png",
        "b/x.png",
        "x.CSV` would be the points of both",
        "hint:",
    ] {
        assert!(told.contains(words), "{told}");
    }
    assert!(!at("out").exists());
    // They are found in folders of the same names, also in capitals.
    for (name, depth) in [("a", 2), ("b", 3)] {
        std::fs::create_dir(at(&format!("points/{name}"))).unwrap();
        let line = format!("u,v,depth\n1,1,{depth}\n");
        std::fs::write(at(&format!("points/{name}/x.CSV")), line).unwrap();
    }
    nearest(folder.path(), &["images", "points", "-o", "out"]).success();
    for (name, depth) in [("a", 2.0), ("b", 3.0)] {
        let map = read_npy(&at(&format!("out/{name}/x_depth.npy")), 1.0).unwrap();
        assert_eq!(map.at(0, 0), depth);
    }
}

#[test]
fn two_files_of_points_of_one_image_are_ambiguous() {
    let folder = same_names();
    let at = |name: &str| folder.path().join(name);
    for (name, depth) in [("a", 2), ("b", 3)] {
        std::fs::create_dir(at(&format!("points/{name}"))).unwrap();
        let line = format!("u,v,depth\n1,1,{depth}\n");
        std::fs::write(at(&format!("points/{name}/x.csv")), line).unwrap();
    }
    std::fs::write(at("points/b/x.txt"), "u,v,depth\n1,1,9\n").unwrap();
    let run = nearest(folder.path(), &["images", "points", "-o", "out"]).code(3);
    let told = said(&run);
    assert!(told.contains("failed: b/x.png"), "{told}");
    assert!(told.contains("may both be its points"), "{told}");
    assert!(at("out/a/x_depth.npy").exists() && !at("out/b").exists());
    // A list names the files.
    std::fs::write(at("list.txt"), "images/b/x.png points/b/x.txt\n").unwrap();
    nearest(folder.path(), &["list.txt", "points", "-o", "told"]).success();
    let one = ["images/b/x.png", "points/b", "-o", "more"];
    refused(
        folder.path(),
        &[&["complete"], &one[..]].concat(),
        &["x.csv", "x.txt", "hint:"],
    );
}

/// Writes a COLMAP model with these image lines and two points, the first at 5, the second at 7.
pub(super) fn write_model(model: &Path, images: &str) {
    std::fs::create_dir_all(model).unwrap();
    let camera = "1 SIMPLE_PINHOLE 32 24 40 16 12\n";
    std::fs::write(model.join("cameras.txt"), camera).unwrap();
    std::fs::write(model.join("images.txt"), images).unwrap();
    let points = "1 0 0 5 0 0 0 0.5 1 0 2 0\n2 0 0 7 0 0 0 0.5 1 0 2 0\n";
    std::fs::write(model.join("points3D.txt"), points).unwrap();
}

#[test]
fn one_view_of_a_model_is_not_given_to_two_images() {
    let folder = same_names();
    let at = |name: &str| folder.path().join(name);
    write_model(&at("model"), "1 1 0 0 0 0 0 0 1 x.png\n4.5 3.5 1\n");
    std::fs::write(at("list.txt"), "images/a/x.png\nimages/b/x.png\n").unwrap();
    let list = ["list.txt", "model", "-o", "out"];
    let told = said(&nearest(folder.path(), &list).code(3));
    assert!(
        told.contains("x.png` would be the points of both"),
        "{told}"
    );
    assert!(!at("out/images").exists());
}

#[test]
fn the_longest_path_of_a_model_that_fits_is_meant() {
    let folder = same_names();
    let at = |name: &str| folder.path().join(name);
    let images = "1 1 0 0 0 0 0 0 1 x.png\n4.5 3.5 1\n2 1 0 0 0 0 0 0 1 b/x.png\n4.5 3.5 2\n";
    write_model(&at("model"), images);
    nearest(folder.path(), &["images/b/x.png", "model", "-o", "b"]).success();
    assert_eq!(read_npy(&at("b/x_depth.npy"), 1.0).unwrap().at(0, 0), 7.0);
    nearest(folder.path(), &["images/a/x.png", "model", "-o", "a"]).success();
    assert_eq!(read_npy(&at("a/x_depth.npy"), 1.0).unwrap().at(0, 0), 5.0);
}

#[test]
fn results_among_the_images_are_no_images() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("images")).unwrap();
    std::fs::create_dir(at("points")).unwrap();
    for name in ["a", "b"] {
        write_turned(&at(&format!("images/{name}.png")), 1);
        std::fs::write(at(&format!("points/{name}.csv")), "u,v,depth\n1,1,2\n").unwrap();
    }
    let args = ["complete", "images", "points", "-o", "images"];
    for counts in [
        "2 completed, 0 there already",
        "0 completed, 2 there already",
    ] {
        let mut run = lsdc(folder.path());
        let run = run
            .args(args)
            .args(["--method", "nearest"])
            .assert()
            .success();
        assert!(text(&run).contains(counts), "{}", text(&run));
    }
    // a.png, its depth as npy and png and in colours, and the same for b.
    assert_eq!(names(&at("images")).len(), 8);
}

#[test]
fn lists_hold_paths_as_find_and_people_write_them() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::create_dir(at("points")).unwrap();
    for name in ["plain", "two words", "take#3", "quoted, yes"] {
        write_turned(&at(&format!("{name}.png")), 1);
        std::fs::write(at(&format!("points/{name}.csv")), "u,v,depth\n1,1,2\n").unwrap();
    }
    let list = "./plain.png\ntwo words.png\ntake#3.png # the third\n\
        \"quoted, yes.png\" \"points/two words.csv\"\n# nothing\n";
    std::fs::write(at("list.txt"), list).unwrap();
    let run = nearest(folder.path(), &["list.txt", "points", "-o", "out"]).success();
    assert!(text(&run).contains("4 completed"), "{}", said(&run));
    std::fs::write(at("bad.txt"), "plain.png\na.png b.csv c.csv\n").unwrap();
    let bad = ["complete", "bad.txt", "points", "-o", "out"];
    refused(folder.path(), &bad, &["line 2: 3 paths", "quote"]);
}

#[test]
fn a_table_without_names_that_may_be_a_cloud_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    RgbImage::new(640, 480).save(at("a.png")).unwrap();
    let cloud = |low: [f64; 3], high: [f64; 3]| -> String {
        let line = |i: usize| {
            let at = |axis: usize, step: usize| {
                let share = (i * step % 500) as f64 / 499.0;
                low[axis] + share * (high[axis] - low[axis])
            };
            format!("{} {} {}\n", at(0, 1), at(1, 37), at(2, 211))
        };
        (0..500).map(line).collect()
    };
    for (low, high) in [
        ([-0.5, -0.5, 0.4], [0.5, 0.5, 1.0]),
        ([5.0, -10.0, -2.0], [40.0, 10.0, 2.0]),
        ([0.0, 0.0, 2.0], [0.5, 0.5, 3.0]),
    ] {
        std::fs::write(at("a.txt"), cloud(low, high)).unwrap();
        let args = ["complete", "a.png", "a.txt", "--method", "nearest"];
        refused(folder.path(), &args, &["640x480", "hint:", "--camera"]);
    }
    // A list may have a single pixel.
    std::fs::write(at("a.txt"), "411 77 2.5\n").unwrap();
    nearest(folder.path(), &["a.png", "a.txt", "-o", "out"]).success();
    assert_eq!(read_npy(&at("out/a_depth.npy"), 1.0).unwrap().at(0, 0), 2.5);
}

#[test]
fn a_principal_point_outside_the_image_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_turned(&at("a.png"), 1);
    std::fs::write(at("a.csv"), "u,v,depth\n1,1,2\n9,9,3\n").unwrap();
    for (camera, doubted) in [("40,40,15.5,11.5", false), ("40,40,320,240", true)] {
        let args = ["a.png", "a.csv", "-o", "out", "--force", "--camera", camera];
        let told = said(&nearest(folder.path(), &args).success());
        assert_eq!(told.contains("principal point"), doubted, "{told}");
    }
}

#[test]
fn what_was_assumed_is_said_even_quietly_and_in_json() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_turned(&at("a.png"), 1);
    std::fs::write(at("a.csv"), "u,v,depth\n1,1,2944\n9,9,3020\n").unwrap();
    let run = nearest(
        folder.path(),
        &["a.png", "a.csv", "-o", "out", "--json", "-q"],
    )
    .success();
    let told = said(&run);
    assert!(told.contains("warning: the median depth is"), "{told}");
    assert!(told.contains("--depth-unit"), "{told}");
    let report: serde_json::Value = serde_json::from_str(&text(&run)).unwrap();
    assert_eq!(report["remarks"].as_array().unwrap().len(), 1);
    let said_so = ["a.png", "a.csv", "-o", "mm", "--depth-unit", "mm"];
    let run = nearest(folder.path(), &said_so).success();
    assert_eq!(said(&run), "");
}

#[test]
fn many_points_outside_the_image_are_doubted() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_turned(&at("a.png"), 1);
    // With columns and rows exchanged, half of the points are below the image.
    let rows = |turned: bool| -> String {
        let place = |i: usize| (1 + 3 * i, 1 + 2 * i);
        let places = (0..9).map(place);
        let rows = places.map(|(u, v)| if turned { (v, u) } else { (u, v) });
        let lines: Vec<_> = rows.map(|(u, v)| format!("{u},{v},2\n")).collect();
        lines.concat()
    };
    for (turned, doubted) in [(false, false), (true, true)] {
        std::fs::write(at("a.csv"), format!("u,v,depth\n{}", rows(turned))).unwrap();
        let run = nearest(
            folder.path(),
            &["a.png", "a.csv", "-o", "out", "--force", "-q"],
        );
        let told = said(&run.success());
        assert_eq!(told.contains("are outside the image"), doubted, "{told}");
    }
    // The warning also appears for several frames, with the total count.
    std::fs::create_dir(at("images")).unwrap();
    std::fs::create_dir(at("points")).unwrap();
    std::fs::copy(at("a.png"), at("images/a.png")).unwrap();
    std::fs::copy(at("a.csv"), at("points/a.csv")).unwrap();
    let run = nearest(folder.path(), &["images", "points", "-o", "all"]).success();
    let (warned, told) = (said(&run), text(&run));
    assert!(warned.contains("check that the columns"), "{warned}");
    assert!(told.contains("1 outside the image\n"), "{told}");
}

#[test]
fn an_input_is_not_replaced_by_its_result() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_turned(&at("a.png"), 1);
    std::fs::write(at("a.csv"), "u,v,depth\n1,1,2\n9,9,3\n").unwrap();
    let before = std::fs::read(at("a.png")).unwrap();
    refused(
        folder.path(),
        &["complete", "a.png", "a.csv", "-o", "a.png", "--force"],
        &["`a.png` is the image", "-o"],
    );
    assert_eq!(std::fs::read(at("a.png")).unwrap(), before);
}

#[test]
fn a_guide_is_used_or_said_not_to_be() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let (width, height) = (truth.width(), truth.height());
    write_npy(&at("good.npy"), &truth).unwrap();
    // Stripes that are unrelated to the room, with another shape.
    let stripes = (0..200 * 50).map(|i| 2.0 + ((i % 200) as f32 / 3.0).sin());
    write_npy(
        &at("bad.npy"),
        &DepthMap::new(200, 50, stripes.collect()).unwrap(),
    )
    .unwrap();
    let run = |guide: &str, weights: &str| -> (serde_json::Value, f64) {
        let output = lsdc(folder.path())
            .args([
                "complete",
                "rgb.png",
                "sparse.npy",
                "-o",
                "depth.npy",
                "--force",
                "--json",
            ])
            .args(["--guide", guide, "--weights", weights])
            .output()
            .unwrap();
        assert!(output.status.success(), "{output:?}");
        let report = serde_json::from_slice(&output.stdout).unwrap();
        let found = read_npy(&at("depth.npy"), 1.0).unwrap();
        let pairs = found.values().iter().zip(truth.values());
        let squares: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
        (report, (squares / (width * height) as f64).sqrt())
    };
    for weights in ["default", "none"] {
        let (good, near) = run("good.npy", weights);
        assert!(good["fit"]["guide_trust"].as_f64().unwrap() > 0.0);
        let (bad, far) = run("bad.npy", weights);
        assert_eq!(bad["fit"]["guide_trust"], 0.0);
        assert!(bad["remarks"].to_string().contains("stretched"), "{bad}");
        assert!(near < 0.5 * far, "{weights}: {near} {far}");
    }
    let refused_with = |args: &[&str], words: &[&str]| {
        let all = [&["complete"], args, &["-o", "out"]].concat();
        refused(folder.path(), &all, words);
    };
    let frame = ["rgb.png", "sparse.npy", "--guide"];
    let field = [&frame[..], &["good.npy", "--fit", "field"]].concat();
    refused_with(&field, &["--guide", "change nothing"]);
    refused_with(&[&frame[..], &["none.npy"]].concat(), &["none.npy"]);
    let predicted = [&frame[..], &["depth-anything"]].concat();
    let install = [
        "`depth-anything` needs Depth Anything V2 Small",
        "`lsdc weights get anything`",
        "`lsdc weights add FILE`",
    ];
    refused_with(&predicted, &install);
    refused_with(
        &[&predicted[..], &["--head", "published"]].concat(),
        &install,
    );
    let none = [&frame[..], &["none", "--head", "learned"]].concat();
    refused_with(&none, &["`--head`", "--guide depth-anything"]);
    for head in ["learned", "published"] {
        let files = [&frame[..], &["good.npy", "--head", head]].concat();
        refused_with(&files, &["`--head`", "--guide depth-anything"]);
    }
    refused_with(
        &["rgb.png", "sparse.npy", "--head", "learned"],
        &["--guide"],
    );
    refused_with(
        &[&frame[..], &["depth-anything:100"]].concat(),
        &["252 to 518"],
    );
    refused_with(
        &[&frame[..], &["good.npy", "--method", "linear"]].concat(),
        &["--guide"],
    );
    std::fs::create_dir_all(at("images")).unwrap();
    std::fs::create_dir_all(at("points")).unwrap();
    std::fs::copy(at("rgb.png"), at("images/a.png")).unwrap();
    std::fs::copy(at("sparse.npy"), at("points/a.npy")).unwrap();
    refused_with(
        &["images", "points", "--guide", "good.npy"],
        &["--guide", "folder"],
    );
    refused_with(
        &["images", "points", "--guide", "depth-anything:518"],
        &install,
    );
}
