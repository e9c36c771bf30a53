//! A random furnished room: tables, chairs, shelves with clutter, lamps, balls, pictures.

use super::geometry::{Shape, Vec3, vec3};
use super::paint::Paint;
use lsdc_rng::Rng;

/// An object in the room, rotated about the vertical axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    pub(super) shape: Shape,
    pub(super) centre: Vec3,
    /// Sine and cosine of the rotation angle.
    pub(super) turn: (f32, f32),
    pub(super) paint: Paint,
}

/// A point light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lamp {
    pub(super) position: Vec3,
    pub(super) power: [f32; 3],
}

/// A room: half extents around the origin (the floor is at `-half.y`), bodies and lamps.
#[derive(Clone, Debug)]
pub(super) struct Room {
    pub(super) half: Vec3,
    /// Floor, ceiling, side walls and end walls.
    pub(super) surfaces: [Paint; 4],
    pub(super) bodies: Vec<Body>,
    pub(super) lamps: Vec<Lamp>,
    pub(super) ambient: f32,
}

pub(super) fn furnish(rng: &mut Rng) -> Room {
    let half = vec3(
        rng.range(1.5, 3.5),
        rng.range(1.15, 1.5),
        rng.range(1.8, 4.5),
    );
    let surfaces = [
        Paint::floor(rng),
        Paint::wall(rng),
        Paint::wall(rng),
        Paint::wall(rng),
    ];
    let lamps = (0..=rng.below(3))
        .map(|_| Lamp {
            position: vec3(
                rng.range(-0.8, 0.8) * half.x,
                half.y - 0.1,
                rng.range(-0.8, 0.8) * half.z,
            ),
            power: [(); 3].map(|()| rng.range(1.2, 2.2)),
        })
        .collect();
    let mut room = Room {
        half,
        surfaces,
        bodies: Vec::new(),
        lamps,
        ambient: rng.range(0.15, 0.35),
    };
    for _ in 0..3 + rng.below(6) {
        let spot = vec3(
            rng.range(-0.85, 0.85) * half.x,
            -half.y,
            rng.range(-0.6, 0.95) * half.z,
        );
        let angle = rng.range(0.0, std::f32::consts::TAU);
        let mut placer = Placer {
            room: &mut room,
            spot,
            turn: angle.sin_cos(),
        };
        match rng.below(6) {
            0 => placer.table(rng),
            1 => placer.chair(rng),
            2 => placer.cupboard(rng),
            3 => placer.floor_lamp(rng),
            4 => placer.sofa(rng),
            _ => placer.small_objects(rng),
        }
    }
    for _ in 0..=rng.below(3) {
        shelf(&mut room, rng);
    }
    for _ in 0..rng.below(4) {
        picture(&mut room, rng);
    }
    room
}

/// Placement of objects relative to a position on the floor and a rotation.
struct Placer<'a> {
    room: &'a mut Room,
    spot: Vec3,
    turn: (f32, f32),
}

