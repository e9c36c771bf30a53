//! Sparse blocks of voxels.

use crate::error::{Error, Result};
use crate::measure::Measurements;
use lsdc_core::cloud::pixel;
use rayon::prelude::*;
use std::collections::HashMap;

/// Number of voxels along an edge of a block, and in a block.
pub(crate) const SIDE: usize = 8;
pub(crate) const VOXELS: usize = SIDE * SIDE * SIDE;

/// Position of a block, in multiples of its edge length.
pub(crate) type Key = [i32; 3];

/// Mean values of 8x8x8 voxels, with x varying fastest.
#[derive(Clone, Debug)]
pub(crate) struct Block {
    /// Truncated signed distance at the centre of each voxel.
    pub(crate) distance: [f32; VOXELS],
    /// Sum of the weights; 0 if never measured.
    pub(crate) weight: [f32; VOXELS],
    /// Red, green, blue and the sum of their weights; allocated at the first coloured frame.
    pub(crate) colour: Option<Box<[[f32; 4]; VOXELS]>>,
}

/// Blocks, found by their keys.
#[derive(Clone, Debug)]
pub(crate) struct Blocks {
    edge: f64,
    index: HashMap<Key, usize>,
    keys: Vec<Key>,
    /// Blocks in the order of the keys.
    voxels: Vec<Box<Block>>,
    has_colour: bool,
}

impl Blocks {
    pub(crate) fn new(edge: f64) -> Self {
        Self {
            edge,
            index: HashMap::new(),
            keys: Vec::new(),
            voxels: Vec::new(),
            has_colour: false,
        }
    }

    /// Returns the edge length of a voxel.
    pub(crate) fn edge(&self) -> f64 {
        self.edge
    }

    pub(crate) fn len(&self) -> usize {
        self.voxels.len()
    }

    pub(crate) fn get(&self, key: Key) -> Option<&Block> {
        self.index.get(&key).map(|&index| &*self.voxels[index])
    }

    /// Returns the keys in ascending order.
    pub(crate) fn sorted_keys(&self) -> Vec<Key> {
        let mut keys = self.keys.clone();
        keys.par_sort_unstable();
        keys
    }

    /// Returns an upper bound of the size of all blocks in bytes: blocks that no coloured frame has seen have no colours.
    pub(crate) fn memory(&self) -> usize {
        self.len() * bytes(self.has_colour)
    }

    /// Adds the blocks measured by a frame.
    ///
    /// # Errors
    /// The blocks would need more than `most` bytes; none is added.
    pub(crate) fn allocate(&mut self, measurements: &Measurements, most: usize) -> Result<()> {
        let mut keys: Vec<Key> = measurements
            .spans
            .par_iter()
            .flat_map_iter(|row| self.touched(row))
            .collect();
        keys.par_sort_unstable();
        keys.dedup();
        keys.retain(|key| !self.index.contains_key(key));
        let has_colour = self.has_colour || measurements.colours.is_some();
        let needed = (self.len() + keys.len()).saturating_mul(bytes(has_colour));
        if needed > most {
            let mebibytes = |bytes: usize| bytes as f64 / f64::from(1 << 20);
            return Err(Error::Memory {
                edge: self.edge,
                needed: mebibytes(needed),
                most: mebibytes(most),
            });
        }
        self.has_colour = has_colour;
        for key in keys {
            self.index.insert(key, self.voxels.len());
            self.keys.push(key);
            self.voxels.push(Box::new(Block::new()));
        }
        Ok(())
    }

    /// Returns the blocks along the normals of the pixels of a row, without duplicates, in ascending order.
    fn touched(&self, spans: &[[[f64; 3]; 2]]) -> Vec<Key> {
        let block = SIDE as f64 * self.edge;
        let mut keys: Vec<Key> = Vec::new();
        for [from, to] in spans {
            let length = from.iter().zip(to).map(|(a, b)| (b - a).powi(2));
            let steps = (length.sum::<f64>().sqrt() / self.edge).ceil().max(1.0) as usize;
            for step in 0..=steps {
                let share = step as f64 / steps as f64;
                let at = |axis: usize| from[axis] + share * (to[axis] - from[axis]);
                let key = [0, 1, 2].map(|axis| (at(axis) / block).floor() as i32);
                if keys.last() != Some(&key) {
                    keys.push(key);
                }
            }
        }
        keys.sort_unstable();
        keys.dedup();
        keys
    }

