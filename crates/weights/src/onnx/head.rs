//! From features to basis functions: the MLP at full resolution.
//!
//! As in `lsdc-core`, the first layer for features is applied before upsampling, with which it commutes, and that for
//! positional codes to one row and one column of the image.

use super::extractor::Features;
use super::graph::{COLUMNS, Graph, ROWS, int};
use super::layers::{Conv, Layers};
use super::proto::element;
use crate::error::{Error, Result};
use lsdc_core::network::{MAX_LOG_DEPTH, NetworkConfig};

/// Computes the basis functions `[batch, N + 1, height, width]` of an image.
pub(super) fn basis(
    layers: &mut Layers<'_>,
    image: &str,
    output: &Features,
    network: &NetworkConfig,
) -> Result<String> {
    let size = layers.graph.size(image);
    let mut x = first_layer(layers, output, &size, network)?;
    for i in 1..network.hidden.len() {
        let Linear {
            depth,
            columns,
            values,
            bias,
        } = linear_norm(layers, &format!("head.hidden.{i}"))?;
        let weights = transposed(&values, columns, 0..depth);
        let weights = (&[columns, depth][..], &weights[..], Some(&bias[..]));
        x = layers.conv(&x, &format!("head.hidden.{i}"), weights, Conv::SAME);
    }
    let functions = pointwise(layers, &x, "head.last")?;
    let first = match (&output.logarithm, network.mean) {
        (_, false) => {
            let batch = layers.graph.lengths(image, 0, 1);
            let one = layers.graph.indices(&[1]);
            let shape = layers.graph.concat(&[&batch, &one, &size], 0);
            let constant = layers.graph.scalar(1.0);
            layers.graph.apply("Expand", &[&constant, &shape])
        }
        (Some(map), true) => {
            let map = layers.graph.resize(map, &size);
            depth_map(&mut layers.graph, &map)
        }
        (None, true) => {
            let map = pointwise(layers, &x, "head.mean")?;
            depth_map(&mut layers.graph, &map)
        }
    };
    Ok(layers.graph.concat(&[&first, &functions], 1))
}

/// Computes a positive map from its clamped logarithm.
fn depth_map(graph: &mut Graph, logarithm: &str) -> String {
    let [low, high] = [-MAX_LOG_DEPTH, MAX_LOG_DEPTH].map(|limit| graph.scalar(limit));
    let limited = graph.apply("Clip", &[logarithm, &low, &high]);
    graph.apply("Exp", &[&limited])
}

/// Computes the first hidden layer, after its ReLU.
fn first_layer(
    layers: &mut Layers<'_>,
    output: &Features,
    size: &str,
    network: &NetworkConfig,
) -> Result<String> {
    let Linear {
        columns,
        values,
        bias,
        ..
    } = linear_norm(layers, "head.hidden.0")?;
    let (features, codes) = (network.extractor.features, 2 * network.octaves);
    let weights = transposed(&values, columns, 0..features);
    let weights = (&[columns, features][..], &weights[..], Some(&bias[..]));
    let x = layers.conv(
        &output.features,
        "head.hidden.0",
        weights,
        Conv::SAME.linear(),
    );
    let graph = &mut layers.graph;
    let mut x = graph.resize(&x, size);
    if network.octaves > 0 {
        for (axis, first) in [(COLUMNS, features), (ROWS, features + codes)] {
            let rows = transposed(&values, columns, first..first + codes);
            let of_axis = position_terms(graph, size, axis, (&rows, columns, network.octaves));
            x = graph.apply("Add", &[&x, &of_axis]);
        }
    }
    Ok(graph.apply("Relu", &[&x]))
}

