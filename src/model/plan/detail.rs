//! The network's part at full resolution.

use super::extractor::Run;
use super::map::Map;
use crate::conv::Layer;
use crate::model::detail::Detail;
use crate::simd::Level;
use rayon::prelude::*;

#[derive(Debug)]
pub(super) struct DetailPlan {
    quarter: Layer,
    context: Layer,
    narrow: Layer,
    colour: Layer,
    mix: Vec<Layer>,
    edges: Layer,
}

impl DetailPlan {
    pub(super) fn new(net: &Detail, level: Level) -> Option<Self> {
        let mix = net.mix.iter().map(|conv| conv.folded(level));
        Some(Self {
            quarter: net.quarter.prepared(level),
            context: net.context.folded(level)?,
            narrow: net.narrow.prepared(level),
            colour: net.colour.folded(level)?,
            mix: mix.collect::<Option<_>>()?,
            edges: net.edges.prepared(level),
        })
    }

    /// Features at full resolution, and how edges differ from those of the colours.
    pub(super) fn forward(&self, image: &Map, half: Map, quarter: &Map, run: Run<'_>) -> [Map; 2] {
        let next = |layer: &Layer, map: Map, relu: bool| {
            let output = run.layer(layer, &map, None, relu);
            run.pool.give(map);
            output
        };
        let mut gathered = half;
        let quarter = run.layer(&self.quarter, quarter, None, false);
        add_enlarged(&mut gathered, &quarter);
        run.pool.give(quarter);
        let context = next(&self.narrow, next(&self.context, gathered, true), false);
        let mut features = run.layer(&self.colour, image, None, true);
        add_enlarged(&mut features, &context);
        run.pool.give(context);
        let layers = self.mix.iter();
        let features = layers.fold(features, |map, layer| next(layer, map, true));
        let edges = run.layer(&self.edges, &features, None, false);
        [features, edges]
    }
}

/// Adds a map of the same channels, enlarged bilinearly.
fn add_enlarged(sum: &mut Map, map: &Map) {
    let (height, width, channels) = (sum.height, sum.width, sum.channels());
    let rows = sum.values.par_chunks_exact_mut(width * channels);
    rows.enumerate().for_each(|(y, row)| {
        let mut value = vec![0.0; channels];
        for (x, pixel) in row.chunks_exact_mut(channels).enumerate() {
            map.enlarged((y, height), (x, width), &mut value);
            pixel.iter_mut().zip(&value).for_each(|(p, v)| *p += v);
        }
    });
}
