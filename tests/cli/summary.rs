//! The summary that `lsdc complete` prints.

use super::*;
use serde_json::Value;
use std::fmt::Write as _;

fn told(folder: &Path, args: &[&str]) -> String {
    let mut command = lsdc(folder);
    text(&command.arg("complete").args(args).assert().success())
}

#[test]
fn the_error_to_expect_comes_first_in_plain_words() {
    let folder = room();
    let said = told(folder.path(), &["rgb.png", "sparse.npy", "-o", "out"]);
    let first = said.lines().next().unwrap();
    assert!(first.starts_with("error     0."), "{said}");
    assert!(first.contains("m to expect between the points"), "{said}");
    for word in ["rank", "a guess", "outliers"] {
        assert!(!said.contains(word), "{said}");
    }
    let readme = include_str!("../../README.md");
    for word in ["    error ", "    depth "] {
        let line = readme.lines().find(|line| line.starts_with(word)).unwrap();
        assert!(
            said.contains(line.trim_start()),
            "{line} of the README: {said}"
        );
    }
    let written = "written   rgb_depth.npy, rgb_depth.png, rgb_depth_color.png in out";
    assert_eq!(said.lines().last(), Some(written));
    // With one point, the error between points is unknown; counts are 1.
    std::fs::write(folder.path().join("one.csv"), "u,v,depth\n100,80,2\n").unwrap();
    let said = told(folder.path(), &["rgb.png", "one.csv", "-o", "one.npy"]);
    let first = said.lines().next().unwrap();
    assert!(first.starts_with("error     unknown between"), "{said}");
    assert!(said.contains("points    1\n"), "{said}");
    assert_eq!(said.lines().last(), Some("written   one.npy"));
}

/// Writes the points of the room with 20 of 300 depths doubled, and returns their pixels.
fn spoiled(folder: &Path) -> Vec<(usize, usize)> {
    let sparse = read_npy(&folder.join("sparse.npy"), 1.0).unwrap();
    let mut lines = "u,v,depth\n".to_owned();
    let mut wrong = Vec::new();
    for (i, p) in sparse.points().take(300).enumerate() {
        let depth = if i % 15 == 7 {
            wrong.push((p.x, p.y));
            2.0 * p.depth
        } else {
            p.depth
        };
        writeln!(lines, "{},{},{depth}", p.x, p.y).unwrap();
    }
    std::fs::write(folder.join("spoiled.csv"), lines).unwrap();
    wrong
}

#[test]
fn the_error_of_a_robust_fit_is_that_of_inliers() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let wrong = spoiled(folder.path());
    let robust = [
        "rgb.png",
        "spoiled.csv",
        "--robust",
        "auto",
        "--outliers",
        "-o",
        "robust",
    ];
    let said = told(folder.path(), &robust);
    let report: Value =
        serde_json::from_str(&told(folder.path(), &[&robust[..], &["--json"]].concat())).unwrap();
    let fit = &report["fit"];
    let number = |name: &str| fit[name].as_f64().unwrap();
    let list = std::fs::read_to_string(at("robust/rgb_outliers.csv")).unwrap();
    let outliers = list.lines().count() - 1;
    assert_eq!(fit["outliers"], outliers);
    let listed = wrong
        .iter()
        .filter(|(x, y)| list.contains(&format!("\n{x},{y},")));
    assert!(listed.count() >= wrong.len() - 2, "{list}");
    // The error over all points reflects the outliers.
    assert!(
        number("leave_one_out_inliers") < 0.5 * number("leave_one_out"),
        "{fit}"
    );
    let (inliers, all) = (number("leave_one_out_inliers"), number("leave_one_out"));
    let (at, with) = (number("residual_inliers"), number("residual"));
    assert!(at < 0.5 * with, "{fit}");
    let words = format!(
        "error     {inliers:.4} m to expect between the points (leave-one-out), {at:.4} m at the points; \
         {all:.4} and {with:.4} m with {outliers} outliers\n"
    );
    assert!(said.contains(&words), "{said}");
    let words = format!("outliers  {outliers} points disagree with the others; listed in robust");
    assert!(said.contains(&words), "{said}");
    assert!(!said.contains("--robust auto"), "{said}");
    // Without a list, the summary says how to get one; a plain fit gets a hint at the robust one.
    let said = told(
        folder.path(),
        &["rgb.png", "spoiled.csv", "--robust", "auto", "-o", "b"],
    );
    assert!(said.contains("; --outliers lists them\n"), "{said}");
    let said = told(
        folder.path(),
        &["rgb.png", "spoiled.csv", "--outliers", "-o", "plain"],
    );
    assert!(said.contains("csv; --robust auto limits"), "{said}");
    // The list of outliers is not taken for points.
    let again = [
        "complete",
        "rgb.png",
        "robust/rgb_outliers.csv",
        "-o",
        "again",
    ];
    refused(
        folder.path(),
        &again,
        &["is a list of outliers", "--robust auto"],
    );
}

#[test]
fn colours_span_the_middle_of_the_depths_and_say_so() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    // A single far point does not change the colour scale.
    let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
    let mut points: Vec<_> = sparse.points().collect();
    points[3].depth = 60.0;
    let stray = DepthMap::from_points(sparse.width(), sparse.height(), &points);
    write_npy(&at("stray.npy"), &stray).unwrap();
    let args = ["rgb.png", "stray.npy", "--method", "nearest", "-o", "out"];
    let said = told(folder.path(), &args);
    let depth = read_npy(&at("out/rgb_depth.npy"), 1.0).unwrap();
    let mut sorted = depth.values().to_vec();
    sorted.sort_by(f32::total_cmp);
    let at_share = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
    let (low, high) = (at_share(0.01), at_share(0.99));
    assert!(high < 15.0 && *sorted.last().unwrap() == 60.0);
    let words = format!("colours   {low:.3} m (blue) to {high:.3} m (red)\n");
    assert!(said.contains(&words), "{said}");
    let file = std::fs::read(at("out/rgb_depth_color.png")).unwrap();
    let chunk = format!("Depths of the colour scale\0{low},{high}");
    assert!(
        file.windows(chunk.len())
            .any(|part| part == chunk.as_bytes())
    );
    let found = lsdc_eval::data::read_rgb(&at("out/rgb_depth_color.png")).unwrap();
    assert_eq!(
        found,
        lsdc_eval::report::colour_map(&depth, low, high, "m").unwrap()
    );
    let report: Value = serde_json::from_str(&told(
        folder.path(),
        &[&args[..], &["--json", "--range", "1,9", "--force"]].concat(),
    ))
    .unwrap();
    assert_eq!(report["color_range"], serde_json::json!([1.0, 9.0]));
}
