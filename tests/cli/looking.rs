//! `lsdc inspect`, `lsdc completions` and `lsdc man`.

use super::*;

#[test]
fn files_are_described() {
    let folder = room();
    let inspect = |args: &[&str]| {
        let run = lsdc(folder.path()).arg("inspect").args(args).assert();
        text(&run.success())
    };
    let told = inspect(&["rgb.png", "sparse.npy"]);
    let depth = read_npy(&asset("sparse.npy"), 1.0).unwrap();
    let (width, height) = (depth.width(), depth.height());
    for words in [
        format!("image     {width}x{height}, 8 bits, 3 channels"),
        format!("depths    {width}x{height}, 500 pixels"),
        "unit      metres\n".to_owned(),
    ] {
        assert!(told.contains(&words), "{told}");
    }
    // The histogram counts every depth.
    let found: serde_json::Value =
        serde_json::from_str(&inspect(&["sparse.npy", "--json"])).unwrap();
    let bars = found["histogram"].as_array().unwrap();
    assert_eq!(bars.iter().map(|n| n.as_u64().unwrap()).sum::<u64>(), 500);
    assert_eq!(found["points"], 500);
    let (low, high) = depth.range().unwrap();
    assert_eq!(found["lowest"].as_f64().unwrap() as f32, low);
    assert_eq!(found["highest"].as_f64().unwrap() as f32, high);
    let shown = inspect(&["sparse.npy", "--show"]);
    assert_eq!(shown.matches('\u{2580}').count() % 72, 0);
    let rooms = inspect(&["--dataset", "rooms"]);
    assert!(rooms.contains("train") && rooms.contains("val"), "{rooms}");
    refused(folder.path(), &["inspect", "nothing.npy"], &["nothing.npy"]);
    refused(folder.path(), &["inspect"], &["<FILES>"]);
}

#[test]
fn cameras_clouds_and_floats_are_described() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let depth = DepthMap::new(4, 3, vec![1.5; 12]).unwrap();
    lsdc_eval::data::write_tiff(&at("depth.tiff"), &depth).unwrap();
    std::fs::write(at("scan.xyz"), "1 2 3\n-4 5 6\n").unwrap();
    std::fs::write(at("camera.toml"), "fx = 5\nfy = 6\ncx = 2\ncy = 1\n").unwrap();
    std::fs::write(at("points.csv"), "1,2,3000\n2,2,3100\n").unwrap();
    for (name, words) in [
        ("depth.tiff", &["depths    4x3, 12 pixels"][..]),
        ("scan.xyz", &["cloud     2 points", "-4.000 to 1.000"]),
        (
            "camera.toml",
            &["camera    fx 5, fy 6, cx 2, cy 1, pinhole"],
        ),
        ("points.csv", &["points    2", "if these are pixels"]),
    ] {
        let run = lsdc(folder.path()).args(["inspect", name]).assert();
        let told = text(&run.success());
        for word in words {
            assert!(told.contains(word), "{told}");
        }
    }
}

#[test]
fn a_dataset_with_one_split_is_described() {
    let folder = tempfile::tempdir().unwrap();
    let val = folder.path().join("val");
    std::fs::create_dir(&val).unwrap();
    let image = image::RgbImage::new(4, 3);
    image.save(val.join("a.jpg")).unwrap();
    let depth = DepthMap::new(4, 3, vec![1.5; 12]).unwrap();
    lsdc_eval::data::write_depth_png(&val.join("a_depth.png"), &depth, 0.001).unwrap();
    let inspect = ["inspect", "--dataset", "folder", "--root", "."];
    let run = lsdc(folder.path()).args(inspect).assert().success();
    let told = text(&run);
    assert!(told.contains("train     none: no `train` frame"), "{told}");
    assert!(told.contains("val       1 frame,"), "{told}");
}

#[test]
fn base_functions_are_drawn() {
    let folder = room();
    let args = ["inspect", "rgb.png", "--bases", "functions.png"];
    lsdc(folder.path()).args(args).assert().success();
    // The image and 30 functions in rows of five, at twice the size of the drawing.
    let sheet = image::open(folder.path().join("functions.png")).unwrap();
    assert!(sheet.width() > 5 * 2 * 200 && sheet.height() > sheet.width());
    refused(
        folder.path(),
        &args,
        &["functions.png", "exists", "--force"],
    );
    let args = ["inspect", "rgb.png", "--bases", "functions.jpg"];
    refused(folder.path(), &args, &["neither .svg nor .png"]);
}

#[test]
fn the_command_line_is_written_for_shells_and_man() {
    let folder = tempfile::tempdir().unwrap();
    for (shell, words) in [
        ("bash", "complete -F"),
        ("zsh", "#compdef lsdc"),
        ("fish", "complete -c lsdc"),
    ] {
        let run = lsdc(folder.path()).args(["completions", shell]).assert();
        assert!(text(&run.success()).contains(words), "{shell}");
    }
    let run = lsdc(folder.path()).args(["man", "-o", "man"]).assert();
    run.success();
    let pages = names(&folder.path().join("man"));
    for page in ["lsdc.1", "lsdc-complete.1", "lsdc-report-merge.1"] {
        assert!(
            pages.iter().any(|name| name == page),
            "{page} is missing in {pages:?}"
        );
    }
    let page = std::fs::read_to_string(folder.path().join("man/lsdc-complete.1")).unwrap();
    assert!(page.contains("max\\-sigma"), "every option is in the page");
}

#[test]
fn help_shows_few_flags_first_and_all_in_groups() {
    let folder = tempfile::tempdir().unwrap();
    let help = |args: &[&str]| text(&lsdc(folder.path()).args(args).assert().success());
    let flags = |help: &str| {
        help.lines()
            .filter(|l| l.trim_start().starts_with('-'))
            .count()
    };
    let short = help(&["complete", "-h"]);
    for flag in [
        "--output",
        "--formats",
        "--depth-unit",
        "--camera",
        "--robust",
        "--size",
        "--noise",
        "--uncertainty",
        "--outliers",
        "--force",
    ] {
        assert!(short.contains(flag), "{short}");
    }
    // These, --guide, --help and --version, each on a few lines.
    assert!(flags(&short) <= 13, "{short}");
    assert!(short.lines().count() <= 40, "{short}");
    for command in ["complete", "view", "serve"] {
        let long = help(&[command, "--help"]);
        let words = long.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains("[default: `default`, the most"), "{words}");
        assert!(words.contains("--guide"), "{words}");
    }
    assert!(short.contains("shows every option"));
    let long = help(&["complete", "--help"]);
    assert!(flags(&long) > 20, "{long}");
    for group in [
        "Input:",
        "Fit:",
        "Network:",
        "Output:",
        "Several frames:",
        "Hardware:",
    ] {
        assert!(long.lines().any(|line| line == group), "{group}: {long}");
    }
    for command in ["eval", "train", "experiment"] {
        let (short, long) = (help(&[command, "-h"]), help(&[command, "--help"]));
        assert!(
            flags(&short) <= 9 && flags(&short) < flags(&long),
            "{short}"
        );
        assert!(
            long.contains("Output:") && long.contains("Hardware:"),
            "{long}"
        );
    }
}
