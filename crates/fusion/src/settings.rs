//! How frames are fused.

use crate::error::{Error, Result};

/// How frames are fused. Lengths are in the unit of depths and poses: metres, unless a model has a unit of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The edge length of a voxel; `None` derives it from the data ([`voxel_size`](crate::voxel_size)).
    pub voxel: Option<f64>,
    /// The truncation distance in standard deviations of the depth: distances beyond are cut off in front of the surface,
    /// and not measured behind it. Measurements of one surface are averaged if they differ by less.
    pub truncation_deviations: f64,
    /// The least and the largest truncation distance in voxels. Surfaces nearer to each other, back to back, disturb each
    /// other.
    pub truncation_voxels: [f64; 2],
    /// The standard deviation of depths that have none, as a part of the depth.
    pub default_deviation: f64,
    /// Pixels whose standard deviation is a larger part of their depth are left out.
    pub max_deviation: f64,
    /// Pixels of larger depth are left out.
    pub max_depth: f64,
    /// Pixels whose surface is seen at a larger angle to its normal, in degrees, are left out.
    pub max_angle: f64,
    /// Bytes that the voxels may take.
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
            // Both ends of an edge that crosses the surface, and their neighbours for the normal, are within two diagonals.
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
