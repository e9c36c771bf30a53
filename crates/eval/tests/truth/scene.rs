//! Scenes with closed-form intersections of rays and surfaces.

use crate::camera::Camera;
use crate::vector::{Vector, along, dot};
use image::{Rgb, RgbImage};

#[derive(Clone, Copy, Debug)]
pub(crate) enum Surface {
    /// Walls, floor and ceiling, seen from inside.
    Room { low: Vector, high: Vector },
    /// A box, seen from outside.
    Block { low: Vector, high: Vector },
    /// A sphere, seen from outside.
    Ball { center: Vector, radius: f64 },
    /// An infinite plane.
    Plane { point: Vector, normal: Vector },
}

#[derive(Clone, Debug)]
pub(crate) struct Scene(pub(crate) Vec<Surface>);

impl Surface {
    /// Returns the distance to the surface in multiples of the length of the ray.
    fn distance(self, from: Vector, ray: Vector) -> Option<f64> {
        // Where the ray enters and leaves the slab between each pair of planes.
        let slabs = |low: Vector, high: Vector| {
            let mut span = (f64::NEG_INFINITY, f64::INFINITY);
            for axis in 0..3 {
                let [a, b] = [low, high].map(|end| (end[axis] - from[axis]) / ray[axis]);
                span = (span.0.max(a.min(b)), span.1.min(a.max(b)));
            }
            span
        };
        let distance = match self {
            Self::Room { low, high } => slabs(low, high).1,
            Self::Block { low, high } => {
                let (enters, leaves) = slabs(low, high);
                if enters > leaves {
                    return None;
                }
                enters
            }
            Self::Ball { center, radius } => {
                let to = along(center, -1.0, from);
                let (a, b) = (dot(ray, ray), dot(ray, to));
                let root = (b * b - a * (dot(to, to) - radius * radius)).sqrt();
                (b - root) / a
            }
            Self::Plane { point, normal } => {
                dot(normal, along(point, -1.0, from)) / dot(normal, ray)
            }
        };
        (distance > 0.0 && distance.is_finite()).then_some(distance)
    }
}

impl Scene {
    /// A room of 6 x 7 x 2.6 m with a box and a sphere. It has negative y, so that rows x, y, z of its points are never valid
    /// pixels and depths.
    pub(crate) fn room() -> Self {
        Self(vec![
            Surface::Room {
                low: [-3.0, -8.0, 0.0],
                high: [3.0, -1.0, 2.6],
            },
            Surface::Block {
                low: [-1.1, -4.2, 0.0],
                high: [0.2, -3.4, 1.2],
            },
            Surface::Ball {
                center: [1.2, -3.8, 0.6],
                radius: 0.6,
            },
        ])
    }

    /// A plane that recedes to the right and downwards, as seen by a level camera at the origin.
    pub(crate) fn slanted() -> Self {
        Self(vec![Surface::Plane {
            point: [0.0, 2.0, 0.0],
            normal: [-0.45, 1.0, 0.3],
        }])
    }

    fn distance(&self, from: Vector, ray: Vector) -> Option<f64> {
        let hits = self.0.iter().filter_map(|s| s.distance(from, ray));
        hits.min_by(f64::total_cmp)
    }

    /// Returns the first intersection of a ray with a surface.
    pub(crate) fn meets(&self, from: Vector, ray: Vector) -> Option<Vector> {
        Some(along(from, self.distance(from, ray)?, ray))
    }

    /// Returns the point shown at a position of the image.
    pub(crate) fn point(&self, camera: &Camera, place: [f64; 2]) -> Vector {
        self.meets(camera.position, camera.ray(place)).unwrap()
    }

    /// Returns the depth along the optical axis at a position of the image.
    pub(crate) fn depth(&self, camera: &Camera, place: [f64; 2]) -> f64 {
        self.distance(camera.position, camera.ray(place)).unwrap()
    }

    /// Returns whether a point of a surface is not occluded from the camera.
    pub(crate) fn shows(&self, camera: &Camera, point: Vector) -> bool {
        const ROUNDING: f64 = 1e-9;
        let ray = along(point, -1.0, camera.position);
        self.distance(camera.position, ray)
            .is_none_or(|distance| distance > 1.0 - ROUNDING)
    }

    /// Renders the scene through a camera: the colour is a function of the world position, darker in every other cube of 0.25
    /// m.
    pub(crate) fn render(&self, camera: &Camera) -> RgbImage {
        let (width, height) = camera.size;
        RgbImage::from_fn(width as u32, height as u32, |x, y| {
            let point = self.point(camera, [f64::from(x), f64::from(y)]);
            let cubes = point.map(|v| ((v - 0.1) * 4.0).floor() as i64);
            let shade = if cubes.iter().sum::<i64>() % 2 == 0 {
                1.0
            } else {
                0.7
            };
            let [x, y, z] = point;
            let shares = [(x + 3.0) / 6.0, (y + 8.0) / 7.0, z / 2.6];
            Rgb(shares.map(|share| (shade * (40.0 + 200.0 * share)) as u8))
        })
    }
}

#[test]
fn surfaces_are_met_where_they_are() {
    let scene = Scene::room();
    for (from, ray, expected) in [
        // The far wall, the box, the sphere, the floor.
        ([-2.0, -7.0, 2.0], [0.0, 2.0, 0.0], 3.0),
        ([-0.5, -7.0, 1.0], [0.0, 1.0, 0.0], 2.8),
        ([1.2, -7.0, 0.6], [0.0, 1.0, 0.0], 2.6),
        ([2.0, -7.0, 2.0], [0.0, 0.5, -1.0], 2.0),
    ] {
        let distance = scene.distance(from, ray).unwrap();
        assert!((distance - expected).abs() < 1e-12, "{distance}");
    }
    let camera = Camera::level((64, 48), 50.0, [-0.5, -7.0, 1.0]);
    assert!(scene.shows(&camera, [-0.5, -4.2, 1.0]));
    assert!(!scene.shows(&camera, [-0.5, -1.0, 1.0]));
}
