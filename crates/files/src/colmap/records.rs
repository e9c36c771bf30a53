//! What the files of a model say of its images and points, and where these are.

/// What is wrong with a file, and where.
pub(super) type Parsed<T> = Result<T, String>;

/// What a file says of an image.
pub(super) struct Image {
    pub(super) id: u64,
    pub(super) placed: Placed,
    pub(super) camera: u32,
    pub(super) name: String,
    /// Place and point of each observation that has one.
    pub(super) seen: Vec<([f64; 2], u64)>,
}

/// What a file says of a point.
pub(super) struct Landmark {
    pub(super) place: [f64; 3],
    /// Mean reprojection error in pixels.
    pub(super) error: f64,
    /// Images that see it.
    pub(super) track: usize,
}

/// Where a camera or a rig is: a point of the world is first rotated, then translated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placed {
    /// Row by row.
    pub(super) rotation: [[f64; 3]; 3],
    pub(super) translation: [f64; 3],
}

impl Placed {
    pub(super) const ORIGIN: Self = Self {
        rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    };

    /// Of a quaternion w, x, y, z of any length and a translation.
    ///
    /// # Errors
    /// A quaternion of no length, or numbers that are not finite.
    pub(super) fn new([w, x, y, z, translation @ ..]: [f64; 7]) -> Parsed<Self> {
        let norm = [w, x, y, z].iter().map(|v| v * v).sum::<f64>().sqrt();
        if !(norm.is_normal() && translation.iter().all(|v| v.is_finite())) {
            return Err(format!(
                "holds a pose that is no rotation and translation: {w} {x} {y} {z}, {translation:?}"
            ));
        }
        let [w, x, y, z] = [w, x, y, z].map(|v| v / norm);
        let rotation = [
            [
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y - w * z),
                2.0 * (x * z + w * y),
            ],
            [
                2.0 * (x * y + w * z),
                1.0 - 2.0 * (x * x + z * z),
                2.0 * (y * z - w * x),
            ],
            [
                2.0 * (x * z - w * y),
                2.0 * (y * z + w * x),
                1.0 - 2.0 * (x * x + y * y),
            ],
        ];
        Ok(Self {
            rotation,
            translation,
        })
    }

    /// This after another one.
    pub(super) fn after(self, first: Self) -> Self {
        let columns = [0, 1, 2].map(|j| first.rotation.map(|row| row[j]));
        let moved = self.rotation.map(|row| dot(row, first.translation));
        Self {
            rotation: self
                .rotation
                .map(|row| columns.map(|column| dot(row, column))),
            translation: [0, 1, 2].map(|i| moved[i] + self.translation[i]),
        }
    }

    /// The angle to another rotation in degrees, and the distance between both origins.
    pub(super) fn apart(&self, other: &Self) -> (f64, f64) {
        let off = |a: &[f64; 3], b: &[f64; 3]| {
            let squares = a.iter().zip(b).map(|(a, b)| (a - b).powi(2));
            squares.sum::<f64>()
        };
        // |A - B| of rotations is sqrt(8) sin(angle / 2).
        let rows = self.rotation.iter().zip(&other.rotation);
        let chord = rows.map(|(a, b)| off(a, b)).sum::<f64>().sqrt();
        let angle = 2.0 * (chord / 8.0_f64.sqrt()).min(1.0).asin();
        let origins = [self.origin(), other.origin()];
        (angle.to_degrees(), off(&origins[0], &origins[1]).sqrt())
    }

    /// Where it is in the world.
    fn origin(&self) -> [f64; 3] {
        let columns = [0, 1, 2].map(|j| self.rotation.map(|row| row[j]));
        columns.map(|column| -dot(column, self.translation))
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
