//! The network's part at full resolution.

use super::extractor::Run;
use super::map::Map;
use crate::conv::Layer;
use crate::model::detail::Detail;
use crate::simd::Level;
use rayon::prelude::*;

#[derive(Debug)]
pub(super) struct DetailPlan {
    colour: Layer,
    half: Layer,
    quarter: Layer,
    mix: Vec<Layer>,
    edges: Layer,
}

impl DetailPlan {
    pub(super) fn new(net: &Detail, level: Level) -> Option<Self> {
        Some(Self {
            colour: net.colour.folded(level)?,
            half: net.half.prepared(level),
            quarter: net.quarter.prepared(level),
            mix: net
                .mix
                .iter()
                .map(|conv| conv.folded(level))
                .collect::<Option<_>>()?,
            edges: net.edges.prepared(level),
        })
    }

    /// Features at full resolution, and the logarithms by which edges change.
    pub(super) fn forward(&self, image: &Map, half: &Map, quarter: &Map, run: Run<'_>) -> [Map; 2] {
        let mut features = run.layer(&self.colour, image, None, true);
        let half = run.layer(&self.half, half, None, false);
        let quarter = run.layer(&self.quarter, quarter, None, false);
        add_enlarged(&mut features, [&half, &quarter]);
        run.pool.give(half);
        run.pool.give(quarter);
        for layer in &self.mix {
            let next = run.layer(layer, &features, None, true);
            run.pool.give(std::mem::replace(&mut features, next));
        }
        let edges = run.layer(&self.edges, &features, None, false);
        [features, edges]
    }
}

/// Adds maps of the same channels, enlarged bilinearly.
fn add_enlarged(sum: &mut Map, maps: [&Map; 2]) {
    let (height, width, channels) = (sum.height, sum.width, sum.channels());
    let rows = sum.values.par_chunks_exact_mut(width * channels);
    rows.enumerate().for_each(|(y, row)| {
        let mut value = vec![0.0; channels];
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            for map in maps {
                map.enlarged((y, height), (x, width), &mut value);
                pixel.iter_mut().zip(&value).for_each(|(p, v)| *p += v);
            }
        }
    });
}
