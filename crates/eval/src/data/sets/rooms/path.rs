//! A camera that moves through a room: frames with exact depths and poses.

use super::furnish::{Body, Room, furnish};
use super::geometry::{Shape, Vec3, vec3};
use super::paint::Paint;
use super::render::{View, exposure, is_blocked, render};
use super::{check_size, id, stream};
use crate::data::{Frame, PosedFrame, Sequence, Split};
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use rayon::prelude::*;
use std::f32::consts::TAU;

/// Limit of random paths tried until one is clear of all objects.
const TRIES: usize = 200;
/// Number of positions of a path tested for collisions.
const CHECKED: usize = 32;
/// Smallest distance of the camera from walls, in metres.
const MARGIN: f32 = 0.25;

/// A procedural room seen by a moving camera. The path is a line of about a metre from the first to the last frame; the camera
/// looks at the other end of the room, sways, and turns to the side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoomPath {
    /// Seed of the rooms.
    pub seed: u64,
    /// Index of the room: that of the frame with this index in the validation split of [`Rooms`](crate::data::Rooms).
    pub room: usize,
    /// Number of frames, at least 2. More frames are closer together on the same path.
    pub frames: usize,
    /// Image columns.
    pub width: usize,
    /// Image rows.
    pub height: usize,
    /// Whether the camera stands still in the middle of its path, so that frames differ only by sensor noise.
    pub still: bool,
    /// Whether a cylinder as large as a person moves across the view.
    pub moving_object: bool,
}

impl Default for RoomPath {
    fn default() -> Self {
        Self {
            seed: 0,
            room: 0,
            frames: 24,
            width: 320,
            height: 240,
            still: false,
            moving_object: false,
        }
    }
}

impl RoomPath {
    /// Renders the frames; the result is the same on every machine and for every number of threads.
    ///
    /// # Errors
    /// Fewer than two frames, images outside 16 to 8192 pixels, or a room without space for a path.
    pub fn render(&self) -> Result<Sequence> {
        check_size(self.width, self.height)?;
        let name = id(Split::Val, self.room);
        let room = furnish(&mut stream(self.seed, &name));
        let mut rng = Rng::stream(self.seed, &["room path", &name]);
        let path = Path::clear(&room, &mut rng).ok_or_else(|| {
            Error::config(format!("room {} has no space for a path", self.room))
                .hint("choose another room")
        })?;
        let (exposure, walker) = (exposure(&mut rng), Walker::random(&room, &mut rng));
        let frame = |index: usize| {
            let share = index as f32 / self.frames.saturating_sub(1).max(1) as f32;
            let view = path.view(if self.still { 0.5 } else { share });
            let mut room = room.clone();
            if self.moving_object {
                room.bodies.push(walker.body(share));
            }
            let id = format!("{name}/{index:04}");
            let mut noise = Rng::stream(self.seed, &["room path", &id]);
            let size = (self.width, self.height);
            let (rgb, depth) = render(&room, &view, size, exposure, &mut noise)?;
            Ok(PosedFrame {
                frame: Frame::new(id, rgb, depth)?,
                camera: view.calibrated(self.width, self.height),
            })
        };
        let frames: Result<Vec<_>> = (0..self.frames).into_par_iter().map(frame).collect();
        Sequence::new(format!("procedural room {}", self.room), frames?)
    }
}

/// The line of a camera path.
struct Path {
    start: Vec3,
    end: Vec3,
    target: Vec3,
}

impl Path {
    /// Returns a random path that is clear of all objects; `None` if none was found.
    fn clear(room: &Room, rng: &mut Rng) -> Option<Self> {
        let mut paths = (0..TRIES).map(|_| Self::random(room, rng));
        paths.find(|path| {
            let at = |i: usize| path.place(i as f32 / (CHECKED - 1) as f32);
            (0..CHECKED).all(|i| !is_blocked(room, at(i)))
        })
    }

