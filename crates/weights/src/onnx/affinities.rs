//! From a normalised image to the affinities of neighbouring pixels.

use super::graph::{COLUMNS, ROWS};
use super::layers::{Conv, Layers};
use crate::error::Result;
use lsdc_core::network::{CONTRAST, LEAST_AFFINITY, MAX_LOG_FACTOR, NetworkConfig};

/// Computes the affinities of each pixel with its right and its lower neighbour, `[batch, 2, height, width]`.
pub(super) fn affinities(
    layers: &mut Layers<'_>,
    image: &str,
    network: &NetworkConfig,
) -> Result<String> {
    let [right, down] = [COLUMNS, ROWS].map(|axis| from_colours(layers, image, axis));
    let colours = layers.graph.concat(&[&right, &down], 1);
    if network.affinities == 0 {
        return Ok(colours);
    }
    let changes = changes(layers, image, network.levels().len())?;
    let graph = &mut layers.graph;
    let clipped = [(0, MAX_LOG_FACTOR), (2, 1.0)].map(|(first, limit)| {
        let part = graph.slice(&changes, 1, first, first + 2);
        let [low, high] = [-limit, limit].map(|limit| graph.scalar(limit as f32));
        graph.apply("Clip", &[&part, &low, &high])
    });
    let [log_factor, exponent] = clipped;
    let one = graph.scalar(1.0);
    let exponent = graph.apply("Add", &[&exponent, &one]);
    let logarithm = graph.apply("Log", &[&colours]);
    let product = graph.apply("Mul", &[&logarithm, &exponent]);
    let sum = graph.apply("Add", &[&product, &log_factor]);
    Ok(graph.apply("Exp", &[&sum]))
}

/// Computes affinities with the next pixel along an axis, from colours alone; the last pixel is its own neighbour.
fn from_colours(layers: &mut Layers<'_>, image: &str, axis: i64) -> String {
    let graph = &mut layers.graph;
    let [others, last] = [1, -1].map(|start| graph.slice(image, axis, start, i64::MAX));
    let next = graph.concat(&[&others, &last], axis);
    let difference = graph.apply("Sub", &[image, &next]);
    let squares = graph.apply("Mul", &[&difference, &difference]);
    let channels = graph.indices(&[1]);
    let square = graph.apply("ReduceSum", &[&squares, &channels]);
    let [unit, one, least] =
        [CONTRAST * CONTRAST, 1.0, LEAST_AFFINITY].map(|value| graph.scalar(value as f32));
    let relative = graph.apply("Div", &[&square, &unit]);
    let denominator = graph.apply("Add", &[&relative, &one]);
    let affinity = graph.apply("Reciprocal", &[&denominator]);
    graph.apply("Add", &[&affinity, &least])
}

/// Computes the output of the affinity network, which has `count` levels.
fn changes(layers: &mut Layers<'_>, image: &str, count: usize) -> Result<String> {
    let mut levels: Vec<String> = Vec::new();
    for level in 0..count {
        let first = if level == 0 {
            Conv::SAME
        } else {
            Conv::HALVING
        };
        let before = levels.last().map_or(image, String::as_str);
        let x = layers.conv_norm(before, &format!("edges.down.{level}.0"), first)?;
        levels.push(layers.conv_norm(&x, &format!("edges.down.{level}.1"), Conv::SAME)?);
    }
    let mut levels = levels.into_iter().rev();
    let mut x = levels.next().unwrap_or_default();
    for (i, level) in levels.enumerate() {
        let name = |part: &str| format!("edges.up.{i}.{part}");
        let narrow = layers.plain(&x, &name("narrow"))?;
        x = layers.add_enlarged(&level, &narrow);
        for layer in ["mix.0", "mix.1"] {
            x = layers.conv_norm(&x, &name(layer), Conv::SAME)?;
        }
    }
    layers.plain(&x, "edges.last")
}
