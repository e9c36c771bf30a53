//! `lsdc weights`.

use super::*;
use lsdc::metrics::{Metric, Rules, Scores};

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
fn all_weights_of_the_program_are_better_than_none() {
    let folder = room();
    let at = folder.path();
    let truth = read_npy(&asset("depth.npy"), 1.0).unwrap();
    let rmse = |with: &[&str], output: &str| {
        lsdc(at)
            .args(["complete", "rgb.png", "sparse.npy", "-o", output])
            .args(with)
            .assert()
            .success();
        let depth = read_npy(&at.join(output).join("rgb_depth.npy"), 1.0).unwrap();
        let scores = Scores::of(&depth, &truth, &Rules::default()).unwrap();
        scores[Metric::Rmse]
    };
    let linear = rmse(&["--method", "linear"], "linear");
    let list = text(&lsdc(at).args(["weights", "list"]).assert().success());
    let names: Vec<&str> = list.lines().filter_map(|l| l.split(' ').next()).collect();
    assert_eq!(names, ["default", "small"]);
    for name in names {
        let error = rmse(&["--weights", name], name);
        assert!(error < 0.9 * linear, "{name}: {error} m, linear {linear} m");
    }
}