    /// Returns a random path that starts near one end of the room at eye height and goes sideways and forwards.
    fn random(room: &Room, rng: &mut Rng) -> Self {
        let half = room.half;
        let inside = |v: f32, half: f32| v.clamp(MARGIN - half, half - MARGIN);
        let x = rng.range(-0.6, 0.6) * half.x;
        let y = inside(rng.range(0.9, 2.2) - half.y, half.y);
        let z = rng.range(-0.95, -0.5) * half.z;
        // Towards the side with more space.
        let sideways = rng.range(0.6, 1.2) * if x > 0.0 { -1.0 } else { 1.0 };
        let forwards = rng.range(0.1, 0.7);
        let target = vec3(
            rng.range(-0.4, 0.4) * half.x,
            rng.range(-0.6, 0.1) * half.y,
            0.6 * half.z,
        );
        Self {
            start: vec3(inside(x, half.x), y, inside(z, half.z)),
            end: vec3(
                inside(x + sideways, half.x),
                y,
                inside(z + forwards, half.z),
            ),
            target,
        }
    }

    /// Returns the position at a fraction of the path, with the sway of a hand-held camera.
    fn place(&self, share: f32) -> Vec3 {
        let place = self.start + (self.end - self.start) * share;
        place + vec3(0.0, 0.04 * (2.0 * TAU * share).sin(), 0.0)
    }

    fn view(&self, share: f32) -> View {
        let place = self.place(share);
        let to = self.target - place;
        let yaw = to.x.atan2(to.z) + 0.15 * (TAU * share).sin();
        View::new(place, yaw, to.y.atan2(to.x.hypot(to.z)))
    }
}

/// A cylinder as large as a person that crosses the room.
struct Walker {
    from: Vec3,
    to: Vec3,
    paint: Paint,
}

impl Walker {
    const HALF_HEIGHT: f32 = 0.8;

    fn random(room: &Room, rng: &mut Rng) -> Self {
        let half = room.half;
        let end = |side: f32, rng: &mut Rng| {
            let z = rng.range(0.1, 0.5) * half.z;
            vec3(side * 0.7 * half.x, Self::HALF_HEIGHT - half.y, z)
        };
        Self {
            from: end(-1.0, rng),
            to: end(1.0, rng),
            paint: Paint::random(rng),
        }
    }

    fn body(&self, share: f32) -> Body {
        Body {
            shape: Shape::Column(0.22, Self::HALF_HEIGHT),
            centre: self.from + (self.to - self.from) * share,
            turn: (0.0, 1.0),
            paint: self.paint,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::DepthMap;

    fn small(path: RoomPath) -> Sequence {
        let (width, height) = (64, 48);
        RoomPath {
            width,
            height,
            frames: 4,
            ..path
        }
        .render()
        .unwrap()
    }

    fn truth(sequence: &Sequence) -> Vec<DepthMap> {
        let depths = sequence.frames().iter();
        depths.map(|posed| posed.frame.depth.clone()).collect()
    }

    /// Points of the floor, seen from all frames, lie in one horizontal plane, the lowest of the room.
    #[test]
    fn poses_and_depths_agree_in_the_world() {
        for room in 0..4 {
            let sequence = small(RoomPath {
                room,
                ..RoomPath::default()
            });
            let mut lowest = Vec::new();
            for posed in sequence.frames() {
                posed.camera.check().unwrap();
                let points = posed.frame.depth.points();
                let heights = points.map(|p| {
                    let pixel = [p.x as f64, p.y as f64];
                    posed.camera.unproject(pixel, f64::from(p.depth)).unwrap()[1]
                });
                lowest.push(heights.fold(f64::MIN, f64::max));
            }
            let floor = lowest.iter().copied().fold(f64::MIN, f64::max);
            assert!(
                lowest.iter().all(|y| (y - floor).abs() < 1e-4),
                "{lowest:?}"
            );
            assert!(floor > 1.1 && floor < 1.5, "{floor}");
        }
    }

    #[test]
    fn a_camera_that_stands_still_sees_one_depth_unless_something_moves() {
        let still = RoomPath {
            still: true,
            ..RoomPath::default()
        };
        let sequence = small(still);
        let depths = truth(&sequence);
        assert!(depths.iter().all(|depth| *depth == depths[0]));
        let [first, second] = [0, 1].map(|i: usize| &sequence.frames()[i]);
        assert_eq!(first.camera, second.camera);
        assert_ne!(first.frame.rgb, second.frame.rgb);
        let moving_object = true;
        let depths = truth(&small(RoomPath {
            moving_object,
            ..still
        }));
        assert_ne!(depths[0], depths[1]);
    }

    #[test]
    fn one_frame_is_no_sequence() {
        let path = RoomPath {
            frames: 1,
            ..RoomPath::default()
        };
        assert!(path.render().is_err());
    }
}
