use super::tests::depth_anything::{WIDTH, encoder_weights, head_weights, network, sines};
use super::tests::tiny;
use super::*;
use crate::{Channels, DepthAnything, Image};
use serde::Deserialize;
use std::sync::Arc;

/// Predictions of other programs (`scripts/golden_encoder.py`).
#[derive(Deserialize)]
struct Golden {
    /// Rows and columns of patches.
    size: [usize; 2],
    values: Vec<f32>,
}

fn features(rows: usize, columns: usize) -> Features {
    let tap = |i: usize| {
        let tap = sines(300 + i, &[rows * columns, WIDTH], 1.0, 0.0);
        tap.values().to_vec()
    };
    Features {
        columns,
        rows,
        taps: (0..4).map(tap).collect(),
    }
}

#[test]
fn depths_are_those_of_transformers() {
    let golden: Vec<Golden> = serde_json::from_str(include_str!("depth_head.json")).unwrap();
    for level in Level::available() {
        let head = DepthHead::new(&head_weights(), level).unwrap();
        for Golden { size, values } in &golden {
            let [rows, columns] = *size;
            let found = head.predict(&features(rows, columns)).unwrap();
            assert_eq!(found.len(), rows * columns * PATCH * PATCH);
            assert_eq!(found.len(), values.len());
            for (found, exact) in found.iter().zip(values) {
                assert!((found - exact).abs() < 5e-5, "{level:?}: {found} {exact}");
            }
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_depth() {
    let head = DepthHead::new(&head_weights(), Level::here()).unwrap();
    let found = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let predict = || head.predict(&features(11, 13)).unwrap();
        pool.build().unwrap().install(predict)
    };
    let one = found(1);
    assert_eq!(one, found(3));
    // No values of the previous image remain.
    head.release();
    assert_eq!(one, found(3));
}

#[test]
fn the_unused_unit_may_be_missing_and_nothing_else() {
    let whole = head_weights();
    let is_unused = |name: &str| name.contains("refinenet4.resConfUnit1");
    let mut needed = whole.clone();
    needed.retain(|name, _| !is_unused(name));
    assert_eq!(whole.len(), needed.len() + 4);
    let predicted = |tensors: &BTreeMap<String, Tensor>| {
        let head = DepthHead::new(tensors, Level::here()).unwrap();
        head.predict(&features(3, 5)).unwrap()
    };
    assert_eq!(predicted(&whole), predicted(&needed));

    let refused = |tensors: &BTreeMap<String, Tensor>| {
        let Err(Error::Weights(error)) = DepthHead::new(tensors, Level::here()) else {
            panic!("a head is prepared from tensors that make none");
        };
        error.to_string()
    };
    for name in needed.keys() {
        let mut tensors = needed.clone();
        tensors.remove(name);
        let message = refused(&tensors);
        assert!(
            message.contains(name) && message.contains("is missing"),
            "{message}"
        );
        for shape in [vec![1; 5], vec![0, 3, 3, 3], vec![2, 3, 5, 7]] {
            tensors.insert(name.clone(), sines(0, &shape, 1.0, 0.0));
            refused(&tensors);
        }
    }
    let mut more = needed.clone();
    more.insert(format!("{DEPTH_HEAD}more"), sines(0, &[1], 1.0, 0.0));
    assert!(refused(&more).contains("is superfluous"));
}

#[test]
fn features_of_another_encoder_are_refused() {
    let head = DepthHead::new(&head_weights(), Level::here()).unwrap();
    assert_eq!(head.width(), WIDTH);
    let refused = |change: &dyn Fn(&mut Features)| {
        let mut features = features(2, 3);
        change(&mut features);
        head.predict(&features).is_err()
    };
    assert!(!refused(&|_| ()));
    assert!(refused(&|features| features.taps.truncate(3)));
    assert!(refused(&|features| features.taps[1].push(0.0)));
    assert!(refused(&|features| features.rows = 3));
    assert!(refused(&|features| {
        features.rows = 0;
        features.taps.iter_mut().for_each(Vec::clear);
    }));
}

#[test]
fn images_of_any_size_become_guides() {
    let network = network();
    let (width, height) = (64, 48);
    let bytes: Vec<u8> = (0..3 * width * height)
        .map(|i| (i * i / 50 % 251) as u8)
        .collect();
    let image = Image::new(width, height, Channels::Rgb, &bytes).unwrap();
    let (values, size) = network.inverse_depth(&image, 252).unwrap();
    assert_eq!((size, values.len()), ((252, 336), 252 * 336));
    let guide = network.predict(&image, 252).unwrap();
    assert_eq!((guide.height(), guide.width()), size);
    assert_eq!(guide.missing(), 0);
    let direct = crate::DepthGuide::with_sky(size.1, size.0, &values).unwrap();
    let places = [[0.0, 0.0], [31.5, 20.0]];
    assert_eq!(guide.at((48, 64), &places), direct.at((48, 64), &places));

    for short_side in [0, 251, 519] {
        let error = network.predict(&image, short_side).unwrap_err();
        assert!(error.to_string().contains("252 to 518"), "{error}");
    }
}

#[test]
fn an_encoder_of_two_taps_is_refused() {
    let head = || DepthHead::new(&head_weights(), Level::here()).unwrap();
    let encoder = Encoder::new(tiny(), &encoder_weights(3), Level::here()).unwrap();
    assert!(DepthAnything::with_parts(Arc::new(encoder), head()).is_err());
}
