#[path = "../../../../../tests/depth_anything/mod.rs"]
pub(super) mod depth_anything;

use super::*;
use crate::DepthAnything;
use crate::network::AdapterConfig;
use depth_anything::{encoder_weights, sines, sizes};
use serde::Deserialize;

/// What other programs answer (`scripts/golden_encoder.py`).
#[derive(Deserialize)]
struct Golden {
    /// After each tap, `[patches, width]`.
    taps: Vec<Vec<f32>>,
    positions: Vec<Positions>,
}

#[derive(Deserialize)]
struct Positions {
    size: [usize; 2],
    values: Vec<f32>,
}

fn golden() -> Golden {
    serde_json::from_str(include_str!("golden.json")).unwrap()
}

pub(super) fn tiny() -> EncoderConfig {
    sizes(3, &[0, 2])
}

/// The weights of the script.
fn weights() -> BTreeMap<String, Tensor> {
    encoder_weights(3)
}

fn image(height: usize, width: usize) -> Vec<f32> {
    sines(100, &[height, width, 3], 1.5, 0.0).values().to_vec()
}

#[test]
fn features_are_those_of_transformers() {
    let golden = golden();
    for level in Level::available() {
        let encoder = Encoder::new(tiny(), &weights(), level).unwrap();
        let found = encoder.features(&image(56, 56), (56, 56)).unwrap();
        assert_eq!((found.rows, found.columns), (4, 4));
        assert_eq!(found.taps.len(), golden.taps.len());
        for (found, exact) in found.taps.iter().zip(&golden.taps) {
            assert_eq!(found.len(), exact.len());
            for (found, exact) in found.iter().zip(exact) {
                assert!((found - exact).abs() < 2e-5, "{found} {exact}");
            }
        }
    }
}

