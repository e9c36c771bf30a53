//! Settings of fusion.

use crate::error::{Error, Result};

/// Settings of fusion. Lengths are in the unit of depths and poses: metres, unless a model has another unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The edge length of a voxel; `None` derives it from the data ([`voxel_size`](crate::voxel_size)).
    pub voxel: Option<f64>,
    /// The truncation distance in standard deviations of the depth: larger distances are clamped in front of the surface, and
    /// ignored behind it. Measurements of one surface are averaged if they differ by less.
    pub truncation_deviations: f64,
    /// The smallest and largest truncation distance in voxels. Opposite surfaces that are closer to each other interfere.
    pub truncation_voxels: [f64; 2],
    /// The standard deviation of depths without one, as a share of the depth.
    pub default_deviation: f64,
    /// Pixels whose standard deviation is a larger share of their depth are skipped.
    pub max_deviation: f64,
    /// Pixels with a larger depth are skipped.
    pub max_depth: f64,
    /// Pixels with a larger angle between ray and normal, in degrees, are skipped.
    pub max_angle: f64,
    /// Memory limit of the voxels in bytes.
    pub max_memory: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            voxel: None,
            truncation_deviations: 3.0,
            truncation_voxels: [4.0, 8.0],
            default_deviation: 0.01,
            max_deviation: 0.1,
            max_depth: f64::INFINITY,
            max_angle: 80.0,
            max_memory: 4 << 30,
        }
    }
}

impl Settings {
    pub(crate) fn check(&self) -> Result<()> {
        let positive = |v: f64| v > 0.0 && v.is_finite();
        let [least, largest] = self.truncation_voxels;
        let checks = [
            ("voxel", self.voxel.is_none_or(positive), "above 0"),
            (
                "truncation_deviations",
                self.truncation_deviations >= 0.0 && self.truncation_deviations.is_finite(),
                "0 or above",
            ),
            // Both ends of an edge that crosses the surface, and the neighbours that its normal needs, are within two
            // diagonals.
            (
                "truncation_voxels",
                least >= 2.0 && largest >= least && largest <= 64.0,
                "from 2 to 64, in ascending order",
            ),
            (
                "default_deviation",
                positive(self.default_deviation),
                "above 0",
            ),
            ("max_deviation", self.max_deviation > 0.0, "above 0"),
            ("max_depth", self.max_depth > 0.0, "above 0"),
            (
                "max_angle",
                self.max_angle > 0.0 && self.max_angle <= 90.0,
                "above 0 and at most 90",
            ),
        ];
        match checks.into_iter().find(|(_, is_valid, _)| !is_valid) {
            None => Ok(()),
            Some((setting, _, expected)) => Err(Error::Setting { setting, expected }),
        }
    }
}
