//! Camera models by their equations: the projection of a point, and the ray of a pixel.

use crate::vector::{Rotation, Vector, along};

#[derive(Clone, Copy, Debug)]
pub(crate) enum Lens {
    Pinhole,
    /// Brown (1966): k1, k2, p1, p2.
    Radtan([f64; 4]),
    /// Kannala and Brandt (2006): k1 to k4.
    Fisheye([f64; 4]),
}

/// A camera in a world with z up. Pixel coordinates are relative to the centre of the first pixel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Camera {
    pub(crate) size: (usize, usize),
    pub(crate) focal: [f64; 2],
    pub(crate) center: [f64; 2],
    pub(crate) lens: Lens,
    /// Rotation from the axes of the world to x right, y down, z forwards.
    pub(crate) rotation: Rotation,
    pub(crate) position: Vector,
}

/// The projection of a point into a camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sight {
    pub(crate) place: [f64; 2],
    /// Depth along the optical axis.
    pub(crate) depth: f64,
}

impl Camera {
    /// Creates a camera that looks along the world's y axis.
    pub(crate) fn level(size: (usize, usize), focal: f64, position: Vector) -> Self {
        Self {
            size,
            focal: [focal; 2],
            center: [size.0, size.1].map(|length| (length as f64 - 1.0) / 2.0),
            lens: Lens::Pinhole,
            rotation: Rotation::about([1.0, 0.0, 0.0], 90.0),
            position,
        }
    }

    /// Rotates the camera to its right, downwards, and clockwise, in degrees.
    pub(crate) fn turned(self, right: f64, down: f64, clockwise: f64) -> Self {
        let rotation = self
            .rotation
            .then(Rotation::about([0.0, 1.0, 0.0], -right))
            .then(Rotation::about([1.0, 0.0, 0.0], down))
            .then(Rotation::about([0.0, 0.0, 1.0], -clockwise));
        Self { rotation, ..self }
    }

    /// Returns one camera of each lens, at different poses, with principal points off the centre. Beyond 48 degrees the
    /// equations of the second one fold back into the image; the third sees 150 degrees.
    pub(crate) fn each() -> [(&'static str, Self); 3] {
        let size = (320, 240);
        let pinhole = Self {
            focal: [310.0, 305.0],
            center: [163.7, 116.2],
            ..Self::level(size, 310.0, [-0.4, -7.6, 1.5]).turned(4.0, 6.0, -3.0)
        };
        let radtan = Self {
            focal: [300.0, 302.0],
            center: [157.3, 121.9],
            lens: Lens::Radtan([-0.3, 0.02, 0.0012, -0.0008]),
            ..Self::level(size, 300.0, [0.7, -7.4, 1.1]).turned(-9.0, -2.0, 8.0)
        };
        let fisheye = Self {
            focal: [151.0, 150.0],
            center: [161.1, 118.4],
            lens: Lens::Fisheye([0.02, -0.004, 0.001, -0.0002]),
            ..Self::level(size, 150.0, [-1.2, -6.9, 1.3]).turned(12.0, 5.0, 15.0)
        };
        [
            ("pinhole", pinhole),
            ("radtan", radtan),
            ("fisheye", fisheye),
        ]
    }

    /// Projects a point of the world that is in front of the camera, inside or outside the image.
    pub(crate) fn see(&self, point: Vector) -> Option<Sight> {
        let [x, y, depth] = self.rotation.apply(along(point, -1.0, self.position));
        if depth <= 0.0 {
            return None;
        }
        let bent = self.lens.bend([x / depth, y / depth])?;
        Some(Sight {
            place: [0, 1].map(|axis| self.focal[axis] * bent[axis] + self.center[axis]),
            depth,
        })
    }

    /// Projects a point of the world; `None` outside the image.
    pub(crate) fn see_inside(&self, point: Vector) -> Option<Sight> {
        let (width, height) = self.size;
        let within = |place: f64, length: usize| (-0.5..length as f64 - 0.5).contains(&place);
        let inside = |s: &Sight| within(s.place[0], width) && within(s.place[1], height);
        self.see(point).filter(inside)
    }

    /// Returns the ray of a position in the image, scaled to a depth of 1.
    pub(crate) fn ray(&self, place: [f64; 2]) -> Vector {
        let bent = [0, 1].map(|axis| (place[axis] - self.center[axis]) / self.focal[axis]);
        let [x, y] = self.lens.straighten(bent);
        self.rotation.inverse().apply([x, y, 1.0])
    }

    /// Returns the rows of the matrix from the world to the camera.
    pub(crate) fn world_to_camera(&self) -> [[f64; 4]; 3] {
        let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let [a, b, c] = columns.map(|axis| self.rotation.apply(axis));
        let t = self.translation();
        [0, 1, 2].map(|row| [a[row], b[row], c[row], t[row]])
    }

    /// Returns the origin of the world in camera coordinates.
    pub(crate) fn translation(&self) -> Vector {
        self.rotation.apply(self.position).map(|v| -v)
    }
}

impl Lens {
    /// Projects the ray through (x, y, 1), in focal lengths; `None` where the equations fold back.
    fn bend(self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let square = x * x + y * y;
        match self {
            Self::Pinhole => Some([x, y]),
            Self::Radtan(k) => (square < fold(k)).then(|| radtan(k, [x, y])),
            Self::Fisheye(k) => {
                let radius = square.sqrt();
                let factor = if radius > 0.0 {
                    fisheye(k, radius.atan()).0 / radius
                } else {
                    1.0
                };
                Some([x * factor, y * factor])
            }
        }
    }

