//! Inverse depths of 3-D Gaussian splatting as published: a 16-bit PNG for each image, and `depth_params.json`.
//!
//! Its loader computes inverse depth = value / 65536 x scale + offset (`utils/camera_utils.py`, `scene/cameras.py`), and
//! skips images whose scale is not between a fifth and five times the median. Hence all images have the same scale here,
//! and the offset is 0.

use crate::error::Result;
use crate::files::encode_grey16;
use lsdc_core::DepthMap;
use serde_json::{Map, Value, json};

/// Folder for `-d`, next to `images`.
pub(super) const FOLDER: &str = "depths";

pub(super) const PARAMETERS: &str = "sparse/0/depth_params.json";

/// Divisor of the loader, although the largest value is one less.
const STEPS: f64 = 65536.0;

/// How many times nearer than the nearest points of the model a depth may be. The resolution of inverse depth is 6e-5 of
/// that of the nearest points.
const MARGIN: f64 = 4.0;

/// Inverse depth = value / 65536 x `scale`, in units of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct InverseDepth {
    scale: f64,
}

impl InverseDepth {
    /// Creates the coding for a model whose points are at least at this depth.
    pub(super) fn of_nearest(nearest: f64) -> Self {
        Self {
            scale: MARGIN / nearest,
        }
    }

    /// Encodes a depth map, row by row; 0 means no depth. Also returns how many pixels are nearer than the largest value,
    /// and farther than half of the smallest; they are clamped to these values.
    pub(super) fn encode(self, depth: &DepthMap) -> (Vec<u16>, [usize; 2]) {
        let (mut nearest, mut farthest) = (0, 0);
        let value = |&depth: &f32| {
            if depth == 0.0 {
                return 0;
            }
            let value = (STEPS / (f64::from(depth) * self.scale)).round();
            nearest += usize::from(value >= STEPS);
            farthest += usize::from(value < 1.0);
            value.clamp(1.0, STEPS - 1.0) as u16
        };
        let values = depth.values().iter().map(value).collect();
        (values, [nearest, farthest])
    }

    /// Returns the PNG file of these values.
    pub(super) fn png(self, depth: &DepthMap, values: &[u16]) -> Result<Vec<u8>> {
        let text = ("Inverse depth", format!("value / {STEPS} x {}", self.scale));
        encode_grey16((depth.width(), depth.height()), values, text)
    }

    /// Returns `depth_params.json` for images of these names without their extensions.
    pub(super) fn parameters<'a>(self, stems: impl Iterator<Item = &'a str>) -> String {
        let entry = json!({"scale": self.scale, "offset": 0.0});
        let entries: Map<String, Value> =
            stems.map(|stem| (stem.to_owned(), entry.clone())).collect();
        format!("{:#}\n", Value::Object(entries))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The loader: `cv2.imread(...).astype(np.float32) / float(2**16)`, then `invdepthmap * scale + offset` if the scale is
    /// within a factor of five of the median.
    fn decoded(values: &[u16], parameters: &Value) -> Vec<f64> {
        let number = |name: &str| parameters[name].as_f64().unwrap();
        let normalised = values
            .iter()
            .map(|value| f64::from(*value) / 2_f64.powi(16));
        let values = normalised.map(|value| value * number("scale") + number("offset"));
        values.collect()
    }

    #[test]
    fn the_loader_decodes_inverse_depths() {
        let code = InverseDepth::of_nearest(0.5);
        let depths = [0.0, 0.13, 0.5, 1.0, 3.7, 41.0, 900.0];
        let depth = DepthMap::new(7, 1, depths.to_vec()).unwrap();
        let (values, counts) = code.encode(&depth);
        assert_eq!(counts, [0, 0]);
        let text = code.parameters(["a/b", "c"].into_iter());
        let parameters: Value = serde_json::from_str(&text).unwrap();
        // One step of the coding is 8 / 65536.
        for name in ["a/b", "c"] {
            let found = decoded(&values, &parameters[name]);
            assert_eq!(found[0], 0.0);
            for (found, depth) in found.iter().zip(depths).skip(1) {
                let error = (found - f64::from(depth).recip()).abs();
                assert!(error <= 0.5 * 8.0 / 65536.0, "{depth}: {error}");
            }
        }
    }

    #[test]
    fn powers_of_two_are_decoded_exactly() {
        let code = InverseDepth::of_nearest(1.0);
        let depths = [0.5, 1.0, 2.0, 4.0, 1024.0];
        let depth = DepthMap::new(5, 1, depths.to_vec()).unwrap();
        let parameters = code.parameters(std::iter::once("a"));
        let parameters: Value = serde_json::from_str(&parameters).unwrap();
        let found = decoded(&code.encode(&depth).0, &parameters["a"]);
        assert_eq!(found, [2.0, 1.0, 0.5, 0.25, 1.0 / 1024.0]);
    }

    #[test]
    fn depths_beyond_the_code_are_counted() {
        let code = InverseDepth::of_nearest(1.0);
        let depth = DepthMap::new(4, 1, vec![0.2, 0.25, 30000.0, 40000.0]).unwrap();
        let (values, counts) = code.encode(&depth);
        assert_eq!(values, [65535, 65535, 1, 1]);
        assert_eq!(counts, [2, 1]);
    }
}
