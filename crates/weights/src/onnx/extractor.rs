//! From a normalised image to features, and to the logarithm of the depth map if a backbone predicts it.

use super::graph::{int, ints};
use super::layers::{Conv, Layers};
use crate::error::Result;
use lsdc_core::network::{BackboneConfig, ExtractorConfig};

/// Outputs of an extractor, at a quarter of the image's resolution, or at half of it if features are sharpened.
pub(super) struct Features {
    pub(super) features: String,
    pub(super) logarithm: Option<String>,
}

pub(super) fn extractor(
    layers: &mut Layers<'_>,
    image: &str,
    config: &ExtractorConfig,
    mean: bool,
) -> Result<Features> {
    let mut x = image.to_owned();
    for i in 0..3 {
        let conv = if i == 0 { Conv::HALVING } else { Conv::SAME };
        x = layers.conv_norm(&x, &format!("extractor.stem.{i}"), conv)?;
    }
    let dilated = Conv {
        dilation: 2,
        ..Conv::SAME
    };
    let [first, second, third, fourth] = config.stages.map(|stage| stage.blocks);
    let half = stage(layers, x, "half", first, Conv::SAME, Conv::SAME)?;
    let raw = stage(
        layers,
        half.clone(),
        "quarter",
        second,
        Conv::HALVING,
        Conv::SAME,
    )?;
    let wide = stage(layers, raw.clone(), "wide", third, Conv::SAME, Conv::SAME)?;
    let skip = stage(layers, wide, "dilated", fourth, dilated, dilated)?;
    let mut features = merged(layers, &raw, &skip, &config.pools)?;
    let mut x = skip;
    for (i, context) in config.context.iter().enumerate() {
        let blocks = format!("context.{i}.blocks");
        x = stage(
            layers,
            x,
            &blocks,
            context.blocks,
            Conv::HALVING,
            Conv::SAME,
        )?;
        let own = layers.plain(&x, &format!("extractor.context.{i}.project"))?;
        features = layers.add_enlarged(&features, &own);
    }
    let mut logarithm = None;
    if let Some(backbone) = config.backbone {
        let maps = backbone_maps(layers, image, backbone)?;
        let decoded = pyramid(layers, &maps)?;
        let own = layers.plain(&decoded, "extractor.decoder.features")?;
        features = layers.add_enlarged(&features, &own);
        if mean {
            logarithm = Some(layers.plain(&decoded, "extractor.decoder.map")?);
        }
    }
    if config.sharpening > 0 {
        features = sharpened(layers, &features, &half, config.sharpening)?;
    }
    if let Some(map) = &mut logarithm {
        let size = layers.graph.size(&features);
        *map = layers.graph.resize(map, &size);
    }
    Ok(Features {
        features,
        logarithm,
    })
}

/// Applies a stage of residual blocks, of which the first changes width and resolution.
fn stage(
    layers: &mut Layers<'_>,
    mut x: String,
    name: &str,
    blocks: usize,
    first: Conv,
    others: Conv,
) -> Result<String> {
    for i in 0..blocks {
        let name = |part: &str| format!("extractor.{name}.{i}.{part}");
        let conv = if i == 0 { first } else { others };
        let inner = layers.conv_norm(&x, &name("first"), conv)?;
        let inner = layers.conv_norm(&inner, &name("second"), others.linear())?;
        if layers.has(&name("shortcut.conv.weight")) {
            let across = Conv {
                dilation: 1,
                ..conv.linear()
            };
            x = layers.conv_norm(&x, &name("shortcut"), across)?;
        }
        x = layers.graph.apply("Add", &[&inner, &x]);
    }
    Ok(x)
}

/// Applies the pooling pyramid, merged with the maps that it is computed from.
fn merged(layers: &mut Layers<'_>, raw: &str, skip: &str, pools: &[usize]) -> Result<String> {
    let size = layers.graph.size(skip);
    let mut parts = vec![raw.to_owned(), skip.to_owned()];
    for (i, &pool) in pools.iter().enumerate() {
        let window = [pool as i64; 2];
        // Windows are cropped at the end: means are over the pixels in them.
        let attributes = [
            ints("kernel_shape", &window),
            ints("strides", &window),
            int("ceil_mode", 1),
            int("count_include_pad", 0),
        ];
        let pooled = layers.graph.node("AveragePool", &[skip], attributes);
        let name = format!("extractor.branches.{i}");
        let branch = layers.conv_norm(&pooled, &name, Conv::SAME)?;
        parts.push(layers.graph.resize(&branch, &size));
    }
    let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
    let all = layers.graph.concat(&parts, 1);
    let merged = layers.conv_norm(&all, "extractor.merge", Conv::SAME)?;
    layers.plain(&merged, "extractor.project")
}

/// Computes the outputs of the stages of a backbone that are used, the finest first.
fn backbone_maps(
    layers: &mut Layers<'_>,
    image: &str,
    config: BackboneConfig,
) -> Result<Vec<String>> {
    let mut x = layers.conv_norm(image, "extractor.backbone.stem", Conv::HALVING)?;
    let mut maps = Vec::new();
    for (i, block) in config.blocks().into_iter().enumerate() {
        let name = |part: &str| format!("extractor.backbone.blocks.{i}.{part}");
        let mut y = x.clone();
        if block.expands() {
            y = layers.conv_norm(&y, &name("expand"), Conv::SAME)?;
        }
        let depthwise = Conv {
            stride: block.stride as i64,
            groups: block.inner as i64,
            ..Conv::SAME
        };
        y = layers.conv_norm(&y, &name("depthwise"), depthwise)?;
        y = layers.conv_norm(&y, &name("project"), Conv::SAME.linear())?;
        if block.adds() {
            y = layers.graph.apply("Add", &[&y, &x]);
        }
        if block.read {
            maps.push(y.clone());
        }
        x = y;
    }
    Ok(maps)
}

/// Computes the finest level of the feature pyramid.
fn pyramid(layers: &mut Layers<'_>, maps: &[String]) -> Result<String> {
    let mut coarser: Option<String> = None;
    for (i, map) in maps.iter().enumerate().rev() {
        let mut x = layers.plain(map, &format!("extractor.decoder.lateral.{i}"))?;
        if let Some(coarser) = &coarser {
            x = layers.add_enlarged(&x, coarser);
        }
        coarser = Some(layers.conv_norm(&x, &format!("extractor.decoder.mix.{i}"), Conv::SAME)?);
    }
    Ok(coarser.unwrap_or_default())
}

/// Computes features at half the image's resolution, guided by a map of that resolution.
fn sharpened(layers: &mut Layers<'_>, features: &str, half: &str, count: usize) -> Result<String> {
    let size = layers.graph.size(half);
    let enlarged = layers.graph.resize(features, &size);
    let lateral = layers.plain(half, "extractor.sharpen.lateral")?;
    let mut x = layers.graph.apply("Add", &[&lateral, &enlarged]);
    for i in 0..count {
        x = layers.conv_norm(&x, &format!("extractor.sharpen.mix.{i}"), Conv::SAME)?;
    }
    let last = layers.plain(&x, "extractor.sharpen.last")?;
    Ok(layers.graph.apply("Add", &[&last, &enlarged]))
}
