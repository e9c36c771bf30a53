//! Surface colours: plain, wood, tiles, stripes, plaster; all with value noise.

use self::Texture::{Plain, Plaster, Stripes, Tiles, Wood};
use super::geometry::Vec3;
use lsdc_rng::Rng;

/// The colour and texture of a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Paint {
    base: [f32; 3],
    second: [f32; 3],
    texture: Texture,
    scale: f32,
    seed: u32,
}

#[derive(Clone, Copy, Debug)]
enum Texture {
    Plain,
    Wood,
    Tiles,
    Stripes,
    Plaster,
}

impl Paint {
    /// Returns a random paint for objects; muted colours are common, saturated ones rare.
    pub(super) fn random(rng: &mut Rng) -> Self {
        Self::of(&[Plain, Plain, Wood, Tiles, Stripes, Plaster], rng)
    }

    /// Returns a random paint for walls and ceilings.
    pub(super) fn wall(rng: &mut Rng) -> Self {
        Self::of(&[Plain, Plaster, Plaster, Stripes], rng)
    }

    /// Returns a random paint for floors.
    pub(super) fn floor(rng: &mut Rng) -> Self {
        Self::of(&[Wood, Wood, Tiles, Plaster], rng)
    }

    fn of(textures: &[Texture], rng: &mut Rng) -> Self {
        let texture = textures[rng.below(textures.len() as u32) as usize];
        let level = rng.range(0.15, 0.9);
        let strength = if rng.chance(0.25) { 0.45 } else { 0.12 };
        let mut colour =
            || [0; 3].map(|_| (level + rng.range(-strength, strength)).clamp(0.03, 0.97));
        let base = colour();
        let other = colour();
        let mix = rng.range(0.2, 0.8);
        Self {
            base,
            second: std::array::from_fn(|i| base[i] * (1.0 - mix) + other[i] * mix * 0.8),
            texture,
            scale: rng.range(1.5, 6.0),
            seed: rng.below(u32::MAX),
        }
    }

    /// Returns the colour (linear, 0 to 1) at a point in the frame of the object.
    pub(super) fn colour(&self, p: Vec3) -> [f32; 3] {
        let q = p * self.scale;
        let grain = noise(q * 8.0, self.seed) - 0.5;
        let share = match self.texture {
            Plain => 0.0,
            Wood => (q.x * 4.0 + 3.0 * noise(q, self.seed)).sin() * 0.5 + 0.5,
            Tiles => {
                let joint = |v: f32| f32::from((v - v.floor()) < 0.06);
                joint(q.x * 0.6).max(joint(q.y * 0.6)).max(joint(q.z * 0.6))
            }
            Stripes => f32::from((q.x + q.z).rem_euclid(1.0) < 0.4),
            Plaster => noise(q * 2.0, self.seed ^ 1),
        };
        std::array::from_fn(|i| {
            let colour = self.base[i] * (1.0 - share) + self.second[i] * share;
            (colour * (1.0 + 0.15 * grain)).clamp(0.0, 1.0)
        })
    }
}

/// Returns value noise in `[0, 1]` with a smooth step between lattice points.
fn noise(p: Vec3, seed: u32) -> f32 {
    let cell = [p.x.floor(), p.y.floor(), p.z.floor()];
    let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
    let f = [
        smooth(p.x - cell[0]),
        smooth(p.y - cell[1]),
        smooth(p.z - cell[2]),
    ];
    let mut total = 0.0;
    for corner in 0..8_u32 {
        let bit = |i: u32| (corner >> i) & 1;
        let weight: f32 = (0..3)
            .map(|i| {
                if bit(i) == 1 {
                    f[i as usize]
                } else {
                    1.0 - f[i as usize]
                }
            })
            .product();
        let at = |i: u32| (cell[i as usize] as i32).wrapping_add(bit(i) as i32) as u32;
        total += weight * lattice(at(0), at(1), at(2), seed);
    }
    total
}

/// Returns a pseudorandom number in `[0, 1]` for a lattice point (mixing steps of MurmurHash3).
fn lattice(x: u32, y: u32, z: u32, seed: u32) -> f32 {
    let mut h = seed;
    for v in [x, y, z] {
        h = (h ^ v.wrapping_mul(0xcc9e_2d51))
            .rotate_left(13)
            .wrapping_mul(5)
            .wrapping_add(0xe654_6b64);
    }
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    (h ^ (h >> 16)) as f32 / u32::MAX as f32
}
