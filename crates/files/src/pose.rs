//! Poses: a rotation matrix and a translation.

/// A rigid transform: a point is first rotated, then translated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The rotation matrix, row by row.
    pub rotation: [[f64; 3]; 3],
    /// The translation, in the unit of the world.
    pub translation: [f64; 3],
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

    /// Reads the pose from the 3 or 4 rows of a matrix.
    ///
    /// # Errors
    /// The number of rows differs, or the first columns are not a rotation; the text follows a name.
    pub(crate) fn of_rows(rows: &[[f64; 4]]) -> Result<Self, String> {
        /// Largest deviation from 1 of the product with its transpose; files contain rounded numbers.
        const NEAR: f64 = 1e-3;
        let (Some(&[a, b, c]), 3 | 4) = (rows.first_chunk(), rows.len()) else {
            return Err(format!(
                "has a pose of {} rows, expected 3 or 4",
                rows.len()
            ));
        };
        let rotation = [a, b, c].map(|row| [row[0], row[1], row[2]]);
        for i in 0..3 {
            for j in 0..3 {
                let deviation =
                    (dot(rotation[i], rotation[j]) - Self::IDENTITY.rotation[i][j]).abs();
                if deviation.is_nan() || deviation > NEAR {
                    return Err("has a pose whose first three columns are no rotation".to_owned());
                }
            }
        }
        let [x, y, z] = rotation;
        if dot(cross(x, y), z) < 0.0 {
            return Err("has a pose that mirrors the world: its axes are left-handed".to_owned());
        }
        Ok(Self {
            rotation,
            translation: [a[3], b[3], c[3]],
        })
    }

    /// The inverse transform.
    #[must_use]
    pub fn inverse(self) -> Self {
        let rotation = [0, 1, 2].map(|j| self.rotation.map(|row| row[j]));
        Self {
            rotation,
            translation: rotation.map(|row| -dot(row, self.translation)),
        }
    }

    /// Returns the angle to another rotation in degrees, and the distance between both origins in the world.
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

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Returns the rotation matrix, row by row, of a quaternion x, y, z, w of length 1.
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
