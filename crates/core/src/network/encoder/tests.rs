use super::*;
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

fn tiny() -> EncoderConfig {
    EncoderConfig {
        width: 16,
        heads: 2,
        blocks: 3,
        hidden: 32,
        side: 4,
        taps: vec![0, 2],
    }
}

fn sines(index: usize, shape: &[usize], scale: f64, offset: f64) -> Tensor {
    let count = shape.iter().product();
    let value = |i: usize| (offset + scale * (0.37 * i as f64 + index as f64).sin()) as f32;
    Tensor::new(shape.to_vec(), (0..count).map(value).collect()).unwrap()
}

/// The weights of the script.
fn weights() -> BTreeMap<String, Tensor> {
    let (width, hidden, side) = (16, 32, 4);
    let mut all = BTreeMap::new();
    let mut add = |name: String, shape: &[usize], scale: f64, offset: f64| {
        let tensor = sines(all.len(), shape, scale, offset);
        all.insert(name, tensor);
    };
    add("cls_token".into(), &[1, 1, width], 0.5, 0.0);
    add("pos_embed".into(), &[1, 1 + side * side, width], 0.5, 0.0);
    add(
        "patch_embed.proj.weight".into(),
        &[width, 3, PATCH, PATCH],
        0.05,
        0.0,
    );
    add("patch_embed.proj.bias".into(), &[width], 0.1, 0.0);
    for block in 0..3 {
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

fn image(height: usize, width: usize) -> Vec<f32> {
    sines(100, &[height, width, 3], 1.5, 0.0).values().to_vec()
}

#[test]
fn features_are_those_of_transformers() {
    let golden = golden();
    for level in Level::ALL.into_iter().filter(|level| level.is_available()) {
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
