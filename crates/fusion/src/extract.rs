//! Extraction of the surface at distance 0.

use crate::blocks::{Block, Blocks, Key, SIDE, VOXELS, center};
use crate::cells::{EDGES, TRIANGLES};
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use rayon::prelude::*;
use std::collections::HashMap;

/// Side of a block with one layer of neighbouring voxels, for the cells at its end and for gradients.
const PADDED: usize = SIDE + 2;

/// A vertex on the edge from a voxel to the next along an axis; ordered by block, voxel and axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct VertexId(u64);

impl VertexId {
    fn new(rank: usize, voxel: usize, axis: usize) -> Self {
        Self(((rank * VOXELS + voxel) * 3 + axis) as u64)
    }

    fn parts(self) -> (usize, usize, usize) {
        let (voxel, axis) = (self.0 as usize / 3, self.0 as usize % 3);
        (voxel / VOXELS, voxel % VOXELS, axis)
    }
}

/// A vertex that is not yet part of a mesh.
struct Vertex {
    position: [f64; 3],
    normal: [f32; 3],
    colour: Option<[u8; 3]>,
}

/// Extracts the surface of all cells whose eight corners were measured.
pub(crate) fn mesh(blocks: &Blocks) -> Result<Mesh> {
    let keys = blocks.sorted_keys();
    let ranks: HashMap<Key, usize> = keys.iter().copied().zip(0..).collect();
    let triangles: Vec<[VertexId; 3]> = keys
        .par_iter()
        .flat_map_iter(|key| triangles(blocks, &ranks, *key))
        .collect();
    let mut ids: Vec<VertexId> = triangles.iter().flatten().copied().collect();
    ids.par_sort_unstable();
    ids.dedup();
    if u32::try_from(ids.len()).is_err() {
        return Err(Error::TooLarge { count: ids.len() });
    }
    let of_blocks: Vec<&[VertexId]> = ids.chunk_by(|a, b| a.parts().0 == b.parts().0).collect();
    let vertices: Vec<Vertex> = of_blocks
        .par_iter()
        .flat_map_iter(|ids| vertices(blocks, keys[ids[0].parts().0], ids))
        .collect();
    let index = |id: VertexId| ids.binary_search(&id).unwrap_or_default() as u32;
    let coloured = vertices
        .iter()
        .filter(|vertex| vertex.colour.is_some())
        .count();
    let colour = |vertex: &Vertex| vertex.colour.unwrap_or(Mesh::UNKNOWN_COLOUR);
    Ok(Mesh {
        triangles: triangles.par_iter().map(|ids| ids.map(index)).collect(),
        colours: (coloured > 0).then(|| vertices.iter().map(colour).collect()),
        uncoloured: vertices.len() - coloured,
        positions: vertices.iter().map(|vertex| vertex.position).collect(),
        normals: vertices.iter().map(|vertex| vertex.normal).collect(),
    })
}

/// Returns the triangles of the cells that begin in a block.
fn triangles(blocks: &Blocks, ranks: &HashMap<Key, usize>, key: Key) -> Vec<[VertexId; 3]> {
    let padded = Padded::new(blocks, key);
    let mut found = Vec::new();
    for index in 0..VOXELS {
        let cell = [index % SIDE, index / SIDE % SIDE, index / (SIDE * SIDE)];
        let corner =
            |corner: u8| [0, 1, 2].map(|axis| cell[axis] + usize::from(corner >> axis & 1));
        let mut case = 0_usize;
        let mut is_measured = true;
        for number in 0..8 {
            let distance = padded.at(corner(number).map(|v| v as isize));
            is_measured &= !distance.is_nan();
            case |= usize::from(distance < 0.0) << number;
        }
        if !is_measured {
            continue;
        }
        let id = |edge: u8| {
            let (low, axis) = EDGES[usize::from(edge)];
            let voxel = corner(low);
            let owner = [0, 1, 2].map(|axis| key[axis] + (voxel[axis] / SIDE) as i32);
            let [x, y, z] = voxel.map(|v| v % SIDE);
            // Blocks with measured voxels exist.
            let rank = ranks.get(&owner).copied().unwrap_or_default();
            VertexId::new(rank, (z * SIDE + y) * SIDE + x, axis)
        };
        found.extend(TRIANGLES[case].iter().map(|edges| edges.map(id)));
    }
    found
}

