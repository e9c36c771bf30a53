//! Any input yields a valid result or an error: never a panic, never a number that is not finite.

#![cfg(feature = "weights")]
#![allow(clippy::unwrap_used)]

use lsdc_core::settings::{FitConfig, FitMethod, Loss, PriorKind, Robust};
use lsdc_core::{
    Channels, Completer, Error, Image, Observation, Observations, Weights, WeightsError,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::sync::LazyLock;

static COMPLETER: LazyLock<Completer> =
    LazyLock::new(|| Completer::new(&Weights::builtin_small()).unwrap());

/// Ordinary numbers and edge cases.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -1.0..80.0_f64,
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, -0.5, 0.0, 1e300, -1e300]),
    ]
}

fn depth() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => 0.1..20.0_f32,
        1 => prop::sample::select(vec![
            f32::NAN, f32::INFINITY, 0.0, -1.0, f32::MIN_POSITIVE, 1e-30, 1e30, f32::MAX,
        ]),
    ]
}

fn observation() -> impl Strategy<Value = Observation> {
    let sigma = prop::option::weighted(0.2, depth());
    (coordinate(), coordinate(), depth(), sigma).prop_map(|(u, v, depth, sigma)| Observation {
        u,
        v,
        depth,
        sigma,
    })
}

fn observations() -> impl Strategy<Value = Observations> {
    let list = |most| prop::collection::vec(observation(), 0..most);
    prop_oneof![
        6 => list(60).prop_map(|list| list.into_iter().collect()),
        1 => list(600).prop_map(|list| list.into_iter().collect()),
        // All in one pixel.
        2 => list(20).prop_map(|list| {
            list.into_iter().map(|p| Observation { u: 3.0, v: 2.0, ..p }).collect()
        }),
    ]
}

fn settings() -> impl Strategy<Value = FitConfig> {
    let recorded = *COMPLETER.fit_config();
    let method = prop::sample::select(FitMethod::ALL.to_vec());
    let prior = prop::sample::select(PriorKind::ALL.to_vec());
    let robust = prop::option::weighted(0.4, prop::sample::select(Loss::ALL.to_vec()));
    (method, prior, robust).prop_map(move |(method, prior, loss)| FitConfig {
        method,
        prior,
        robust: loss.map(Robust::new),
        ..recorded
    })
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 100,
        failure_persistence: None,
        // The same cases in every run.
        rng_seed: RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    #[test]
    fn any_points_give_finite_answers_or_an_error(
        width in 1..70_usize,
        height in 1..50_usize,
        given in observations(),
        fit in settings(),
    ) {
        let colours: Vec<u8> = (0..3 * width * height).map(|i| (i * i % 251) as u8).collect();
        let image = Image::new(width, height, Channels::Rgb, &colours).unwrap();
        let Ok(scene) = COMPLETER.with_fit(fit).scene(&image) else {
            return Ok(());
        };
        let Ok(completion) = scene.complete(&given) else {
            return Ok(());
        };
        let report = completion.report().clone();
        prop_assert_eq!(report.given, given.len());
        prop_assert_eq!(report.given, report.used + report.invalid + report.outside);
        let (low, high) = completion.limits();
        for value in completion.depth().unwrap().values() {
            prop_assert!(value.is_finite() && (low..=high).contains(value), "{}", value);
        }
        if let Ok(deviations) = completion.standard_deviation() {
            let positive = deviations.values().iter().all(|v| *v > 0.0);
            prop_assert!(positive, "{:?} {:?}", report, completion.depth());
        }
        let lists = [completion.residuals(), completion.leave_one_out(), completion.point_weights()];
        for list in &lists {
            prop_assert_eq!(list.len(), given.len());
            prop_assert!(!list.iter().any(|v| v.is_infinite()));
        }
        let finite = lists.each_ref().map(|list| list.iter().filter(|v| v.is_finite()).count());
        // Observations that are interpolated exactly for any depths have no leave-one-out error.
        prop_assert_eq!([finite[0], finite[2]], [report.used; 2]);
        prop_assert!(finite[1] <= report.used);
        prop_assert_eq!(finite[1] == 0, completion.leave_one_out_error().is_none());
        for outlier in completion.outliers().unwrap() {
            prop_assert!(outlier.index < given.len() && !outlier.score.is_nan());
        }
    }

    #[test]
    fn any_buffer_is_an_image_or_an_error(
        width in prop_oneof![0..40_usize, Just(usize::MAX), Just(1 << 20)],
        height in prop_oneof![0..40_usize, Just(usize::MAX), Just(1 << 20)],
        stride in prop_oneof![0..200_usize, Just(usize::MAX)],
        length in 0..6000_usize,
        channels in prop::sample::select(vec![
            Channels::Rgb, Channels::Bgr, Channels::Rgba, Channels::Bgra, Channels::Gray,
        ]),
        floats in any::<bool>(),
        bad in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let bytes = vec![100_u8; length];
        let mut values = vec![0.4_f32; length];
        if let (Some(bad), false) = (bad, values.is_empty()) {
            let at = bad.index(length);
            values[at] = f32::NAN;
        }
        let image = if floats {
            Image::from_f32(width, height, channels, &values)
        } else {
            Image::new(width, height, channels, &bytes)
        };
        let Ok(image) = image.and_then(|image| image.with_stride(stride)) else {
            return Ok(());
        };
        if let Ok(scene) = COMPLETER.scene(&image) {
            let mut one = Observations::new();
            one.add(0.0, 0.0, 2.0);
            let depth = scene.complete(&one).unwrap().depth().unwrap();
            prop_assert_eq!((depth.width(), depth.height()), (width, height));
        }
    }

    #[test]
    fn damaged_weights_are_an_error(
        place in any::<prop::sample::Index>(),
        byte in any::<u8>(),
        cut in prop::option::weighted(0.3, any::<prop::sample::Index>()),
    ) {
        let mut bytes = lsdc_core::weights::SMALL.to_vec();
        // Half of the changes hit the header.
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
        let range = if byte.is_multiple_of(2) { header } else { bytes.len() };
        bytes[place.index(range)] = byte;
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(weights) = Weights::from_bytes(&bytes) {
            // Changed values are still numbers; any other damage is detected here.
            let _ = Completer::new(&weights);
        }
    }
}