    /// Adds the measurements of a frame to every block in the camera's view.
    pub(crate) fn integrate(&mut self, measurements: &Measurements) {
        let edge = self.edge;
        let blocks = self.voxels.par_iter_mut().zip(&self.keys);
        blocks
            .filter(|(_, key)| may_see(measurements, **key, edge))
            .for_each(|(block, key)| block.integrate(*key, edge, measurements));
    }
}

/// Returns the size of a block and its key in bytes.
fn bytes(has_colour: bool) -> usize {
    let colour = if has_colour {
        size_of::<[[f32; 4]; VOXELS]>()
    } else {
        0
    };
    size_of::<Block>() + 2 * size_of::<(Key, usize)>() + colour
}

/// Returns the centre of a voxel of a block along an axis.
pub(crate) fn center(key: i32, voxel: f64, edge: f64) -> f64 {
    (f64::from(key) * SIDE as f64 + voxel + 0.5) * edge
}

/// Whether any voxel of a block may be in the image. Most blocks outside the image are recognised.
fn may_see(measurements: &Measurements, key: Key, edge: f64) -> bool {
    /// Upper bound of the local magnification, relative to that at the centre.
    const ENLARGED: f64 = 2.0;
    let camera = &measurements.camera;
    let middle = key.map(|key| center(key, 0.5 * (SIDE as f64 - 1.0), edge));
    let radius = 0.5 * SIDE as f64 * edge * 3.0_f64.sqrt();
    let (rotation, translation) = camera.pose();
    let [x, y, z] = [0, 1, 2].map(|axis| {
        let row = rotation[axis].iter().zip(middle);
        row.map(|(r, v)| r * v).sum::<f64>() + translation[axis]
    });
    if z + radius <= 0.0 {
        return false;
    }
    if z <= 2.0 * radius {
        return true;
    }
    let Some(([u, v], _)) = camera.project(middle) else {
        return true;
    };
    let [fx, fy] = camera.focal();
    let tangent = x.hypot(y) / z;
    let reach = ENLARGED * fx.max(fy) * radius * (1.0 + tangent) / (z - radius);
    let (width, height) = measurements.size;
    let near = |position: f64, length: usize| {
        position >= -0.5 - reach && position <= length as f64 - 0.5 + reach
    };
    near(u, width) && near(v, height)
}

impl Block {
    fn new() -> Self {
        Self {
            distance: [0.0; VOXELS],
            weight: [0.0; VOXELS],
            colour: None,
        }
    }

    fn integrate(&mut self, key: Key, edge: f64, measurements: &Measurements) {
        let Measurements {
            camera,
            center: camera_center,
            size,
            planes,
            colours,
            ..
        } = measurements;
        for index in 0..VOXELS {
            let voxel = [index % SIDE, index / SIDE % SIDE, index / (SIDE * SIDE)];
            let place = [0, 1, 2].map(|axis| center(key[axis], voxel[axis] as f64, edge));
            let Some(at) = camera.project(place).and_then(|(at, _)| pixel(at, *size)) else {
                continue;
            };
            let plane = &planes[at];
            if plane.weight == 0.0 {
                continue;
            }
            let Some(distance) =
                plane.distance([0, 1, 2].map(|axis| (place[axis] - camera_center[axis]) as f32))
            else {
                continue;
            };
            let weight = &mut self.weight[index];
            *weight += plane.weight;
            let share = plane.weight / *weight;
            let mean = &mut self.distance[index];
            *mean += share * (distance - *mean);
            // Only voxels near the surface are coloured, not the free space in front of it.
            if let Some(colours) = colours
                && distance < plane.truncation
            {
                let empty = || Box::new([[0.0; 4]; VOXELS]);
                let colour = &mut self.colour.get_or_insert_with(empty)[index];
                colour[3] += plane.weight;
                let share = plane.weight / colour[3];
                for (mean, value) in colour.iter_mut().zip(&colours[3 * at..3 * at + 3]) {
                    *mean += share * (f32::from(*value) - *mean);
                }
            }
        }
    }
}