#[test]
fn positions_are_interpolated_as_by_pytorch() {
    let table = sines(1, &[17, 16], 0.5, 0.0);
    for Positions { size, values } in golden().positions {
        let found = positions(table.values(), 4, 16, size.into());
        assert_eq!(found[..16], table.values()[..16]);
        assert_eq!(found.len(), 16 + values.len());
        for (found, exact) in found[16..].iter().zip(&values) {
            assert!((found - exact).abs() < 1e-5, "{size:?}: {found} {exact}");
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    // More tokens than a task takes.
    let (height, width) = (140, 182);
    let encoder = Encoder::new(tiny(), &weights(), Level::here()).unwrap();
    let found = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let image = image(height, width);
        let features = || encoder.features(&image, (height, width)).unwrap().taps;
        pool.build().unwrap().install(features)
    };
    assert_eq!(found(1), found(3));
}

#[test]
fn what_is_no_image_or_no_encoder_is_refused() {
    let encoder = Encoder::new(tiny(), &weights(), Level::here()).unwrap();
    for (length, size) in [
        (3 * 15 * 14, (15, 14)),
        (3 * 14 * 14 - 1, (14, 14)),
        (0, (0, 14)),
    ] {
        assert!(encoder.features(&vec![0.0; length], size).is_err());
    }
    let refused = |change: &dyn Fn(&mut EncoderConfig, &mut BTreeMap<String, Tensor>)| {
        let (mut config, mut tensors) = (tiny(), weights());
        change(&mut config, &mut tensors);
        Encoder::new(config, &tensors, Level::here()).is_err()
    };
    assert!(refused(&|config, _| config.heads = 3));
    assert!(refused(&|config, _| config.taps = vec![3]));
    assert!(refused(&|config, _| config.side = 5));
    assert!(refused(&|_, tensors| drop(
        tensors.remove("blocks.1.ls1.gamma")
    )));
    assert!(refused(&|_, tensors| drop(
        tensors.insert("more".into(), sines(0, &[1], 1.0, 0.0))
    )));
}

const LAST_TWO: AdapterConfig = AdapterConfig { blocks: 2, rank: 3 };

/// Adapters of the last two blocks; `scale` is that of the second matrices.
fn adapters(scale: f64) -> BTreeMap<String, Tensor> {
    let mut all = BTreeMap::new();
    for block in 0..LAST_TWO.blocks {
        for part in ["queries", "values"] {
            let name = |matrix: &str| format!("adapters.blocks.{block}.{part}.{matrix}.weight");
            let (down, up) = (200 + all.len(), 300 + all.len());
            all.insert(name("down"), sines(down, &[16, 3], 0.3, 0.0));
            all.insert(name("up"), sines(up, &[3, 16], scale, 0.0));
        }
    }
    all
}

#[test]
fn adapters_of_zero_change_no_bit() {
    let plain = Encoder::new(tiny(), &weights(), Level::here()).unwrap();
    let adapted = plain.with_adapters(LAST_TWO, &adapters(0.0)).unwrap();
    let taps = |encoder: &Encoder| encoder.features(&image(56, 70), (56, 70)).unwrap().taps;
    let changed = plain.with_adapters(LAST_TWO, &adapters(0.4)).unwrap();
    assert_eq!(taps(&adapted), taps(&plain));
    // The first tap is before them.
    assert_eq!(taps(&changed)[0], taps(&plain)[0]);
    assert_ne!(taps(&changed)[1], taps(&plain)[1]);
}

#[test]
fn adapters_are_added_to_the_weights_of_queries_and_values() {
    let (width, adapters) = (16, adapters(0.4));
    let mut all = weights();
    for block in 0..LAST_TWO.blocks {
        let name = format!("blocks.{}.attn.qkv.weight", 1 + block);
        let mut values = all[&name].values().to_vec();
        for (first, part) in [(0, "queries"), (2 * width, "values")] {
            let matrix = |matrix: &str| {
                adapters[&format!("adapters.blocks.{block}.{part}.{matrix}.weight")].values()
            };
            let (down, up) = (matrix("down"), matrix("up"));
            for (output, input) in (0..width).flat_map(|o| (0..width).map(move |i| (o, i))) {
                // Stored with the outputs first.
                let terms = (0..3).map(|k| down[input * 3 + k] * up[k * width + output]);
                values[(first + output) * width + input] += terms.sum::<f32>() / 3.0;
            }
        }
        all.insert(name, Tensor::new(vec![3 * width, width], values).unwrap());
    }
    for level in Level::available() {
        let changed = Encoder::new(tiny(), &all, level).unwrap();
        let plain = Encoder::new(tiny(), &weights(), level).unwrap();
        let adapted = plain.with_adapters(LAST_TWO, &adapters).unwrap();
        let taps = |encoder: &Encoder| encoder.features(&image(42, 56), (42, 56)).unwrap().taps;
        for (found, exact) in taps(&adapted).iter().zip(taps(&changed)) {
            for (found, exact) in found.iter().zip(exact) {
                assert!((found - exact).abs() < 2e-5, "{found} {exact}");
            }
        }
    }
}

#[test]
fn adapters_that_do_not_belong_are_refused() {
    let plain = Encoder::new(tiny(), &weights(), Level::here()).unwrap();
    let name = "adapters.blocks.1.values.up.weight";
    let refused = |config: AdapterConfig, tensors: &BTreeMap<String, Tensor>| {
        let Err(Error::Weights(error)) = plain.with_adapters(config, tensors) else {
            panic!("{config:?} is not refused");
        };
        error.to_string()
    };
    let mut tensors = adapters(0.4);
    let more = AdapterConfig {
        blocks: 4,
        ..LAST_TWO
    };
    assert!(refused(more, &tensors).contains("more blocks"));
    let higher = AdapterConfig {
        rank: 4,
        ..LAST_TWO
    };
    assert!(refused(higher, &tensors).contains("has shape [16, 3], expected [16, 4]"));
    tensors.insert(name.into(), sines(0, &[3, 15], 0.4, 0.0));
    assert!(refused(LAST_TWO, &tensors).contains(name));
    tensors.remove(name);
    let message = refused(LAST_TWO, &tensors);
    assert!(
        message.contains(name) && message.contains("is missing"),
        "{message}"
    );
}

#[test]
fn tokens_enter_a_block_as_the_one_before_leaves_them() {
    let size = (42, 56);
    let encoder = Encoder::new(tiny(), &weights(), Level::here()).unwrap();
    let tokens = encoder.tokens_before(&image(42, 56), size, 1).unwrap();
    assert_eq!(tokens.len(), (1 + 3 * 4) * 16);
    // The first tap is what the first block leaves, normalised, without the token of the whole image.
    let tap = &encoder.features(&image(42, 56), size).unwrap().taps[0];
    let all = weights();
    let (gain, shift) = (&all["norm.weight"], &all["norm.bias"]);
    for (token, tap) in tokens[16..].chunks(16).zip(tap.chunks(16)) {
        let mean = token.iter().sum::<f32>() / 16.0;
        let variance = token.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / 16.0;
        for (i, (value, found)) in token.iter().zip(tap).enumerate() {
            let unit = (value - mean) / (variance + LAYER_EPSILON).sqrt();
            let exact = unit * gain.values()[i] + shift.values()[i];
            assert!((found - exact).abs() < 2e-5, "{found} {exact}");
        }
    }
    assert!(encoder.tokens_before(&image(42, 56), size, 3).is_err());
    assert!(encoder.tokens_before(&image(42, 56), (42, 55), 1).is_err());
}

#[test]
fn a_map_of_features_is_separated_into_its_taps() {
    let encoder = Encoder::new(tiny(), &weights(), Level::here()).unwrap();
    // Of as many pixels as the encoder reads, so that nothing is resized.
    let (rows, columns) = FeatureMap::size((336, 448));
    let size = (rows * PATCH, columns * PATCH);
    let image = image(size.0, size.1);
    let map = encoder.encode(&image, size).unwrap();
    let found = Features::separated(&map.values, (map.rows, map.columns), 2);
    let expected = encoder.features(&image, size).unwrap();
    assert_eq!((found.rows, found.columns), (rows, columns));
    assert_eq!(found.taps, expected.taps);
}
