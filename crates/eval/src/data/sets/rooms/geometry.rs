//! Vectors, and intersections of rays with boxes, spheres and upright cylinders.

use std::ops::{Add, Mul, Neg, Sub};

/// A point or direction in metres: x right, y up, z away from the room's front wall.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Vec3 {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) z: f32,
}

pub(super) fn vec3(x: f32, y: f32, z: f32) -> Vec3 {
    Vec3 { x, y, z }
}

impl Vec3 {
    pub(super) fn dot(self, o: Self) -> f32 {
        self.x * o.x + self.y * o.y + self.z * o.z
    }

    pub(super) fn cross(self, o: Self) -> Self {
        vec3(
            self.y * o.z - self.z * o.y,
            self.z * o.x - self.x * o.z,
            self.x * o.y - self.y * o.x,
        )
    }

    pub(super) fn length(self) -> f32 {
        self.dot(self).sqrt()
    }

    pub(super) fn unit(self) -> Self {
        self * (1.0 / self.length())
    }

    /// Rotates the vector about the vertical axis by an angle given as (sin, cos).
    pub(super) fn turn(self, (sin, cos): (f32, f32)) -> Self {
        vec3(
            cos * self.x + sin * self.z,
            self.y,
            cos * self.z - sin * self.x,
        )
    }

    fn axis(self, i: usize) -> f32 {
        [self.x, self.y, self.z][i]
    }
}

impl Add for Vec3 {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        vec3(self.x + o.x, self.y + o.y, self.z + o.z)
    }
}

impl Sub for Vec3 {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        vec3(self.x - o.x, self.y - o.y, self.z - o.z)
    }
}

impl Mul<f32> for Vec3 {
    type Output = Self;
    fn mul(self, s: f32) -> Self {
        vec3(self.x * s, self.y * s, self.z * s)
    }
}

impl Neg for Vec3 {
    type Output = Self;
    fn neg(self) -> Self {
        self * -1.0
    }
}

/// The shape of an object around its own centre.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    /// Half extents.
    Block(Vec3),
    /// Radius.
    Ball(f32),
    /// Radius and half height, upright.
    Column(f32, f32),
}

/// The intersection of a ray and a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Distance in multiples of the length of the ray vector.
    pub(super) t: f32,
    /// Unit normal facing the origin of the ray.
    pub(super) normal: Vec3,
}

/// Smallest distance of a hit, so that a ray does not hit the surface that it starts on.
const MIN_DISTANCE: f32 = 1e-3;

impl Shape {
    /// Returns the radius of the bounding sphere around the centre.
    pub(super) fn bounding_radius(self) -> f32 {
        match self {
            Self::Block(half) => half.length(),
            Self::Ball(radius) => radius,
            Self::Column(radius, half) => radius.hypot(half),
        }
    }

    /// Returns the nearest hit of a ray in the frame of the object, from outside or inside.
    pub(super) fn hit(self, origin: Vec3, ray: Vec3) -> Option<Hit> {
        match self {
            Self::Block(half) => block(half, origin, ray),
            Self::Ball(radius) => {
                let t = quadratic(
                    ray.dot(ray),
                    origin.dot(ray),
                    origin.dot(origin) - radius * radius,
                )
                .into_iter()
                .find(|t| *t > MIN_DISTANCE)?;
                Some(facing(t, (origin + ray * t).unit(), ray))
            }
            Self::Column(radius, half) => column(radius, half, origin, ray),
        }
    }
}

fn facing(t: f32, normal: Vec3, ray: Vec3) -> Hit {
    let normal = if normal.dot(ray) > 0.0 {
        -normal
    } else {
        normal
    };
    Hit { t, normal }
}

/// Intersects a ray with a box (slab method, Kay and Kajiya 1986).
fn block(half: Vec3, origin: Vec3, ray: Vec3) -> Option<Hit> {
    let (mut enter, mut leave) = (f32::NEG_INFINITY, f32::INFINITY);
    let (mut first, mut last) = (0, 0);
    for i in 0..3 {
        let inverse = 1.0 / ray.axis(i);
        let (a, b) = (
            (-half.axis(i) - origin.axis(i)) * inverse,
            (half.axis(i) - origin.axis(i)) * inverse,
        );
        let (near, far) = (a.min(b), a.max(b));
        if near > enter {
            (enter, first) = (near, i);
        }
        if far < leave {
            (leave, last) = (far, i);
        }
    }
    if enter > leave || leave <= MIN_DISTANCE {
        return None;
    }
    let (t, axis) = if enter > MIN_DISTANCE {
        (enter, first)
    } else {
        (leave, last)
    };
    let normal = [
        vec3(1.0, 0.0, 0.0),
        vec3(0.0, 1.0, 0.0),
        vec3(0.0, 0.0, 1.0),
    ][axis];
    Some(facing(t, normal, ray))
}

fn column(radius: f32, half: f32, origin: Vec3, ray: Vec3) -> Option<Hit> {
    let flat = |v: Vec3| vec3(v.x, 0.0, v.z);
    let (o, r) = (flat(origin), flat(ray));
    let side = quadratic(r.dot(r), o.dot(r), o.dot(o) - radius * radius)
        .into_iter()
        .filter(|t| *t > MIN_DISTANCE && (origin.y + ray.y * t).abs() <= half)
        .map(|t| facing(t, (o + r * t).unit(), ray));
    let caps = [half, -half]
        .into_iter()
        .map(|y| (y - origin.y) / ray.y)
        .filter(|t| *t > MIN_DISTANCE && (o + r * *t).length() <= radius)
        .map(|t| facing(t, vec3(0.0, 1.0, 0.0), ray));
    side.chain(caps).min_by(|a, b| a.t.total_cmp(&b.t))
}

/// Returns the real roots of `a t^2 + 2 b t + c` in ascending order; none unless `a` is positive.
fn quadratic(a: f32, b: f32, c: f32) -> Vec<f32> {
    let discriminant = b * b - a * c;
    if a <= 0.0 || discriminant < 0.0 {
        return Vec::new();
    }
    let root = discriminant.sqrt();
    vec![(-b - root) / a, (-b + root) / a]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_hit_at_the_analytic_distance() {
        let (origin, ray) = (vec3(0.0, 0.0, -5.0), vec3(0.0, 0.0, 2.0));
        let t = |shape: Shape| shape.hit(origin, ray).unwrap().t;
        assert!((t(Shape::Block(vec3(1.0, 1.0, 1.0))) - 2.0).abs() < 1e-6);
        assert!((t(Shape::Ball(1.5)) - 1.75).abs() < 1e-6);
        assert!((t(Shape::Column(0.5, 1.0)) - 2.25).abs() < 1e-6);
        let down = Shape::Column(0.5, 1.0).hit(vec3(0.2, 3.0, 0.0), vec3(0.0, -1.0, 0.0));
        assert!((down.unwrap().t - 2.0).abs() < 1e-6);
        assert!(Shape::Ball(1.0).hit(vec3(2.0, 0.0, -5.0), ray).is_none());
    }

    #[test]
    fn from_inside_the_far_wall_is_hit_and_faces_back() {
        let room = Shape::Block(vec3(2.0, 1.0, 3.0));
        let hit = room.hit(Vec3::default(), vec3(0.0, 0.0, 1.0)).unwrap();
        assert!((hit.t - 3.0).abs() < 1e-6);
        assert_eq!(hit.normal, vec3(0.0, 0.0, -1.0));
    }
}