/// Computes the contribution of the positional codes along an axis to the first layer, `[1, columns, height, 1]` or `[1,
/// columns, 1, width]`; `weights` `[columns, 2 octaves]` are those of these codes.
fn position_terms(
    graph: &mut Graph,
    size: &str,
    axis: i64,
    (weights, columns, octaves): (&[f32], usize, usize),
) -> String {
    let name = if axis == ROWS { "rows" } else { "columns" };
    let length = graph.slice(size, 0, axis - ROWS, axis - ROWS + 1);
    let float = |graph: &mut Graph, x: &str| {
        graph.node("Cast", &[x], [int("to", i64::from(element::FLOAT))])
    };
    let length = float(graph, &length);
    // From edge to edge, an axis is [-1, 1]: (2 i + 1 - length) / length, whose numerator is exact.
    let end = graph.apply("Squeeze", &[&length]);
    let [zero, one, two] = [0.0, 1.0, 2.0].map(|value| graph.scalar(value));
    let index = graph.apply("Range", &[&zero, &end, &one]);
    let twice = graph.apply("Mul", &[&index, &two]);
    let shift = graph.apply("Sub", &[&one, &length]);
    let numerator = graph.apply("Add", &[&twice, &shift]);
    let place = graph.apply("Div", &[&numerator, &length]);
    let first = graph.indices(&[0]);
    let place = graph.apply("Unsqueeze", &[&place, &first]);
    // The sine and the cosine of each octave; the coordinate itself has the first two weights.
    let waves = octaves - 1;
    let frequencies: Vec<f32> = (0..waves)
        .map(|k| (f64::from(1 << k) * std::f64::consts::PI) as f32)
        .collect();
    let mut codes = vec![place.clone()];
    if waves > 0 {
        let name = format!("head.positions.{name}.frequencies");
        let frequencies = graph.floats(name, &[waves, 1], &frequencies);
        let angles = graph.apply("Mul", &[&frequencies, &place]);
        codes.extend(["Sin", "Cos"].map(|wave| graph.apply(wave, &[&angles])));
    }
    let codes: Vec<&str> = codes.iter().map(String::as_str).collect();
    let codes = graph.concat(&codes, 0);
    let ordered = weights.chunks_exact(2 * octaves).flat_map(|row| {
        let waves = row[2..].iter();
        let sines = waves.clone().step_by(2);
        let cosines = waves.skip(1).step_by(2);
        std::iter::once(row[0] + row[1]).chain(sines.chain(cosines).copied())
    });
    let ordered: Vec<f32> = ordered.collect();
    let shape = [columns, 2 * octaves - 1];
    let weights = graph.floats(format!("head.positions.{name}.weight"), &shape, &ordered);
    let terms = graph.apply("MatMul", &[&weights, &codes]);
    // Axes of the batch, and of the other direction.
    let more = graph.indices(&[0, ROWS + COLUMNS - axis]);
    graph.apply("Unsqueeze", &[&terms, &more])
}

/// A linear map with bias, as rows `[depth, columns]`.
struct Linear {
    depth: usize,
    columns: usize,
    values: Vec<f32>,
    bias: Vec<f32>,
}

/// Returns a linear map with the following normalisation folded in.
fn linear_norm(layers: &Layers<'_>, name: &str) -> Result<Linear> {
    let (depth, columns, values) = matrix(layers, &format!("{name}.linear.weight"))?;
    let (slopes, bias) = layers.batch_norm(name)?;
    let scaled = values.iter().zip(slopes.iter().cycle());
    Ok(Linear {
        depth,
        columns,
        values: scaled.map(|(v, s)| (f64::from(*v) * s) as f32).collect(),
        bias,
    })
}

/// Applies a linear map at every pixel.
fn pointwise(layers: &mut Layers<'_>, x: &str, name: &str) -> Result<String> {
    let (depth, columns, values) = matrix(layers, &format!("{name}.weight"))?;
    let weights = transposed(values, columns, 0..depth);
    let weights = (&[columns, depth][..], &weights[..], None);
    Ok(layers.conv(x, name, weights, Conv::SAME.linear()))
}

/// Returns depth, columns and values of a tensor `[depth, columns]`.
fn matrix<'a>(layers: &Layers<'a>, name: &str) -> Result<(usize, usize, &'a [f32])> {
    let tensor = layers.tensor(name)?;
    match *tensor.shape() {
        [depth, columns] => Ok((depth, columns, tensor.values())),
        _ => Err(Error::weights(format!("`{name}` is not a matrix"))),
    }
}

/// Transposes some rows of a matrix `[depth, columns]` to `[columns, rows]`.
fn transposed(values: &[f32], columns: usize, rows: std::ops::Range<usize>) -> Vec<f32> {
    let column = |column| rows.clone().map(move |row| values[row * columns + column]);
    (0..columns).flat_map(column).collect()
}
