//! The measurement of each pixel of a frame: a plane with a weight.

use crate::blocks::SIDE;
use crate::error::Result;
use crate::frame::Frame;
use crate::report::LeftOut;
use crate::settings::Settings;
use lsdc_core::cloud::flying_pixels;
use lsdc_core::{Camera, Lens};
use rayon::prelude::*;

type Vector = [f64; 3];

/// The tangent plane of the surface at a pixel, relative to the centre of the camera.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Plane {
    /// Unit normal on the side of the camera, along the axes of the world.
    normal: [f32; 3],
    /// Negative distance from the plane to the camera's centre.
    offset: f32,
    /// Truncation distance.
    pub(crate) truncation: f32,
    /// Weight; 0 for skipped pixels.
    pub(crate) weight: f32,
}

impl Plane {
    /// Returns the signed distance of a position on the ray of the pixel, relative to the centre of the camera: positive and
    /// truncated in front of the surface; `None` if the position is hidden by the surface.
    pub(crate) fn distance(&self, place: [f32; 3]) -> Option<f32> {
        /// Largest distance behind the surface along the ray, in truncation distances. A surface seen from the side may end
        /// before it.
        const BEHIND: f32 = 2.0;
        let [x, y, z] = place;
        let [a, b, c] = self.normal;
        let distance = a * x + b * y + c * z - self.offset;
        if distance >= 0.0 {
            return Some(distance.min(self.truncation));
        }
        let range = (x * x + y * y + z * z).sqrt();
        // Both are negative; their sum is the offset of the position itself.
        let behind = range * distance / (distance + self.offset);
        let is_near = distance >= -self.truncation && behind <= BEHIND * self.truncation;
        is_near.then_some(distance)
    }
}

/// The planes of all pixels.
pub(crate) struct Measurements {
    pub(crate) camera: Camera,
    /// Centre of the camera in the world.
    pub(crate) center: Vector,
    pub(crate) size: (usize, usize),
    /// Planes, row by row.
    pub(crate) planes: Vec<Plane>,
    /// Red, green and blue, row by row, if the frame has an image.
    pub(crate) colours: Option<Vec<u8>>,
    /// Number of pixels that are not skipped.
    pub(crate) used: usize,
    /// Both ends of the measured range along each normal, for the used pixels.
    pub(crate) spans: Vec<Vec<[Vector; 2]>>,
}

/// Rays of all pixels of a camera at the origin, at depth 1; cached, because many frames share them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rays {
    of: Option<(Camera, (usize, usize))>,
    /// Rays; `None` outside the valid field of view of the lens.
    rays: Vec<Option<Vector>>,
}

impl Rays {
    pub(crate) fn update(&mut self, frame: &Frame<'_>) {
        let camera = frame.camera.clone().with_pose(IDENTITY, [0.0; 3]);
        let of = Some((camera, frame.size()));
        if self.of == of {
            return;
        }
        self.of = of;
        let (Some((camera, (width, height))), rays) = (&self.of, &mut self.rays) else {
            return;
        };
        let pixels = (0..width * height).into_par_iter();
        let ray = |index: usize| {
            let pixel = [(index % width) as f64, (index / width) as f64];
            let ray = camera.unproject(pixel, 1.0);
            // Positions beyond the fold of a lens have a ray that does not project back to them.
            ray.filter(|ray| *camera.lens() == Lens::Pinhole || camera.project(*ray).is_some())
        };
        pixels.map(ray).collect_into_vec(rays);
    }
}

const IDENTITY: [Vector; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
/// Standard deviations below this share of the depth are dominated by rounding: float32 has 24 bits.
const ROUNDING: f64 = 1e-6;
/// Block indices are 32-bit integers.
const FARTHEST_BLOCK: f64 = (1 << 30) as f64;

/// Computes the planes of a frame for voxels of this edge length.
pub(crate) fn measurements(
    frame: &Frame<'_>,
    rays: &Rays,
    settings: &Settings,
    edge: f64,
) -> Result<(Measurements, LeftOut)> {
    let (width, height) = frame.size();
    let (rotation, translation) = frame.camera.pose();
    let center = turned_back(&rotation, translation).map(|v| -v);
    let pixels = Pixels {
        frame,
        rays: &rays.rays,
        flying: flying_pixels(frame.depth, frame.camera.focal()),
        settings,
        edge,
        least_cosine: settings.max_angle.to_radians().cos(),
        rotation,
        center,
    };
    let rows: Vec<(Vec<Plane>, Vec<[Vector; 2]>, LeftOut)> =
        (0..height).into_par_iter().map(|y| pixels.row(y)).collect();
    let mut planes = Vec::with_capacity(width * height);
    let mut spans = Vec::with_capacity(height);
    let mut left_out = LeftOut::default();
    for (row, row_spans, row_left_out) in rows {
        planes.extend(row);
        spans.push(row_spans);
        left_out.add(row_left_out);
    }
    let measurements = Measurements {
        camera: frame.camera.clone(),
        center,
        size: (width, height),
        planes,
        colours: frame.image.map(lsdc_core::Image::rgb).transpose()?,
        used: width * height - left_out.total(),
        spans,
    };
    Ok((measurements, left_out))
}

struct Pixels<'a> {
    frame: &'a Frame<'a>,
    rays: &'a [Option<Vector>],
    flying: Vec<bool>,
    settings: &'a Settings,
    edge: f64,
    least_cosine: f64,
    rotation: [Vector; 3],
    center: Vector,
}

