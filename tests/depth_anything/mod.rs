//! A tiny Depth Anything with sines as weights, as in `scripts/golden_encoder.py`.

use super::{DepthAnything, DepthHead, Encoder, EncoderConfig, Tensor};
use lsdc_kernels::simd::Level;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Channels of a token.
pub(crate) const WIDTH: usize = 16;
/// Channels of the four maps of the head, of the fused map, and of the last layers.
const OWN: [usize; 4] = [4, 6, 8, 10];
const FUSED: usize = 6;
const FINE: usize = 7;

/// Returns an encoder of four blocks, all of them taps, and the head.
pub(crate) fn network() -> DepthAnything {
    let (config, level) = (sizes(4, &[0, 1, 2, 3]), Level::here());
    let encoder = Encoder::new(config, &encoder_weights(4), level).unwrap();
    let head = DepthHead::new(&head_weights(), level).unwrap();
    DepthAnything::with_parts(Arc::new(encoder), head).unwrap()
}

/// Returns the sizes of an encoder.
pub(crate) fn sizes(blocks: usize, taps: &[usize]) -> EncoderConfig {
    EncoderConfig {
        width: WIDTH,
        heads: 2,
        blocks,
        hidden: 32,
        side: 4,
        taps: taps.to_vec(),
    }
}

pub(crate) fn sines(index: usize, shape: &[usize], scale: f64, offset: f64) -> Tensor {
    let count = shape.iter().product();
    let value = |i: usize| (offset + scale * (0.37 * i as f64 + index as f64).sin()) as f32;
    Tensor::new(shape.to_vec(), (0..count).map(value).collect()).unwrap()
}

/// Returns the weights of an encoder with a number of blocks.
pub(crate) fn encoder_weights(blocks: usize) -> BTreeMap<String, Tensor> {
    encoder_weights_of(&sizes(blocks, &[]))
}

/// Returns the weights of an encoder, with `DINOv2`'s names.
pub(crate) fn encoder_weights_of(config: &EncoderConfig) -> BTreeMap<String, Tensor> {
    let EncoderConfig {
        width,
        blocks,
        hidden,
        side,
        ..
    } = *config;
    let patch = 14;
    let mut all = BTreeMap::new();
    let mut add = |name: String, shape: &[usize], scale: f64, offset: f64| {
        let tensor = sines(all.len(), shape, scale, offset);
        all.insert(name, tensor);
    };
    add("cls_token".into(), &[1, 1, width], 0.5, 0.0);
    add("pos_embed".into(), &[1, 1 + side * side, width], 0.5, 0.0);
    add(
        "patch_embed.proj.weight".into(),
        &[width, 3, patch, patch],
        0.05,
        0.0,
    );
    add("patch_embed.proj.bias".into(), &[width], 0.1, 0.0);
    for block in 0..blocks {
        let mut part = |name: &str, shape: &[usize], scale: f64, offset: f64| {
            add(format!("blocks.{block}.{name}"), shape, scale, offset);
        };
        part("norm1.weight", &[width], 0.3, 1.0);
        part("norm1.bias", &[width], 0.1, 0.0);
        part("attn.qkv.weight", &[3 * width, width], 0.4, 0.0);
        part("attn.qkv.bias", &[3 * width], 0.1, 0.0);
        part("attn.proj.weight", &[width, width], 0.3, 0.0);
        part("attn.proj.bias", &[width], 0.1, 0.0);
        part("ls1.gamma", &[width], 0.3, 0.7);
        part("norm2.weight", &[width], 0.3, 1.0);
        part("norm2.bias", &[width], 0.1, 0.0);
        part("mlp.fc1.weight", &[hidden, width], 0.3, 0.0);
        part("mlp.fc1.bias", &[hidden], 0.1, 0.0);
        part("mlp.fc2.weight", &[width, hidden], 0.3, 0.0);
        part("mlp.fc2.bias", &[width], 0.1, 0.0);
        part("ls2.gamma", &[width], 0.3, 0.7);
    }
    add("norm.weight".into(), &[width], 0.3, 1.0);
    add("norm.bias".into(), &[width], 0.1, 0.0);
    all
}

/// Returns the weights of the head.
pub(crate) fn head_weights() -> BTreeMap<String, Tensor> {
    head_weights_of(WIDTH)
}

/// Returns the weights of a head that reads taps of a width, with the published names.
pub(crate) fn head_weights_of(width: usize) -> BTreeMap<String, Tensor> {
    head_weights_with(width, OWN)
}

/// As [`head_weights_of`], with the channels of the four maps.
pub(crate) fn head_weights_with(width: usize, own: [usize; 4]) -> BTreeMap<String, Tensor> {
    let mut shapes: Vec<(String, Vec<usize>)> = Vec::new();
    let mut add = |name: String, shape: &[usize]| {
        shapes.push((format!("{name}.weight"), shape.to_vec()));
        // The maps of taps are mixed without a bias.
        let outputs = (!name.ends_with("_rn")).then(|| vec![shape[0]]);
        shapes.extend(outputs.map(|outputs| (format!("{name}.bias"), outputs)));
    };
    for (i, own) in own.into_iter().enumerate() {
        add(format!("projects.{i}"), &[own, width, 1, 1]);
    }
    for (i, side) in [(0, 4), (1, 2), (3, 3)] {
        add(format!("resize_layers.{i}"), &[own[i], own[i], side, side]);
    }
    for (i, own) in own.into_iter().enumerate() {
        add(format!("scratch.layer{}_rn", i + 1), &[FUSED, own, 3, 3]);
    }
    for i in 1..=4 {
        let name = format!("scratch.refinenet{i}");
        for (unit, conv) in [(1, 1), (1, 2), (2, 1), (2, 2)] {
            let name = format!("{name}.resConfUnit{unit}.conv{conv}");
            add(name, &[FUSED, FUSED, 3, 3]);
        }
        add(format!("{name}.out_conv"), &[FUSED, FUSED, 1, 1]);
    }
    let half = FUSED / 2;
    add("scratch.output_conv1".into(), &[half, FUSED, 3, 3]);
    add("scratch.output_conv2.0".into(), &[FINE, half, 3, 3]);
    add("scratch.output_conv2.2".into(), &[1, FINE, 1, 1]);
    let count = shapes.len();
    let drawn = shapes.into_iter().enumerate().map(|(i, (name, shape))| {
        let (scale, offset) = match shape[..] {
            [_] if i + 1 == count => (0.2, 2.0),
            [_] => (0.2, 0.1),
            _ => {
                let inputs: usize = shape[1..].iter().product();
                (2.0 / (inputs as f64).sqrt(), 0.0)
            }
        };
        let name = format!("depth_head.{name}");
        (name, sines(200 + i, &shape, scale, offset))
    });
    drawn.collect()
}
