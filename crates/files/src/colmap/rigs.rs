//! Rigs of cameras (COLMAP 3.12 and later): where frames place images, which overrides the poses in the file of images.

use super::Parsed;
use std::collections::HashMap;

/// Where a camera or a rig is: a point of the world is first rotated, then translated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placed {
    /// Row by row.
    pub(super) rotation: [[f64; 3]; 3],
    pub(super) translation: [f64; 3],
}

/// Where the cameras of rigs are in these, by rig and camera.
#[derive(Debug, Default)]
pub(super) struct Rigs(HashMap<(u32, u32), Option<Placed>>);

/// The frames that images belong to, by image.
#[derive(Debug, Default)]
pub(super) struct Frames(HashMap<u64, Frame>);

/// Images that a rig takes at once, for one of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub(super) rig: u32,
    /// The camera of the image.
    pub(super) sensor: u32,
    /// The place of the rig.
    pub(super) placed: Placed,
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
    fn after(self, first: Self) -> Self {
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

impl Rigs {
    pub(super) fn add(&mut self, rig: u32, camera: u32, placed: Option<Placed>) {
        self.0.insert((rig, camera), placed);
    }
}

impl Frames {
    pub(super) fn add(&mut self, image: u64, frame: Frame) {
        self.0.insert(image, frame);
    }

    /// Where the frame of an image and the rig place it, if they do.
    pub(super) fn placed(&self, image: u64, rigs: &Rigs) -> Option<Placed> {
        let frame = self.0.get(&image)?;
        let camera = rigs.0.get(&(frame.rig, frame.sensor)).copied()??;
        Some(camera.after(frame.placed))
    }
}
