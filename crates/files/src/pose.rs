//! Poses: a rotation matrix and a translation.

/// A rigid transform: a point is first rotated, then translated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pose {
    /// Row by row.
    pub(crate) rotation: [[f64; 3]; 3],
    pub(crate) translation: [f64; 3],
}

impl Pose {
    pub(crate) const IDENTITY: Self = Self {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    };

    /// The transform that applies `first`, then this one.
    pub(crate) fn after(self, first: Self) -> Self {
        let columns = [0, 1, 2].map(|j| first.rotation.map(|row| row[j]));
        let moved = self.rotation.map(|row| dot(row, first.translation));
        Self {
            rotation: self
                .rotation
                .map(|row| columns.map(|column| dot(row, column))),
            translation: [0, 1, 2].map(|i| moved[i] + self.translation[i]),
        }
    }

    /// The inverse transform.
    pub(crate) fn inverse(self) -> Self {
        let rotation = [0, 1, 2].map(|j| self.rotation.map(|row| row[j]));
        Self {
            rotation,
            translation: rotation.map(|row| -dot(row, self.translation)),
        }
    }

    /// The angle to another rotation in degrees, and the distance between both origins in the world.
    pub(crate) fn difference(self, other: Self) -> (f64, f64) {
        let squared_distance = |a: &[f64; 3], b: &[f64; 3]| {
            let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
            squares.sum::<f64>()
        };
        // |A - B| of rotations is sqrt(8) sin(angle / 2).
        let rows = self.rotation.iter().zip(&other.rotation);
        let chord = rows
            .map(|(a, b)| squared_distance(a, b))
            .sum::<f64>()
            .sqrt();
        let angle = 2.0 * (chord / 8.0_f64.sqrt()).min(1.0).asin();
        let [a, b] = [self, other].map(|pose| pose.inverse().translation);
        (angle.to_degrees(), squared_distance(&a, &b).sqrt())
    }
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The rotation matrix, row by row, of a quaternion x, y, z, w of length 1.
pub fn rotation_matrix([x, y, z, w]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - z * w),
            2.0 * (x * z + y * w),
        ],
        [
            2.0 * (x * y + z * w),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - x * w),
        ],
        [
            2.0 * (x * z - y * w),
            2.0 * (y * z + x * w),
            1.0 - 2.0 * (x * x + y * y),
        ],
    ]
}
