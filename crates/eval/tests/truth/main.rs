//! Positions and depths against closed forms: a scene of planes, a box and a sphere, whose depth along the optical axis is
//! exact through any camera. The reference is independent of the tested code: lenses, poses, rotated pixels and files are
//! implemented again from their definitions.

#![allow(clippy::unwrap_used)]

mod camera;
mod clouds;
mod completion;
mod files;
mod maps;
mod observed;
mod occlusion;
mod scene;
mod tables;
mod turned;
mod vector;

/// Returns the i-th position of a sequence that fills the unit square evenly (Roberts 2018, "The unreasonable effectiveness of
/// quasirandom sequences").
fn spread(i: usize) -> [f64; 2] {
    let plastic = 1.324_717_957_244_746_f64;
    [1.0, 2.0].map(|power| (0.5 + i as f64 / plastic.powf(power)).fract())
}
