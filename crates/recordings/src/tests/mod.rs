//! Recordings of other programs (`scripts/recordings.py`), and damaged ones.

mod containers;
mod damaged;
mod drive;
mod live;
mod remarks;
mod turn;
mod types;

use serde_json::Value;
use std::path::{Path, PathBuf};

/// A recording of `scripts/recordings.py`.
fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/golden/recordings")
        .join(name)
}

/// What NumPy and OpenCV make of them.
fn expected() -> Value {
    let text = std::fs::read_to_string(golden("expected.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect()
}