/// Returns a weights file that declares this network and has no tensors.
fn declaring(network: &str) -> Vec<u8> {
    let notes = serde_json::json!({ "lsdc": "0.2.0", "normalisation": "{}", "network": network });
    let header = serde_json::json!({ "__metadata__": notes }).to_string();
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend_from_slice(header.as_bytes());
    bytes
}

/// Declared sizes are compared with the length of the file before memory is allocated.
#[test]
fn a_weights_file_that_declares_a_huge_network_is_refused() {
    let bytes = declaring(r#"{"bases":4000000000,"hidden":[4000000000]}"#);
    let error = Weights::from_bytes(&bytes).unwrap_err();
    assert!(error.to_string().contains("bases"), "{error}");
}

/// Without the adapters, the network would get other features than in training.
#[test]
fn weights_with_adapters_are_refused() {
    let error =
        Weights::from_bytes(&declaring(r#"{"adapters":{"blocks":3,"rank":8}}"#)).unwrap_err();
    assert!(
        matches!(error, Error::Weights(WeightsError::Removed { .. })),
        "{error:?}"
    );
    let message = error.to_string();
    assert!(
        message.contains("adapters") && message.contains("until 0.2.0"),
        "{message}"
    );
    Weights::from_bytes(&declaring("{}")).unwrap();
    assert!(Weights::from_bytes(&declaring(r#"{"adapters":null}"#)).is_err());
}

#[test]
fn the_largest_and_smallest_images_work() {
    let mut one = Observations::new();
    one.add(0.0, 0.0, 3.0);
    for (width, height) in [(1, 1), (1, 500), (500, 1), (3000, 2)] {
        let colours = vec![90_u8; 3 * width * height];
        let image = Image::new(width, height, Channels::Rgb, &colours).unwrap();
        let depth = COMPLETER
            .scene(&image)
            .unwrap()
            .complete(&one)
            .unwrap()
            .depth()
            .unwrap();
        assert_eq!(depth.values().len(), width * height);
        assert!(depth.values().iter().all(|v| (0.3..30.0).contains(v)));
    }
}
