//! Agreement with other libraries on the files of `tests/golden`, which `scripts/golden.py` makes
//! with PIL, OpenCV, NumPy, `SciPy` and scikit-learn.

#![allow(clippy::unwrap_used)]

use image::RgbImage;
use lsdc_classic::{Classic, distances};
use lsdc_eval::data::{DepthMap, Frame};
use lsdc_eval::metrics::{Metric, PairedDifference, Rules, Scores};
use lsdc_eval::sampling::{Interpolation, Pattern, Size, resize_depth, resize_rgb};
use serde_json::Value;
use std::path::Path;

fn golden(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden")
        .join(name);
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn floats(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect()
}

fn size(value: &Value) -> Size {
    let length = |key: &str| value[key].as_u64().unwrap() as usize;
    Size {
        height: length("height"),
        width: length("width"),
    }
}

fn depth(size: Size, value: &Value) -> DepthMap {
    let values = floats(value).into_iter().map(|v| v as f32).collect();
    DepthMap::new(size.width, size.height, values).unwrap()
}

fn rgb(size: Size, value: &Value) -> RgbImage {
    let values = floats(value).into_iter().map(|v| v as u8).collect();
    RgbImage::from_raw(size.width as u32, size.height as u32, values).unwrap()
}

#[test]
fn resizing_is_that_of_pil_and_opencv() {
    let golden = golden("resize.json");
    let source = &golden["source"];
    let from = size(source);
    let (colours, depths) = (rgb(from, &source["rgb"]), depth(from, &source["depth"]));
    let cases = golden["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 20);
    for case in cases {
        let name = case["law"].as_str().unwrap();
        let law = Interpolation::ALL
            .into_iter()
            .find(|law| law.name() == name)
            .unwrap();
        let to = size(case);
        let exact = name.ends_with("nearest");
        let ours = resize_rgb(&colours, to, law).unwrap();
        for (a, b) in ours.as_raw().iter().zip(rgb(to, &case["rgb"]).as_raw()) {
            // Both round weighted means of whole numbers; the last level is a matter of rounding.
            assert!(a.abs_diff(*b) <= u8::from(!exact), "{name} {to}: {a} {b}");
        }
        let ours = resize_depth(&depths, to, law).unwrap();
        for (a, b) in ours.values().iter().zip(depth(to, &case["depth"]).values()) {
            let bound = if exact { 0.0 } else { 2e-6 * b };
            assert!((a - b).abs() <= bound, "{name} {to}: {a} {b}");
        }
    }
}

#[test]
fn measures_are_those_of_scikit_learn() {
    let golden = golden("metrics.json");
    for case in golden["cases"].as_array().unwrap() {
        let size = size(case);
        let rules = Rules {
            see_window: case["window"].as_u64().unwrap() as usize,
            ..Rules::default()
        };
        let (p, d) = (
            depth(size, &case["prediction"]),
            depth(size, &case["truth"]),
        );
        let scores = Scores::of(&p, &d, &rules).unwrap();
        for metric in Metric::ALL {
            let expected = case["expected"][metric.key()].as_f64().unwrap();
            let found = scores[metric];
            assert!(
                (found - expected).abs() < 1e-6 * expected.abs().max(1e-3),
                "{metric:?}: {found} {expected}"
            );
        }
    }
    let pairs = golden["pairs"].as_array().unwrap();
    let pairs = pairs.iter().map(floats).map(|pair| (pair[0], pair[1]));
    let difference = PairedDifference::of(pairs).unwrap();
    let expected = &golden["difference"];
    assert!((difference.low - expected["low"].as_f64().unwrap()).abs() < 1e-8);
    assert!((difference.high - expected["high"].as_f64().unwrap()).abs() < 1e-8);
}

#[test]
fn baselines_are_those_of_scipy_and_opencv() {
    let golden = golden("classic.json");
    let size = size(&golden);
    let (colours, sparse) = (rgb(size, &golden["rgb"]), depth(size, &golden["sparse"]));
    for method in Classic::ALL {
        let expected = &golden["expected"][method.name()];
        if expected.is_null() {
            // No other library has these kernels for scattered points.
            assert_eq!(method, Classic::Steering);
            continue;
        }
        let expected = floats(expected);
        let dense = method.complete(&colours, &sparse).unwrap();
        let off = dense
            .values()
            .iter()
            .zip(&expected)
            // SciPy leaves what is outside the hull to us.
            .filter(|(_, e)| **e > 0.0)
            .filter(|(a, e)| (f64::from(**a) - **e).abs() > 1e-4 * **e)
            .count();
        // Where four points lie on a circle, two triangulations are equally good.
        let allowed = if matches!(method, Classic::Linear | Classic::LinearInverse) {
            expected.len() / 50
        } else {
            0
        };
        assert!(off <= allowed, "{}: {off} pixels differ", method.name());
    }
    for (found, expected) in distances(&sparse).iter().zip(floats(&golden["distances"])) {
        assert!((f64::from(*found) - expected).abs() < 1e-5);
    }
}

#[test]
fn corners_are_those_of_opencv() {
    let golden = &golden("classic.json")["corners"];
    let size = size(golden);
    let ones = DepthMap::new(size.width, size.height, vec![1.0; size.width * size.height]).unwrap();
    let frame = Frame::new("f".into(), rgb(size, &golden["rgb"]), ones).unwrap();
    let found = Pattern::Corners(40).draw(&frame, 0).unwrap();
    let expected = floats(&golden["strongest"]);
    let hits = expected
        .as_chunks::<2>()
        .0
        .iter()
        .filter(|[x, y]| found.at(*x as usize, *y as usize) > 0.0)
        .count();
    // Grey values are rounded differently: the order of nearly equal corners may change.
    assert!(hits >= 37, "{hits} of 40");
}