impl Placer<'_> {
    fn put(&mut self, shape: Shape, offset: Vec3, paint: Paint) {
        self.room.bodies.push(Body {
            shape,
            centre: self.spot + offset.turn(self.turn),
            turn: self.turn,
            paint,
        });
    }

    fn block(&mut self, size: Vec3, offset: Vec3, paint: Paint) {
        self.put(Shape::Block(size * 0.5), offset, paint);
    }

    fn table(&mut self, rng: &mut Rng) {
        let paint = Paint::random(rng);
        let (w, d, h) = (
            rng.range(0.6, 1.6),
            rng.range(0.5, 0.9),
            rng.range(0.45, 0.8),
        );
        self.block(vec3(w, 0.04, d), vec3(0.0, h, 0.0), paint);
        let radius = rng.range(0.015, 0.04);
        self.legs(vec3(w / 2.0 - 0.05, h / 2.0, d / 2.0 - 0.05), radius, paint);
        for _ in 0..rng.below(7) {
            let at = vec3(rng.range(-0.4, 0.4) * w, h + 0.02, rng.range(-0.4, 0.4) * d);
            self.object(at, rng);
        }
    }

    fn chair(&mut self, rng: &mut Rng) {
        let paint = Paint::random(rng);
        let (w, h) = (rng.range(0.38, 0.5), rng.range(0.4, 0.5));
        let back_height = rng.range(0.35, 0.55);
        self.block(vec3(w, 0.05, w), vec3(0.0, h, 0.0), paint);
        self.block(
            vec3(w, back_height, 0.03),
            vec3(0.0, h + back_height / 2.0, w / 2.0),
            paint,
        );
        self.legs(vec3(w / 2.0 - 0.02, h / 2.0, w / 2.0 - 0.02), 0.015, paint);
    }

    /// Adds four legs, symmetric about the vertical axis, one of them with its centre at `at`.
    fn legs(&mut self, at: Vec3, radius: f32, paint: Paint) {
        for (sx, sz) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let centre = vec3(sx * at.x, at.y, sz * at.z);
            self.put(Shape::Column(radius, at.y), centre, paint);
        }
    }

    fn cupboard(&mut self, rng: &mut Rng) {
        let (w, h, d) = (
            rng.range(0.4, 1.2),
            rng.range(0.6, 2.0),
            rng.range(0.35, 0.6),
        );
        self.block(vec3(w, h, d), vec3(0.0, h / 2.0, 0.0), Paint::random(rng));
        for _ in 0..rng.below(4) {
            let at = vec3(rng.range(-0.4, 0.4) * w, h, rng.range(-0.35, 0.35) * d);
            self.object(at, rng);
        }
    }

    fn floor_lamp(&mut self, rng: &mut Rng) {
        let h = rng.range(1.2, 1.7);
        let metal = Paint::random(rng);
        self.put(
            Shape::Column(0.012, h / 2.0),
            vec3(0.0, h / 2.0, 0.0),
            metal,
        );
        self.put(Shape::Column(0.14, 0.015), vec3(0.0, 0.015, 0.0), metal);
        self.put(
            Shape::Column(rng.range(0.12, 0.22), 0.12),
            vec3(0.0, h, 0.0),
            Paint::random(rng),
        );
    }

    fn sofa(&mut self, rng: &mut Rng) {
        let paint = Paint::random(rng);
        let (w, d) = (rng.range(1.2, 2.2), rng.range(0.7, 0.95));
        self.block(vec3(w, 0.42, d), vec3(0.0, 0.21, 0.0), paint);
        self.block(vec3(w, 0.5, 0.2), vec3(0.0, 0.6, d / 2.0 - 0.1), paint);
        for side in [-1.0, 1.0] {
            self.block(vec3(0.18, 0.6, d), vec3(side * w / 2.0, 0.3, 0.0), paint);
        }
        for _ in 0..rng.below(3) {
            let cushion = Paint::random(rng);
            let at = vec3(rng.range(-0.35, 0.35) * w, 0.56, rng.range(-0.1, 0.2));
            self.block(vec3(0.4, 0.35, 0.14), at, cushion);
        }
    }

    fn small_objects(&mut self, rng: &mut Rng) {
        for _ in 0..2 + rng.below(4) {
            let at = vec3(rng.range(-0.5, 0.5), 0.0, rng.range(-0.5, 0.5));
            self.object(at, rng);
        }
    }

    /// Adds a box, ball, can or bottle at a position.
    fn object(&mut self, at: Vec3, rng: &mut Rng) {
        let paint = Paint::random(rng);
        let size = rng.range(0.04, 0.16);
        let up = |h: f32| vec3(at.x, at.y + h, at.z);
        match rng.below(4) {
            0 => {
                let tall = rng.range(0.5, 3.0) * size;
                self.block(vec3(size * 2.0, tall, size), up(tall / 2.0), paint);
            }
            1 => self.put(Shape::Ball(size), up(size), paint),
            2 => self.put(Shape::Column(size * 0.5, size), up(size), paint),
            _ => {
                self.put(Shape::Column(size * 0.35, size), up(size), paint);
                self.put(
                    Shape::Column(size * 0.12, size * 0.4),
                    up(size * 2.4),
                    paint,
                );
            }
        }
    }
}

/// Adds shelves along a side wall or the end wall, filled with books and small objects.
fn shelf(room: &mut Room, rng: &mut Rng) {
    let paint = Paint::random(rng);
    let (w, d) = (rng.range(0.6, 1.4), rng.range(0.22, 0.35));
    let levels = 2 + rng.below(4);
    let gap = rng.range(0.28, 0.4);
    let half = room.half;
    let along = rng.range(-0.7, 0.7);
    let (spot, turn) = match rng.below(3) {
        0 => (vec3(half.x - d / 2.0, -half.y, along * half.z), (1.0, 0.0)),
        1 => (vec3(d / 2.0 - half.x, -half.y, along * half.z), (-1.0, 0.0)),
        _ => (vec3(along * half.x, -half.y, half.z - d / 2.0), (0.0, 1.0)),
    };
    let mut placer = Placer { room, spot, turn };
    let height = gap * levels as f32;
    for side in [-1.0, 1.0] {
        placer.block(
            vec3(0.02, height, d),
            vec3(side * w / 2.0, height / 2.0, 0.0),
            paint,
        );
    }
    for level in 0..=levels {
        let y = level as f32 * gap;
        placer.block(vec3(w, 0.02, d), vec3(0.0, y, 0.0), paint);
        let mut x = 0.04 - w / 2.0;
        while level < levels && x < w / 2.0 - 0.06 {
            if rng.chance(0.75) {
                let (thick, tall) = (rng.range(0.02, 0.06), rng.range(0.5, 0.9) * gap);
                let book = vec3(thick, tall, rng.range(0.5, 0.9) * d);
                placer.block(
                    book,
                    vec3(x + thick / 2.0, y + tall / 2.0, 0.0),
                    Paint::random(rng),
                );
                x += thick + 0.005;
            } else {
                placer.object(vec3(x + 0.08, y + 0.01, 0.0), rng);
                x += 0.2;
            }
        }
    }
}

/// Adds a flat picture or window to the end wall.
fn picture(room: &mut Room, rng: &mut Rng) {
    let size = vec3(rng.range(0.3, 1.2), rng.range(0.3, 0.9), 0.03) * 0.5;
    let centre = vec3(
        rng.range(-0.7, 0.7) * room.half.x,
        rng.range(-0.1, 0.4) * room.half.y,
        room.half.z - 0.01,
    );
    room.bodies.push(Body {
        shape: Shape::Block(size),
        centre,
        turn: (0.0, 1.0),
        paint: Paint::random(rng),
    });
}
