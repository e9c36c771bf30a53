//! Meshes and the up axis.

use lsdc_core::Camera;
use std::fmt::{Display, Formatter};
use std::io::Write;
use std::str::FromStr;

/// A triangle mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// x, y and z of each vertex in the world.
    pub positions: Vec<[f64; 3]>,
    /// The unit normal of each vertex, on the side from which the surface was seen.
    pub normals: Vec<[f32; 3]>,
    /// Red, green and blue of each vertex in sRGB, if any frame had an image.
    pub colours: Option<Vec<[u8; 3]>>,
    /// Number of vertices with [`Self::UNKNOWN_COLOUR`], which no frame with an image measured.
    pub uncoloured: usize,
    /// Three vertices per triangle, counter-clockwise seen from the side of the normals; empty for a point cloud.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The colour of vertices that no frame with an image measured.
    pub const UNKNOWN_COLOUR: [u8; 3] = [128; 3];

    /// The vertices alone, as a point cloud with normals.
    #[must_use]
    pub fn into_points(self) -> Self {
        Self {
            triangles: Vec::new(),
            ..self
        }
    }

    /// Writes a binary PLY file. Coordinates are float32, or float64 if any exceeds 1000.
    ///
    /// # Errors
    /// `out` cannot be written.
    pub fn write_ply(&self, out: &mut dyn Write) -> std::io::Result<()> {
        crate::ply::write(self, out)
    }

    /// Writes a binary glTF 2.0 file (GLB). The coordinates in it are those of the world; its only node rotates `up` to the y
    /// axis, which is up in glTF. Coordinates are float32, so coordinates beyond 1000 are stored relative to the node.
    ///
    /// # Errors
    /// `out` cannot be written, or the file has more than 4 GiB.
    pub fn write_glb(&self, up: Up, out: &mut dyn Write) -> std::io::Result<()> {
        crate::glb::write(self, up, out)
    }

    /// Whether float32 rounds a coordinate by more than 0.03 mm, because it exceeds 1000 m.
    pub(crate) fn is_far(&self) -> bool {
        self.positions.iter().flatten().any(|v| v.abs() > 1000.0)
    }
}

/// The up axis of the world: `x`, `-x`, `y`, `-y`, `z` or `-z`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Up {
    axis: usize,
    negative: bool,
}

impl Up {
    /// The axis nearest to the mean upward direction of the images; `None` without cameras. It is right unless most cameras are
    /// tilted by more than 45 degrees.
    pub fn of_cameras<'a>(cameras: impl IntoIterator<Item = &'a Camera>) -> Option<Self> {
        let mut sum = [0.0; 3];
        for camera in cameras {
            let (rotation, _) = camera.pose();
            for (sum, down) in sum.iter_mut().zip(rotation[1]) {
                *sum -= down;
            }
        }
        let axis = (0..3).max_by(|&a, &b| f64::total_cmp(&sum[a].abs(), &sum[b].abs()))?;
        (sum[axis] != 0.0).then_some(Self {
            axis,
            negative: sum[axis] < 0.0,
        })
    }

    /// The rotation matrix, row by row, that rotates this axis to y.
    pub fn to_y(self) -> [[f64; 3]; 3] {
        let s = if self.negative { -1.0 } else { 1.0 };
        match self.axis {
            0 => [[0.0, -s, 0.0], [s, 0.0, 0.0], [0.0, 0.0, 1.0]],
            1 => [[1.0, 0.0, 0.0], [0.0, s, 0.0], [0.0, 0.0, s]],
            _ => [[1.0, 0.0, 0.0], [0.0, 0.0, s], [0.0, -s, 0.0]],
        }
    }
}

const AXES: [&str; 3] = ["x", "y", "z"];

impl Display for Up {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let sign = if self.negative { "-" } else { "" };
        write!(f, "{sign}{}", AXES[self.axis])
    }
}

impl FromStr for Up {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let name = text.strip_prefix('-').unwrap_or(text);
        let axis = AXES.iter().position(|axis| *axis == name);
        axis.map(|axis| Self {
            axis,
            negative: name.len() < text.len(),
        })
        .ok_or_else(|| format!("`{text}` is no axis; x, -x, y, -y, z or -z"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_axis_is_turned_up_without_a_mirror() {
        for name in ["x", "-x", "y", "-y", "z", "-z"] {
            let up: Up = name.parse().unwrap();
            assert_eq!(up.to_string(), name);
            let mut direction = [0.0; 3];
            direction[up.axis] = if up.negative { -1.0 } else { 1.0 };
            let [x, y, z] = up.to_y();
            let turned = [x, y, z].map(|row| (0..3).map(|i| row[i] * direction[i]).sum::<f64>());
            assert_eq!(turned, [0.0, 1.0, 0.0], "{name}");
            let cross = [0, 1, 2]
                .map(|i| x[(i + 1) % 3] * y[(i + 2) % 3] - x[(i + 2) % 3] * y[(i + 1) % 3]);
            assert_eq!(cross, z, "{name}");
        }
        assert!("up".parse::<Up>().is_err() && "--z".parse::<Up>().is_err());
    }

    #[test]
    fn cameras_are_held_upright() {
        // The camera looks along x, and z is up.
        let rotation = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]];
        let camera = Camera::pinhole([1.0, 1.0], [0.0, 0.0]);
        let turned = camera.clone().with_pose(rotation, [1.0, 2.0, 3.0]);
        assert_eq!(Up::of_cameras([&turned]).unwrap().to_string(), "z");
        assert_eq!(Up::of_cameras([&camera]).unwrap().to_string(), "-y");
        assert_eq!(Up::of_cameras([]), None);
    }
}
