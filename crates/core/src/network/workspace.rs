//! The layers of a network on the CPU, and their shared memory.

use super::executor::Executor;
use super::map::{Map, Pool};
use lsdc_kernels::conv::Layer;
use lsdc_kernels::schedule::InTasks;
use lsdc_kernels::simd::{Level, Scratch, Tail};
use rayon::prelude::*;
use std::sync::Arc;

/// Memory for the layers of a network.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    pub(super) scratch: Scratch,
    pub(super) pool: Pool,
}

impl Workspace {
    /// Returns the output of a layer; `skip` is added before the ReLU.
    pub(super) fn layer(&self, layer: &Layer, x: &Map, skip: Option<&Map>, relu: bool) -> Map {
        let size = [1, x.height, x.width];
        let shape = layer.shape(size);
        let (height, width) = shape.out();
        let mut output = self.pool.take(height, width, shape.outputs);
        let tail = Tail {
            skip: skip.map(|map| &map.values[..]),
            relu,
        };
        layer.apply(&x.values, size, tail, &self.scratch, &mut output.values);
        output
    }

    /// Frees the unused memory.
    pub(super) fn clear(&self) {
        self.scratch.clear();
        self.pool.clear();
    }
}

impl Executor for Workspace {
    type Layer = Layer;
    type Map = Arc<Map>;

    fn layer(&self, layer: &Layer, x: &Arc<Map>, skip: Option<&Arc<Map>>, relu: bool) -> Arc<Map> {
        Arc::new(self.layer(layer, x, skip.map(|map| &**map), relu))
    }

    fn layer_plus_enlarged(&self, layer: &Layer, x: &Arc<Map>, coarser: &Arc<Map>) -> Arc<Map> {
        let mut sum = self.layer(layer, x, None, false);
        sum.add_enlarged(coarser);
        Arc::new(sum)
    }

    fn plus_enlarged_layer(&self, map: Arc<Map>, layer: &Layer, x: &Arc<Map>) -> Arc<Map> {
        let coarser = self.layer(layer, x, None, false);
        let mut sum = Arc::try_unwrap(map).unwrap_or_else(|map| map.copied());
        sum.add_enlarged(&coarser);
        Arc::new(sum)
    }

    fn enlarged(&self, map: &Arc<Map>, like: &Arc<Map>) -> Arc<Map> {
        Arc::new(map.enlarged(like.height, like.width))
    }

    fn averages(&self, map: &Arc<Map>, sizes: &[usize]) -> Vec<Arc<Map>> {
        let sizes = sizes.iter();
        sizes.map(|&size| Arc::new(averages(map, size))).collect()
    }

    fn concatenated(&self, [raw, skip]: [&Arc<Map>; 2], coarser: &[Arc<Map>]) -> Arc<Map> {
        Arc::new(concatenated(raw, skip, coarser))
    }
}

/// Concatenates the channels of all maps; branches are upsampled bilinearly.
fn concatenated(raw: &Map, skip: &Map, branches: &[Arc<Map>]) -> Map {
    let own = [raw, skip].map(Map::channels);
    let coarser = branches.iter().map(|map| map.channels());
    let channels: usize = own.into_iter().chain(coarser).sum();
    let mut all = raw.pool.take(raw.height, raw.width, channels);
    let level = Level::here();
    let rows = all.values.par_chunks_exact_mut(raw.width * channels);
    rows.enumerate().each(|(y, row)| {
        level.vectorised(
            #[inline(always)]
            || {
                for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
                    let mut remaining = pixel;
                    for map in [raw, skip] {
                        let (own, others) = remaining.split_at_mut(map.channels());
                        let from = (y * raw.width + x) * own.len();
                        own.copy_from_slice(&map.values[from..from + own.len()]);
                        remaining = others;
                    }
                    for map in branches {
                        let (own, others) = remaining.split_at_mut(map.channels());
                        map.enlarged_pixel((y, raw.height), (x, raw.width), own);
                        remaining = others;
                    }
                }
            },
        );
    });
    all
}

/// Returns means over windows of `size` pixels; windows are cropped at the end.
fn averages(map: &Map, size: usize) -> Map {
    let (height, width) = (map.height.div_ceil(size), map.width.div_ceil(size));
    let channels = map.channels();
    let mut output = map.pool.take(height, width, channels);
    output.values.fill(0.0);
    let rows = output
        .values
        .par_chunks_exact_mut(width * channels)
        .enumerate();
    rows.each(|(window_row, sums)| {
        let rows = window_row * size..((window_row + 1) * size).min(map.height);
        for y in rows.clone() {
            let row = &map.values[y * map.width * channels..][..map.width * channels];
            for (x, pixel) in row.chunks_exact(channels).enumerate() {
                let sum = &mut sums[x / size * channels..][..channels];
                sum.iter_mut().zip(pixel).for_each(|(s, v)| *s += v);
            }
        }
        for (window, sum) in sums.chunks_exact_mut(channels).enumerate() {
            let columns = size.min(map.width - window * size);
            let scale = 1.0 / (rows.len() * columns) as f32;
            for value in sum {
                *value *= scale;
            }
        }
    });
    output
}
