//! Vectors and rotations in 3D.

pub(crate) type Vector = [f64; 3];

pub(crate) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Returns a + factor b.
pub(crate) fn along(a: Vector, factor: f64, b: Vector) -> Vector {
    [0, 1, 2].map(|axis| a[axis] + factor * b[axis])
}

/// A unit quaternion w, x, y, z.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rotation(pub(crate) [f64; 4]);

impl Rotation {
    /// Creates a rotation by an angle in degrees about a unit axis.
    pub(crate) fn about(axis: Vector, degrees: f64) -> Self {
        let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
        Self([cos, sin * axis[0], sin * axis[1], sin * axis[2]])
    }

    /// Returns this rotation followed by another one.
    pub(crate) fn then(self, Self([w, x, y, z]): Self) -> Self {
        let (Self([v, a, b, c]), outer) = (self, [x, y, z]);
        let inner = [a, b, c];
        let crossed = cross(outer, inner);
        let [x, y, z] = along(along(crossed, w, inner), v, outer);
        Self([w * v - dot(outer, inner), x, y, z])
    }

    pub(crate) fn inverse(self) -> Self {
        let Self([w, x, y, z]) = self;
        Self([w, -x, -y, -z])
    }

    pub(crate) fn apply(self, vector: Vector) -> Vector {
        let Self([w, x, y, z]) = self;
        let axis = [x, y, z];
        let twice = cross(axis, vector).map(|v| 2.0 * v);
        along(along(vector, w, twice), 1.0, cross(axis, twice))
    }
}

#[test]
fn rotations_follow_each_other() {
    let (x, z) = ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    let [a, b] = [Rotation::about(z, 90.0), Rotation::about(x, 90.0)];
    // x becomes y, and y becomes z.
    let both = a.then(b);
    for (found, expected) in [(both.apply(x), z), (both.inverse().apply(z), x)] {
        let off = along(found, -1.0, expected);
        assert!(dot(off, off) < 1e-30, "{found:?}");
    }
}
