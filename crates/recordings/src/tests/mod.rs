//! Recordings of other programs (`scripts/recordings.py`), and damaged ones.

mod containers;
mod damaged;
mod drive;
mod live;
mod remarks;
mod sent;
mod turn;
mod types;

use sent::golden;
use serde_json::Value;

/// Expected values from NumPy and OpenCV.
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
