//! Ray casting: one primary ray per pixel for depth, Lambert shading with shadows for colour.

use super::furnish::{Body, Lamp, Room};
use super::geometry::{Hit, Shape, Vec3, vec3};
use crate::data::DepthMap;
use image::{Rgb, RgbImage};
use lsdc_core::Camera;
use lsdc_files::error::Result;
use lsdc_rng::Rng;

/// Focal length of NYU's camera divided by its image width (518.86 / 640).
const FOCAL: f32 = 0.81;

/// A pinhole camera inside the room.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    position: Vec3,
    right: Vec3,
    down: Vec3,
    ahead: Vec3,
}

impl View {
    /// Creates a camera at a position, turned to the right by `yaw` and up by `pitch`, in radians.
    pub(super) fn new(position: Vec3, yaw: f32, pitch: f32) -> Self {
        let ahead = vec3(
            yaw.sin() * pitch.cos(),
            pitch.sin(),
            yaw.cos() * pitch.cos(),
        );
        let right = vec3(0.0, 1.0, 0.0).cross(ahead).unit();
        Self {
            position,
            right,
            down: right.cross(ahead),
            ahead,
        }
    }

    /// Returns a random camera near one end of the room, at eye height, looking along the room.
    pub(super) fn random(room: &Room, rng: &mut Rng) -> Self {
        let half = room.half;
        let position = vec3(
            rng.range(-0.6, 0.6) * half.x,
            (rng.range(0.9, 1.7) - half.y).min(half.y - 0.3),
            rng.range(-0.95, -0.5) * half.z,
        );
        let (yaw, pitch) = (rng.range(-0.5, 0.5), rng.range(-0.35, 0.1));
        Self::new(clear_of_bodies(room, position), yaw, pitch)
    }

    /// Returns the calibrated camera for an image of this size. Its world has the axes of cameras: y points down, not up as in
    /// the room.
    pub(super) fn calibrated(&self, width: usize, height: usize) -> Camera {
        let flipped = |v: Vec3| [v.x, -v.y, v.z].map(f64::from);
        let rotation = [self.right, self.down, self.ahead].map(flipped);
        let position = flipped(self.position);
        let translation = rotation.map(|row| -(0..3).map(|i| row[i] * position[i]).sum::<f64>());
        let focal = f64::from(focal(width));
        let centre = [width, height].map(|length| length as f64 / 2.0 - 0.5);
        Camera::pinhole([focal; 2], centre).with_pose(rotation, translation)
    }
}

/// Returns the focal length in pixels for an image of this width.
fn focal(width: usize) -> f32 {
    FOCAL * width as f32
}

/// Returns a random exposure.
pub(super) fn exposure(rng: &mut Rng) -> f32 {
    rng.range(0.8, 1.3)
}

/// Returns whether a position is inside or close to an object.
pub(super) fn is_blocked(room: &Room, place: Vec3) -> bool {
    let near = |b: &Body| (b.centre - place).length() < b.shape.bounding_radius() + 0.15;
    room.bodies.iter().any(near)
}

/// Moves a position up until it is clear of objects, or close to the ceiling.
fn clear_of_bodies(room: &Room, mut position: Vec3) -> Vec3 {
    while is_blocked(room, position) && position.y < room.half.y - 0.2 {
        position.y += 0.1;
    }
    position
}

