//! Depth cameras: noise models, and pixels left empty.

use super::inputs::write_model;
use super::*;
use image::{ImageBuffer, Luma};
use serde_json::Value;

/// Writes the points of the room in millimetres, without the unit in the file, as other programs do.
fn write_millimetres(path: &Path) -> DepthMap {
    let sparse = read_npy(&asset("sparse.npy"), 1.0).unwrap();
    let stored = |x: u32, y: u32| (sparse.at(x as usize, y as usize) * 1000.0).round() as u16;
    let (width, height) = (sparse.width() as u32, sparse.height() as u32);
    let image = ImageBuffer::from_fn(width, height, |x, y| Luma([stored(x, y)]));
    image.save(path).unwrap();
    let metres = image.iter().map(|&v| (f64::from(v) * 0.001) as f32);
    DepthMap::new(sparse.width(), sparse.height(), metres.collect()).unwrap()
}

fn report(folder: &Path, args: &[&str]) -> Value {
    let mut command = lsdc(folder);
    let run = command.arg("complete").args(args).arg("--json").assert();
    serde_json::from_str(&text(&run.success())).unwrap()
}

#[test]
fn noise_by_name_is_that_of_its_formula() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let depths = write_millimetres(&at("mm.png"));
    let camera = ["rgb.png", "mm.png", "--depth-unit", "mm"];
    // Nguyen, Izadi and Lovell (2012).
    let sigma = |d: f32| {
        let z = f64::from(d);
        if z > 0.0 {
            (0.0012 + 0.0019 * (z - 0.4).powi(2)) as f32
        } else {
            0.0
        }
    };
    let sigmas = depths.values().iter().map(|d| sigma(*d)).collect();
    let sigmas = DepthMap::new(depths.width(), depths.height(), sigmas).unwrap();
    write_npy(&at("sigma.npy"), &sigmas).unwrap();
    // Standard deviations in the unit of the depths.
    let millimetres = sigmas.values().iter().map(|s| s * 1000.0).collect();
    let millimetres = DepthMap::new(depths.width(), depths.height(), millimetres).unwrap();
    write_npy(&at("sigma.npy"), &millimetres).unwrap();
    let run = |out: &str, more: &[&str]| {
        let found = report(folder.path(), &[&camera[..], &["-o", out], more].concat());
        (
            found,
            read_npy(&at(out).join("rgb_depth.npy"), 1.0).unwrap(),
        )
    };
    let (_, plain) = run("plain", &[]);
    let (_, expected) = run("sigma", &["--sigma", "sigma.npy"]);
    let (found, named) = run("named", &["--noise", "kinect"]);
    let (_, numbers) = run("numbers", &["--noise", "0.001504,-0.00152,0.0019"]);
    assert_eq!(named, numbers);
    let off = |a: &DepthMap, b: &DepthMap| {
        let pairs = a.values().iter().zip(b.values());
        pairs.fold(0.0, |most: f32, (a, b)| most.max((a - b).abs() / b))
    };
    assert!(off(&named, &expected) < 1e-5, "{}", off(&named, &expected));
    assert!(off(&named, &plain) > 1e-3, "{}", off(&named, &plain));
    assert_eq!(found["noise"]["name"], "kinect");
    assert_eq!(found["noise"]["points"], 500);
    assert_eq!(found["noise"]["coefficients"][2], 0.0019);
    let told = [
        &["complete"],
        &camera[..],
        &["--noise", "tof", "-o", "told"],
    ]
    .concat();
    let told = text(&lsdc(folder.path()).args(told).assert().success());
    let words = "noise     tof: 0.0015 - 0.0005 z + 0.0003 z^2 m at 500 points";
    assert!(told.contains(words), "{told}");
}

#[test]
fn noise_in_metres_needs_a_unit_that_is_known() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    write_millimetres(&at("mm.png"));
    let guessed = ["complete", "rgb.png", "mm.png", "--noise", "kinect"];
    let words = ["a guess: millimetres", "hint: give --depth-unit"];
    refused(folder.path(), &guessed, &words);
    // Floats are assumed to be in metres, as documented, unless that is implausible.
    let sparse = read_npy(&at("sparse.npy"), 1.0).unwrap();
    let far = sparse.values().iter().map(|d| d * 1000.0).collect();
    let far = DepthMap::new(sparse.width(), sparse.height(), far).unwrap();
    write_npy(&at("far.npy"), &far).unwrap();
    let far = ["complete", "rgb.png", "far.npy", "--noise", "kinect"];
    refused(folder.path(), &far, &["a guess: metres"]);
    let metres = ["complete", "rgb.png", "sparse.npy", "--noise", "kinect"];
    lsdc(folder.path()).args(metres).assert().success();
    image::RgbImage::new(32, 24).save(at("x.png")).unwrap();
    write_model(&at("model"), "1 1 0 0 0 0 0 0 1 x.png\n4.5 3.5 1\n");
    let model = ["complete", "x.png", "model", "--noise", "tof"];
    refused(folder.path(), &model, &["unit of the model"]);
    for (model, words) in [
        ("d435", "kinect, realsense, tof"),
        ("1,2", "A,B,C"),
        ("-1,0,0", "not positive"),
    ] {
        let args = ["complete", "rgb.png", "sparse.npy", "--noise", model];
        refused(folder.path(), &args, &[words]);
    }
    let classic = [&metres[..], &["--method", "wls"]].concat();
    refused(
        folder.path(),
        &classic,
        &["`--noise`", "need method `lsdc`"],
    );
}

#[test]
fn pixels_above_the_largest_deviation_are_left_empty() {
    let folder = room();
    let at = |name: &str| folder.path().join(name);
    let args = ["rgb.png", "sparse.npy", "--uncertainty", "-o", "out"];
    let cut = [&args[..], &["--max-sigma", "0.15"]].concat();
    let report = report(folder.path(), &cut);
    let depth = read_npy(&at("out/rgb_depth.npy"), 1.0).unwrap();
    let sigma = read_npy(&at("out/rgb_sigma.npy"), 1.0).unwrap();
    let png = lsdc_eval::data::read_depth_png(&at("out/rgb_depth.png"), 0.001).unwrap();
    let mut empty = 0;
    for (i, sigma) in sigma.values().iter().enumerate() {
        let is_empty = *sigma > 0.15;
        assert_eq!(depth.values()[i] == 0.0, is_empty);
        assert_eq!(png.values()[i] == 0.0, is_empty);
        empty += usize::from(is_empty);
    }
    assert!(empty > 100 && empty < 304 * 228 - 100, "{empty}");
    assert_eq!(report["left_empty"]["pixels"], empty);
    let told = [&["complete"], &cut[..]].concat();
    let told = text(&lsdc(folder.path()).args(told).assert().success());
    let words = format!("{empty} pixels left empty: standard deviation above 0.15 m");
    assert!(told.contains(&words), "{told}");
    let all = ["complete", "rgb.png", "sparse.npy", "--max-sigma", "1e-6"];
    refused(
        folder.path(),
        &all,
        &["every pixel", "the least is 0.", "hint:"],
    );
    let none = ["complete", "rgb.png", "sparse.npy", "--max-sigma", "0"];
    refused(
        folder.path(),
        &none,
        &["no standard deviation", "as in 0.2"],
    );
}