    /// Returns the ray of a projection, by Newton's method with the derivatives of the equations.
    fn straighten(self, [a, b]: [f64; 2]) -> [f64; 2] {
        const ROUNDS: usize = 50;
        match self {
            Self::Pinhole => [a, b],
            Self::Radtan(k) => {
                let [k1, k2, p1, p2] = k;
                let [mut x, mut y] = [a, b];
                for _ in 0..ROUNDS {
                    let s = x * x + y * y;
                    let [here, below] = radtan(k, [x, y]);
                    let (radial, slope) = (1.0 + k1 * s + k2 * s * s, k1 + 2.0 * k2 * s);
                    let xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x;
                    let xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
                    let yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x;
                    let (right, down) = (here - a, below - b);
                    let determinant = xx * yy - xy * xy;
                    x -= (yy * right - xy * down) / determinant;
                    y -= (xx * down - xy * right) / determinant;
                }
                [x, y]
            }
            Self::Fisheye(k) => {
                let seen = a.hypot(b);
                let mut angle = seen;
                for _ in 0..ROUNDS {
                    let (radius, slope) = fisheye(k, angle);
                    angle -= (radius - seen) / slope;
                }
                let factor = if seen > 0.0 { angle.tan() / seen } else { 1.0 };
                [a * factor, b * factor]
            }
        }
    }
}

fn radtan([k1, k2, p1, p2]: [f64; 4], [x, y]: [f64; 2]) -> [f64; 2] {
    let s = x * x + y * y;
    let radial = 1.0 + k1 * s + k2 * s * s;
    [
        x * radial + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
        y * radial + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
    ]
}

/// Returns the squared radius at which r (1 + k1 r^2 + k2 r^4) stops increasing.
fn fold([k1, k2, ..]: [f64; 4]) -> f64 {
    let (a, b) = (5.0 * k2, 3.0 * k1);
    let root = (b * b - 4.0 * a).sqrt();
    let ends = [-1.0, 1.0].map(|sign| (-b + sign * root) / (2.0 * a));
    let first = |least: f64, end: f64| if end > 0.0 { least.min(end) } else { least };
    ends.into_iter().fold(f64::INFINITY, first)
}

/// Returns the distance of an angle from the centre, and its derivative.
fn fisheye(k: [f64; 4], angle: f64) -> (f64, f64) {
    let mut sums = (angle, 1.0);
    for (k, power) in k.into_iter().zip([3, 5, 7, 9]) {
        sums.0 += k * angle.powi(power);
        sums.1 += k * f64::from(power) * angle.powi(power - 1);
    }
    sums
}

#[test]
fn rays_lead_back_to_their_pixels() {
    for (name, camera) in Camera::each() {
        let (width, height) = camera.size;
        for i in 0..500 {
            let [a, b] = crate::spread(i);
            let place = [a * width as f64 - 0.5, b * height as f64 - 0.5];
            let point = along(camera.position, 2.5, camera.ray(place));
            let sight = camera.see_inside(point).unwrap();
            let off = (sight.place[0] - place[0]).hypot(sight.place[1] - place[1]);
            assert!(off < 1e-9, "{name}: {off} at {place:?}");
            assert!((sight.depth - 2.5).abs() < 1e-12, "{name}");
        }
    }
}

#[test]
fn cameras_look_where_they_are_turned() {
    let camera = Camera::level((640, 480), 500.0, [1.0, 2.0, 3.0]);
    // 0.4 m to the right and 0.2 m up, at 2 m.
    let sight = camera.see([1.4, 4.0, 3.2]).unwrap();
    let expected = [319.5 + 100.0, 239.5 - 50.0, 2.0];
    let found = [sight.place[0], sight.place[1], sight.depth];
    let off = along(found, -1.0, expected);
    assert!(off.iter().all(|v| v.abs() < 1e-9), "{found:?}");
    // Points ahead move left, then up; points to the right move up.
    let ahead = [1.0, 4.0, 3.0];
    let place = |right, down, clockwise, point| {
        let camera = camera.turned(right, down, clockwise);
        camera.see(point).unwrap().place
    };
    assert!(place(5.0, 0.0, 0.0, ahead)[0] < 319.0);
    assert!(place(0.0, 5.0, 0.0, ahead)[1] < 239.0);
    assert!(place(0.0, 0.0, 5.0, [1.4, 4.0, 3.0])[1] < 239.0);
    assert_eq!(camera.see([1.0, 1.0, 3.0]).map(|sight| sight.depth), None);
}

#[test]
fn what_the_equations_fold_back_is_not_seen() {
    let [_, (_, camera), _] = Camera::each();
    let Lens::Radtan(k) = camera.lens else {
        unreachable!()
    };
    // 60 degrees to the right, which the equations project left of the right edge.
    let tangent = 3.0_f64.sqrt();
    let column = camera.focal[0] * radtan(k, [tangent, 0.0])[0] + camera.center[0];
    assert!((camera.center[0]..319.0).contains(&column), "{column}");
    let ray = camera.rotation.inverse().apply([tangent, 0.0, 1.0]);
    assert!(camera.see(along(camera.position, 1.0, ray)).is_none());
    // Inside the fold, everything in the image is visible.
    for corner in [[0.0, 0.0], [319.0, 0.0], [0.0, 239.0], [319.0, 239.0]] {
        let point = along(camera.position, 1.0, camera.ray(corner));
        assert!(camera.see_inside(point).is_some(), "{corner:?}");
    }
}