/// Returns the vertices on edges that begin in a block.
fn vertices(blocks: &Blocks, key: Key, ids: &[VertexId]) -> Vec<Vertex> {
    let padded = Padded::new(blocks, key);
    let edge = blocks.edge();
    let vertex = |id: &VertexId| {
        let (_, index, axis) = id.parts();
        let from = [index % SIDE, index / SIDE % SIDE, index / (SIDE * SIDE)].map(|v| v as isize);
        let mut to = from;
        to[axis] += 1;
        let [a, b] = [from, to].map(|voxel| f64::from(padded.at(voxel)));
        let share = a / (a - b);
        let mut place = from.map(|v| v as f64);
        place[axis] += share;
        let position = [0, 1, 2].map(|axis| center(key[axis], place[axis], edge));
        // Along the edge, the difference of its ends is never 0.
        let gradient = [0, 1, 2].map(|along| {
            if along == axis {
                return b - a;
            }
            let [a, b] = [from, to].map(|voxel| padded.slope(voxel, along));
            a + share * (b - a)
        });
        let length = gradient.iter().map(|v| v * v).sum::<f64>().sqrt();
        Vertex {
            position,
            normal: gradient.map(|v| (v / length) as f32),
            colour: colour(blocks, key, [from, to], share),
        }
    };
    ids.iter().map(vertex).collect()
}

/// Interpolates the colour between two voxels; if only one has a colour, returns that.
fn colour(blocks: &Blocks, key: Key, ends: [[isize; 3]; 2], share: f64) -> Option<[u8; 3]> {
    let [a, b] = ends.map(|voxel| {
        let (block, index) = located(blocks, key, voxel)?;
        let colour = block.colour.as_ref()?[index];
        (colour[3] > 0.0).then_some(colour)
    });
    let mixed = |channel: usize| match (a, b) {
        (Some(a), Some(b)) => {
            let [a, b] = [a, b].map(|colour| f64::from(colour[channel]));
            Some(a + share * (b - a))
        }
        (one, other) => one.or(other).map(|colour| f64::from(colour[channel])),
    };
    Some([mixed(0)?, mixed(1)?, mixed(2)?].map(|v| v.round() as u8))
}

/// Returns the block of a voxel, counted from the first voxel of another block, and its index in it.
fn located(blocks: &Blocks, key: Key, voxel: [isize; 3]) -> Option<(&Block, usize)> {
    const LENGTH: isize = SIDE as isize;
    let owner = [0, 1, 2].map(|axis| key[axis] + voxel[axis].div_euclid(LENGTH) as i32);
    let [x, y, z] = voxel.map(|v| v.rem_euclid(LENGTH) as usize);
    Some((blocks.get(owner)?, (z * SIDE + y) * SIDE + x))
}

/// Distances of a block and of the voxels around it; NaN without a measurement.
struct Padded(Vec<f32>);

impl Padded {
    fn new(blocks: &Blocks, key: Key) -> Self {
        let neighbours: Vec<Option<&Block>> = (0..27)
            .map(|i| {
                let offset = [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1];
                blocks.get([0, 1, 2].map(|axis| key[axis] + offset[axis]))
            })
            .collect();
        // Maps the position in the padded block to the block before, at or after it, and the position in that.
        let part = |position: usize| match position {
            0 => (0, SIDE - 1),
            PADDED_LAST => (2, 0),
            inner => (1, inner - 1),
        };
        let mut distances = Vec::with_capacity(PADDED.pow(3));
        for z in 0..PADDED {
            for y in 0..PADDED {
                for x in 0..PADDED {
                    let [(i, x), (j, y), (k, z)] = [x, y, z].map(part);
                    let index = (z * SIDE + y) * SIDE + x;
                    let block = neighbours[(k * 3 + j) * 3 + i];
                    let block = block.filter(|block| block.weight[index] > 0.0);
                    distances.push(block.map_or(f32::NAN, |block| block.distance[index]));
                }
            }
        }
        Self(distances)
    }

    /// Returns the distance at a voxel, from -1 to 8 along each axis.
    fn at(&self, voxel: [isize; 3]) -> f32 {
        let [x, y, z] = voxel.map(|v| (v + 1) as usize);
        self.0[(z * PADDED + y) * PADDED + x]
    }

    /// Returns the central difference at a voxel, or a one-sided one if only one neighbour is measured; 0 if none is.
    fn slope(&self, voxel: [isize; 3], axis: usize) -> f64 {
        let [mut before, mut after] = [voxel; 2];
        before[axis] -= 1;
        after[axis] += 1;
        let [before, own, after] = [before, voxel, after].map(|voxel| f64::from(self.at(voxel)));
        match (before.is_nan(), after.is_nan()) {
            (false, false) => 0.5 * (after - before),
            (false, true) => own - before,
            (true, false) => after - own,
            (true, true) => 0.0,
        }
    }
}

const PADDED_LAST: usize = PADDED - 1;
