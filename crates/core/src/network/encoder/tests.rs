#[path = "../../../../../tests/depth_anything/mod.rs"]
pub(super) mod depth_anything;

use super::*;
use crate::DepthAnything;
use depth_anything::{encoder_weights, sines, sizes};
use serde::Deserialize;

/// Features computed by other programs (`scripts/golden_encoder.py`).
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

/// The weights used by the script.
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
    // More tokens than one task handles.
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

#[test]
fn images_of_any_aspect_have_as_many_patches_as_one_of_4_to_3_with_the_side() {
    let patches = |side: usize, size: (usize, usize)| EncoderSide::new(side).unwrap().patches(size);
    assert_eq!(EncoderSide::default(), EncoderSide::new(336).unwrap());
    for (side, size, expected) in [
        (252, (480, 640), (18, 24)),
        (336, (480, 640), (24, 32)),
        (518, (480, 640), (37, 49)),
        (518, (640, 480), (49, 37)),
        // sqrt(768 / 3.312) and sqrt(768 * 3.312).
        (336, (375, 1242), (15, 50)),
        (518, (1, 100_000), (1, 1825)),
    ] {
        assert_eq!(patches(side, size), expected, "{side} {size:?}");
    }
    for side in [0, 251, 519, usize::MAX] {
        assert!(EncoderSide::new(side).is_err());
    }
}

#[test]
fn a_map_of_features_is_separated_into_its_taps() {
    let encoder = Encoder::new(tiny(), &weights(), Level::here()).unwrap();
    // An image at the size of the encoder's input, so that it is not resized.
    let (rows, columns) = EncoderSide::default().patches((336, 448));
    let size = (rows * PATCH, columns * PATCH);
    let image = image(size.0, size.1);
    let map = encoder
        .encode(&image, size, EncoderSide::default())
        .unwrap();
    let found = Features::separated(&map.values, (map.rows, map.columns), 2);
    let expected = encoder.features(&image, size).unwrap();
    assert_eq!((found.rows, found.columns), (rows, columns));
    assert_eq!(found.taps, expected.taps);
}
