//! A substitute for a pretrained encoder, for tests.

use lsdc_core::network::{Encoder, EncoderConfig};
use lsdc_core::weights::Tensor as Table;
use lsdc_kernels::simd::Level;
use lsdc_rng::Rng;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Returns an encoder with random weights and the number of channels that networks are trained on.
pub(crate) fn random_encoder() -> Arc<Encoder> {
    Arc::new(Encoder::new(short(), &random_tensors(), Level::here()).unwrap())
}

/// Returns the sizes of the encoder.
pub(crate) fn short() -> EncoderConfig {
    EncoderConfig {
        blocks: 4,
        hidden: 32,
        side: 5,
        taps: vec![0, 1, 2, 3],
        ..EncoderConfig::small()
    }
}

/// Returns random tensors of the encoder.
pub(crate) fn random_tensors() -> BTreeMap<String, Table> {
    let config = short();
    let (width, hidden) = (config.width, config.hidden);
    let mut tensors = BTreeMap::new();
    let mut add = |name: &str, shape: &[usize], mean: f32| {
        let mut rng = Rng::stream(4, &["encoder", name]);
        let count = shape.iter().product();
        let values = (0..count).map(|_| mean + 0.05 * rng.normal()).collect();
        tensors.insert(name.to_owned(), Table::new(shape.to_vec(), values).unwrap());
    };
    add("patch_embed.proj.weight", &[width, 3, 14, 14], 0.0);
    add("patch_embed.proj.bias", &[width], 0.0);
    add("cls_token", &[1, 1, width], 0.0);
    add("pos_embed", &[1, 26, width], 0.0);
    for block in 0..config.blocks {
        let mut add = |name: &str, shape: &[usize], mean: f32| {
            add(&format!("blocks.{block}.{name}"), shape, mean);
        };
        for norm in ["norm1", "norm2"] {
            add(&format!("{norm}.weight"), &[width], 1.0);
            add(&format!("{norm}.bias"), &[width], 0.0);
        }
        for (layer, to, from) in [
            ("attn.qkv", 3 * width, width),
            ("attn.proj", width, width),
            ("mlp.fc1", hidden, width),
            ("mlp.fc2", width, hidden),
        ] {
            add(&format!("{layer}.weight"), &[to, from], 0.0);
            add(&format!("{layer}.bias"), &[to], 0.0);
        }
        add("ls1.gamma", &[width], 1.0);
        add("ls2.gamma", &[width], 1.0);
    }
    add("norm.weight", &[width], 1.0);
    add("norm.bias", &[width], 0.0);
    tensors
}