/// Renders a view of the room: colours with sensor noise, and depths in metres along the optical axis.
pub(super) fn render(
    room: &Room,
    view: &View,
    (width, height): (usize, usize),
    exposure: f32,
    rng: &mut Rng,
) -> Result<(RgbImage, DepthMap)> {
    let focal = focal(width);
    let mut rgb = RgbImage::new(width as u32, height as u32);
    let mut depths = Vec::with_capacity(width * height);
    for y in 0..height {
        let v = (y as f32 + 0.5 - height as f32 / 2.0) / focal;
        for x in 0..width {
            let u = (x as f32 + 0.5 - width as f32 / 2.0) / focal;
            // Length 1 along the optical axis, so that the ray parameter is the depth.
            let ray = view.ahead + view.right * u + view.down * v;
            let surface_point = nearest(room, view.position, ray);
            depths.push(surface_point.hit.t);
            let light = shade(
                room,
                view.position + ray * surface_point.hit.t,
                &surface_point,
            );
            let noise = rng.normal() * 0.008;
            rgb.put_pixel(
                x as u32,
                y as u32,
                Rgb(light.map(|c| encode(c * exposure, noise))),
            );
        }
    }
    Ok((rgb, DepthMap::new(width, height, depths)?))
}

/// Encodes a linear value with the power law of sRGB, and adds sensor noise.
fn encode(light: f32, noise: f32) -> u8 {
    ((light.clamp(0.0, 1.0).powf(1.0 / 2.2) + noise).clamp(0.0, 1.0) * 255.0).round() as u8
}

struct SurfacePoint {
    hit: Hit,
    colour: [f32; 3],
}

fn nearest(room: &Room, origin: Vec3, ray: Vec3) -> SurfacePoint {
    let mut best: Option<(Hit, &Body)> = None;
    for body in &room.bodies {
        if let Some(hit) = hit(body, origin, ray)
            && best.is_none_or(|(b, _)| hit.t < b.t)
        {
            best = Some((hit, body));
        }
    }
    let wall = Shape::Block(room.half).hit(origin, ray).unwrap_or(Hit {
        t: 1.0,
        normal: -ray,
    });
    match best {
        Some((hit, body)) if hit.t < wall.t => {
            let local = (origin + ray * hit.t - body.centre).turn(inverse(body.turn));
            SurfacePoint {
                hit,
                colour: body.paint.colour(local),
            }
        }
        _ => {
            let n = wall.normal;
            let surface = if n.y > 0.5 {
                0
            } else if n.y < -0.5 {
                1
            } else if n.x.abs() > 0.5 {
                2
            } else {
                3
            };
            let colour = room.surfaces[surface].colour(origin + ray * wall.t);
            SurfacePoint { hit: wall, colour }
        }
    }
}

fn inverse((sin, cos): (f32, f32)) -> (f32, f32) {
    (-sin, cos)
}

/// Intersects a ray with an object; tests the bounding sphere first.
fn hit(body: &Body, origin: Vec3, ray: Vec3) -> Option<Hit> {
    let to = body.centre - origin;
    let along = to.dot(ray) / ray.dot(ray);
    let miss = to - ray * along;
    let bounding_radius = body.shape.bounding_radius();
    if miss.dot(miss) > bounding_radius * bounding_radius {
        return None;
    }
    let turn = inverse(body.turn);
    let hit = body.shape.hit((-to).turn(turn), ray.turn(turn))?;
    Some(Hit {
        t: hit.t,
        normal: hit.normal.turn(body.turn),
    })
}

fn shade(room: &Room, position: Vec3, surface_point: &SurfacePoint) -> [f32; 3] {
    let mut light = [room.ambient; 3];
    for lamp in &room.lamps {
        let to = lamp.position - position;
        let cosine = to.dot(surface_point.hit.normal) / to.length();
        if cosine > 0.0 && !shadowed(room, position + surface_point.hit.normal * 2e-3, lamp) {
            let share = cosine / (1.0 + to.dot(to));
            for (l, p) in light.iter_mut().zip(lamp.power) {
                *l += p * share;
            }
        }
    }
    std::array::from_fn(|i| light[i] * surface_point.colour[i])
}

fn shadowed(room: &Room, position: Vec3, lamp: &Lamp) -> bool {
    let ray = lamp.position - position;
    room.bodies
        .iter()
        .any(|body| hit(body, position, ray).is_some_and(|h| h.t < 1.0))
}