impl Pixels<'_> {
    fn row(&self, y: usize) -> (Vec<Plane>, Vec<[Vector; 2]>, LeftOut) {
        let width = self.frame.depth.width();
        let (mut planes, mut spans) = (vec![Plane::default(); width], Vec::new());
        let mut left_out = LeftOut::default();
        for (x, plane) in planes.iter_mut().enumerate() {
            match self.plane(x, y) {
                Ok((found, span)) => {
                    *plane = found;
                    spans.push(span);
                }
                Err(reason) => *reason(&mut left_out) += 1,
            }
        }
        (planes, spans, left_out)
    }

    /// Returns the plane of a pixel and the ends of its measured range, or the counter of the reason to skip it.
    fn plane(&self, x: usize, y: usize) -> Result<(Plane, [Vector; 2]), Reason> {
        let index = y * self.frame.depth.width() + x;
        let depth = f64::from(self.frame.depth.values()[index]);
        if depth <= 0.0 {
            return Err(|left_out| &mut left_out.unmeasured);
        }
        if depth > self.settings.max_depth {
            return Err(|left_out| &mut left_out.far);
        }
        let Some(surface) = self.at(index) else {
            return Err(|left_out| &mut left_out.outside_lens);
        };
        let given = self.frame.deviation.map(|sigma| f64::from(sigma[index]));
        let sigma = given.unwrap_or(self.settings.default_deviation * depth);
        if !(sigma > 0.0 && sigma.is_finite()) || sigma > self.settings.max_deviation * depth {
            return Err(|left_out| &mut left_out.uncertain);
        }
        if self.flying[index] {
            return Err(|left_out| &mut left_out.flying);
        }
        let Some(normal) = self.normal(x, y, surface) else {
            return Err(|left_out| &mut left_out.isolated);
        };
        let offset = dot(normal, surface);
        let cosine = -offset / dot(surface, surface).sqrt();
        if cosine.is_nan() || cosine < self.least_cosine {
            return Err(|left_out| &mut left_out.grazing);
        }
        let sigma = sigma.max(ROUNDING * depth);
        let [least, largest] = self
            .settings
            .truncation_voxels
            .map(|voxels| voxels * self.edge);
        let truncation = (self.settings.truncation_deviations * sigma).clamp(least, largest);
        let world_normal = turned_back(&self.rotation, normal);
        let relative = turned_back(&self.rotation, surface);
        let end = |distance: f64| {
            [0, 1, 2].map(|axis| self.center[axis] + relative[axis] + distance * world_normal[axis])
        };
        let span = [end(-truncation), end(truncation)];
        let farthest = FARTHEST_BLOCK * SIDE as f64 * self.edge;
        if span.as_flattened().iter().any(|v| v.abs() > farthest) {
            return Err(|left_out| &mut left_out.far);
        }
        let plane = Plane {
            normal: world_normal.map(|v| v as f32),
            offset: offset as f32,
            truncation: truncation as f32,
            // Planes seen from the side extend farthest along the ray, and deviate from curved surfaces there; weights by the
            // cosine alone displaced a sphere by more than a quarter of a voxel.
            weight: (cosine * self.edge / sigma).powi(2) as f32,
        };
        Ok((plane, span))
    }

    /// Returns the position of a pixel along the axes of the camera.
    fn at(&self, index: usize) -> Option<Vector> {
        let depth = f64::from(self.frame.depth.values()[index]);
        let ray = self.rays[index].filter(|_| depth > 0.0)?;
        Some(ray.map(|v| v * depth))
    }

    /// Returns the normal on the side of the camera.
    fn normal(&self, x: usize, y: usize, own: Vector) -> Option<Vector> {
        let (width, height) = self.frame.size();
        let at = |x: Option<usize>, y: Option<usize>| {
            let (x, y) = (x.filter(|x| *x < width)?, y.filter(|y| *y < height)?);
            self.at(y * width + x)
        };
        let along = tangent(at(x.checked_sub(1), Some(y)), own, at(Some(x + 1), Some(y)))?;
        let down = tangent(at(Some(x), y.checked_sub(1)), own, at(Some(x), Some(y + 1)))?;
        // With x to the right and y down, this cross product points towards the camera.
        let normal = cross(down, along);
        let length = dot(normal, normal).sqrt();
        (length > 0.0).then(|| normal.map(|v| v / length))
    }
}

/// The counter of a reason to skip a pixel.
type Reason = fn(&mut LeftOut) -> &mut usize;

/// Returns the direction of the surface from one neighbour to the other. If these belong to different surfaces, uses the
/// neighbour nearer to the pixel.
fn tangent(before: Option<Vector>, own: Vector, after: Option<Vector>) -> Option<Vector> {
    /// Largest squared ratio of both distances on one surface.
    const UNLIKE: f64 = 4.0;
    let from = before.map(|before| difference(own, before));
    let to = after.map(|after| difference(after, own));
    match (from, to) {
        (Some(from), Some(to)) => {
            let (a, b) = (dot(from, from), dot(to, to));
            Some(if a > UNLIKE * b {
                to
            } else if b > UNLIKE * a {
                from
            } else {
                [0, 1, 2].map(|axis| from[axis] + to[axis])
            })
        }
        (one, other) => one.or(other),
    }
}

/// Rotates a direction or a translation from the axes of the camera to those of the world.
fn turned_back(rotation: &[Vector; 3], vector: Vector) -> Vector {
    [0, 1, 2].map(|axis| (0..3).map(|row| rotation[row][axis] * vector[row]).sum())
}

fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn difference(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
