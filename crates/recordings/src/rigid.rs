//! Rigid transforms.

use lsdc_files::rotation_matrix;

/// A rotation, as a quaternion of length 1, followed by a translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rigid {
    /// x, y, z, w.
    rotation: [f64; 4],
    translation: [f64; 3],
}

impl Rigid {
    /// The identity.
    pub const IDENTITY: Self = Self {
        rotation: [0.0, 0.0, 0.0, 1.0],
        translation: [0.0; 3],
    };

    /// Creates a transform from a quaternion (x, y, z, w), which is normalised. `None` if its length is 0 or any number is
    /// not finite.
    pub fn new(rotation: [f64; 4], translation: [f64; 3]) -> Option<Self> {
        let length = dot(rotation, rotation).sqrt();
        let is_valid =
            length > 1e-6 && length.is_finite() && translation.iter().all(|v| v.is_finite());
        is_valid.then(|| Self {
            rotation: rotation.map(|v| v / length),
            translation,
        })
    }

    /// Returns the transform that applies `first`, then this one.
    #[must_use]
    pub fn after(self, first: Self) -> Self {
        let [ax, ay, az, aw] = self.rotation;
        let [bx, by, bz, bw] = first.rotation;
        let rotation = [
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ];
        Self {
            rotation: normalised(rotation),
            translation: self.apply(first.translation),
        }
    }

    /// Returns the inverse transform.
    #[must_use]
    pub fn inverse(self) -> Self {
        let [x, y, z, w] = self.rotation;
        let back = Self {
            rotation: [-x, -y, -z, w],
            translation: [0.0; 3],
        };
        Self {
            translation: back.apply(self.translation).map(|v| -v),
            ..back
        }
    }

    /// Transforms a point.
    pub fn apply(self, point: [f64; 3]) -> [f64; 3] {
        let rows = self.matrix();
        let moved = |axis: usize| {
            let [a, b, c] = rows[axis];
            a * point[0] + b * point[1] + c * point[2] + self.translation[axis]
        };
        [moved(0), moved(1), moved(2)]
    }

    /// Returns the rotation as a matrix, row by row.
    pub fn matrix(self) -> [[f64; 3]; 3] {
        rotation_matrix(self.rotation)
    }

    /// Returns the translation.
    pub fn translation(self) -> [f64; 3] {
        self.translation
    }

    /// Interpolates between this transform (0) and another (1): a straight line, and the shortest rotation at constant
    /// angular velocity (Shoemake 1985, "Animating rotation with quaternion curves").
    #[must_use]
    pub fn interpolate(self, other: Self, share: f64) -> Self {
        /// Above this cosine, the sine of the angle is lost to rounding, and linear interpolation is as accurate.
        const ALIKE: f64 = 1.0 - 1e-12;
        let cosine = dot(self.rotation, other.rotation);
        // A quaternion and its negative are the same rotation.
        let (cosine, sign) = (cosine.abs().min(1.0), cosine.signum());
        let (near, far) = if cosine > ALIKE {
            (1.0 - share, share)
        } else {
            let angle = cosine.acos();
            let sine = angle.sin();
            (
                ((1.0 - share) * angle).sin() / sine,
                (share * angle).sin() / sine,
            )
        };
        let mixed = |i: usize| near * self.rotation[i] + sign * far * other.rotation[i];
        let rotation = [0, 1, 2, 3].map(mixed);
        let between = |i: usize| self.translation[i] * (1.0 - share) + other.translation[i] * share;
        Self {
            rotation: normalised(rotation),
            translation: [0, 1, 2].map(between),
        }
    }
}

fn normalised(quaternion: [f64; 4]) -> [f64; 4] {
    let length = dot(quaternion, quaternion).sqrt();
    quaternion.map(|v| v / length)
}

fn dot(a: [f64; 4], b: [f64; 4]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn about_z(degrees: f64, translation: [f64; 3]) -> Rigid {
        let half = degrees.to_radians() / 2.0;
        Rigid::new([0.0, 0.0, half.sin(), half.cos()], translation).unwrap()
    }

    fn near(a: [f64; 3], b: [f64; 3]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12)
    }

    #[test]
    fn a_quarter_turn_and_its_way_back() {
        let turn = about_z(90.0, [1.0, 0.0, 0.0]);
        assert!(near(turn.apply([1.0, 2.0, 3.0]), [-1.0, 1.0, 3.0]));
        assert!(near(
            turn.inverse().apply([-1.0, 1.0, 3.0]),
            [1.0, 2.0, 3.0]
        ));
        let twice = turn.after(turn);
        // (x, y) -> (-y + 1, x) -> (-x + 1, -y + 1).
        assert!(near(twice.apply([1.0, 2.0, 3.0]), [0.0, -1.0, 3.0]));
    }

    #[test]
    fn rotations_go_the_short_way_at_an_even_speed() {
        let (start, end) = (about_z(10.0, [0.0; 3]), about_z(70.0, [4.0, 0.0, 0.0]));
        let opposite = Rigid {
            rotation: end.rotation.map(|v| -v),
            ..end
        };
        for end in [end, opposite] {
            let third = start.interpolate(end, 1.0 / 3.0);
            let expected = about_z(30.0, [4.0 / 3.0, 0.0, 0.0]);
            assert!(near(
                third.apply([1.0, 1.0, 1.0]),
                expected.apply([1.0, 1.0, 1.0])
            ));
        }
        let same = start.interpolate(start, 0.5);
        assert!(near(
            same.apply([1.0, 1.0, 1.0]),
            start.apply([1.0, 1.0, 1.0])
        ));
    }

    #[test]
    fn what_is_no_rotation_is_refused() {
        assert!(Rigid::new([0.0; 4], [0.0; 3]).is_none());
        assert!(Rigid::new([0.0, 0.0, 0.0, f64::NAN], [0.0; 3]).is_none());
        assert!(Rigid::new([0.0, 0.0, 0.0, 2.0], [f64::INFINITY, 0.0, 0.0]).is_none());
    }
}
