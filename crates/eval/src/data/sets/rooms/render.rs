//! Ray casting: one primary ray per pixel for depth, Lambert shading with shadows for colour.

use super::furnish::{Body, Lamp, Room};
use super::geometry::{Hit, Shape, Vec3, vec3};
use crate::data::DepthMap;
use image::{Rgb, RgbImage};
use lsdc_files::error::Result;
use lsdc_rng::Rng;

/// Focal length of NYU's camera over its image width (518.86 / 640).
const FOCAL: f32 = 0.81;

/// A pinhole camera inside the room.
struct Camera {
    position: Vec3,
    right: Vec3,
    down: Vec3,
    ahead: Vec3,
}

impl Camera {
    /// Near one end of the room, at eye height, looking down its length.
    fn random(room: &Room, rng: &mut Rng) -> Self {
        let half = room.half;
        let position = vec3(
            rng.range(-0.6, 0.6) * half.x,
            (rng.range(0.9, 1.7) - half.y).min(half.y - 0.3),
            rng.range(-0.95, -0.5) * half.z,
        );
        let (yaw, pitch) = (rng.range(-0.5, 0.5), rng.range(-0.35, 0.1));
        let ahead = vec3(
            yaw.sin() * pitch.cos(),
            pitch.sin(),
            yaw.cos() * pitch.cos(),
        );
        let right = vec3(0.0, 1.0, 0.0).cross(ahead).unit();
        Self {
            position: clear_of_bodies(room, position),
            right,
            down: right.cross(ahead),
            ahead,
        }
    }
}

/// The place itself, or one higher up if it lies inside or close to a body.
fn clear_of_bodies(room: &Room, mut position: Vec3) -> Vec3 {
    let blocked = |p: Vec3| {
        let near = |b: &Body| (b.centre - p).length() < b.shape.bounding_radius() + 0.15;
        room.bodies.iter().any(near)
    };
    while blocked(position) && position.y < room.half.y - 0.2 {
        position.y += 0.1;
    }
    position
}

/// Colours and depths (metres along the optical axis) of a view of the room.
pub(super) fn render(
    room: &Room,
    width: usize,
    height: usize,
    rng: &mut Rng,
) -> Result<(RgbImage, DepthMap)> {
    let camera = Camera::random(room, rng);
    let focal = FOCAL * width as f32;
    let exposure = rng.range(0.8, 1.3);
    let mut rgb = RgbImage::new(width as u32, height as u32);
    let mut depths = Vec::with_capacity(width * height);
    for y in 0..height {
        let v = (y as f32 + 0.5 - height as f32 / 2.0) / focal;
        for x in 0..width {
            let u = (x as f32 + 0.5 - width as f32 / 2.0) / focal;
            // One unit along the optical axis, so that the ray parameter is the depth.
            let ray = camera.ahead + camera.right * u + camera.down * v;
            let surface_point = nearest(room, camera.position, ray);
            depths.push(surface_point.hit.t);
            let light = shade(
                room,
                camera.position + ray * surface_point.hit.t,
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

/// sRGB's power law, with sensor noise.
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

/// The hit of a ray with a body; the ball around the body is tried first.
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
