//! The network that judges edges, layer by layer.

use super::map::Map;
use super::run::Run;
use crate::conv::Layer;
use crate::model::edge_net::EdgeNet;
use crate::model::layers::ConvNorm;
use crate::simd::Level;

#[derive(Debug)]
pub(super) struct EdgePlan {
    down: Vec<[Layer; 2]>,
    up: Vec<RisePlan>,
    last: Layer,
}

#[derive(Debug)]
struct RisePlan {
    narrow: Layer,
    mix: [Layer; 2],
}

impl EdgePlan {
    pub(super) fn new(net: &EdgeNet, level: Level) -> Option<Self> {
        let both = |[one, two]: &[ConvNorm; 2]| Some([one.folded(level)?, two.folded(level)?]);
        let up = net.up.iter().map(|rise| {
            Some(RisePlan {
                narrow: rise.narrow.prepared(level),
                mix: both(&rise.mix)?,
            })
        });
        Some(Self {
            down: net.down.iter().map(both).collect::<Option<_>>()?,
            up: up.collect::<Option<_>>()?,
            last: net.last.prepared(level),
        })
    }

    /// How edges differ from those of the colours.
    pub(super) fn forward(&self, image: &Map, run: Run<'_>) -> Map {
        let next = |x: Map, layer: &Layer| {
            let output = run.layer(layer, &x, None, true);
            run.pool.give(x);
            output
        };
        let mut levels: Vec<Map> = Vec::new();
        for [first, second] in &self.down {
            let x = run.layer(first, levels.last().unwrap_or(image), None, true);
            levels.push(next(x, second));
        }
        let lowest = levels.pop().unwrap_or_default();
        let pairs = self.up.iter().zip(levels.into_iter().rev());
        let x = pairs.fold(lowest, |x, (rise, mut level)| {
            let narrow = run.layer(&rise.narrow, &x, None, false);
            run.pool.give(x);
            level.add_enlarged(&narrow);
            run.pool.give(narrow);
            rise.mix.iter().fold(level, next)
        });
        let changes = run.layer(&self.last, &x, None, false);
        run.pool.give(x);
        changes
    }
}
