//! Tests of the complete network.

use super::{HiddenBases, InitNetwork as _, parameter_count};
use burn::module::{Module as _, ModuleMapper, Param};
use burn::tensor::{Device, Tensor, TensorData};
use lsdc_core::network::{ExtractorConfig, NetworkConfig, NormKind};
use lsdc_rng::Rng;

fn image(height: usize, width: usize) -> Tensor<4> {
    let mut rng = Rng::stream(0, &["image"]);
    let values: Vec<f32> = (0..3 * height * width).map(|_| rng.normal()).collect();
    Tensor::from_data(
        TensorData::new(values, [1, height, width, 3]),
        &Device::flex(),
    )
}

/// A configuration with few blocks, so that tests are fast.
fn tiny() -> NetworkConfig {
    let mut extractor = ExtractorConfig::slim();
    extractor.stages.iter_mut().for_each(|s| s.blocks = 1);
    NetworkConfig {
        extractor,
        hidden: vec![16],
        bases: 12,
        affinities: 0,
        ..NetworkConfig::sharp()
    }
}

#[test]
fn the_paper_preset_has_the_papers_parameters() {
    // Fang et al. report 3.466 M; counting PSMNet's layers gives 3,339,552.
    for norm in [NormKind::Batch, NormKind::Group] {
        let config = NetworkConfig {
            norm,
            ..NetworkConfig::paper()
        };
        let net = config.init(0, &Device::flex()).unwrap();
        assert_eq!(parameter_count(&net), 3_466_016);
        assert_eq!(parameter_count(&net.extractor), 3_339_552);
    }
}

#[test]
fn every_input_size_works() {
    for norm in [NormKind::Batch, NormKind::Group] {
        let net = NetworkConfig { norm, ..tiny() }
            .init(0, &Device::flex())
            .unwrap();
        for (height, width) in [(1, 1), (3, 5), (32, 32), (37, 61), (57, 130)] {
            let pixels = vec![(0..(height * width) as u32).collect()];
            let bases = net
                .bases(image(height, width), None)
                .at((height, width), &pixels);
            assert_eq!(bases.dims(), [1, height * width, 13]);
            let values: Vec<f32> = bases.into_data().iter::<f32>().collect();
            assert!(values.iter().all(|v| v.is_finite()));
            assert!(values.iter().step_by(13).all(|v| *v == 1.0));
        }
    }
}

#[test]
fn the_dense_map_is_bases_times_weights() {
    let net = tiny().init(0, &Device::flex()).unwrap();
    let bases = net.bases(image(20, 30), None);
    let weights: Vec<f32> = (0..13).map(|i| i as f32 - 5.0).collect();
    let size = (40, 60);
    let dense = bases.combine(size, &weights);
    let pixels = vec![0, 1234, 2399];
    let rows: Vec<f32> = bases
        .at(size, std::slice::from_ref(&pixels))
        .into_data()
        .iter::<f32>()
        .collect();
    for (row, &pixel) in rows.chunks_exact(13).zip(&pixels) {
        let expected: f32 = row.iter().zip(&weights).map(|(f, w)| f * w).sum();
        let found = dense[pixel as usize];
        assert!(
            (found - expected).abs() < 1e-4 * expected.abs().max(1.0),
            "{found} {expected}"
        );
    }
}

/// Moves every parameter, including those that are 0 before training.
struct Moved(Rng);

impl ModuleMapper for Moved {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        param.map(|values| {
            let shape = values.shape();
            let noise = (0..shape.num_elements()).map(|_| 0.1 * self.0.normal());
            let noise = TensorData::new(noise.collect::<Vec<f32>>(), shape);
            let noise = Tensor::from_data(noise, &values.device());
            (values + noise).detach().require_grad()
        })
    }
}

#[test]
fn sums_of_functions_need_none_of_them() {
    let device = Device::flex().autodiff();
    for mean in [false, true] {
        let config = NetworkConfig { mean, ..tiny() };
        let mut moved = Moved(Rng::stream(0, &["moved"]));
        let net = config.init(0, &device).unwrap().map(&mut moved);
        let pixels = vec![(0..600).collect::<Vec<u32>>(), (0..600).rev().collect()];
        let weights: Vec<f32> = (0..52).map(|i| ((i * i) as f32).sin()).collect();
        let found = |sum: fn(&HiddenBases, Tensor<3>) -> Tensor<3>| {
            let image = Tensor::from_inner(image(20, 30));
            let images = Tensor::cat(vec![image.clone(), image * 0.5], 0);
            let hidden = net.bases(images, None).hidden_at((20, 30), &pixels);
            let weights = TensorData::new(weights.clone(), [2, 13, 2]);
            let weights = Tensor::<3>::from_data(weights, &device).require_grad();
            let sums = sum(&hidden, weights.clone());
            let gradients = sums.clone().cos().sum().backward();
            let last = net.head.last.weights().grad(&gradients);
            let mean = net.head.mean.as_ref();
            let mean = mean.and_then(|mean| mean.weights().grad(&gradients));
            let all = last.into_iter().chain(mean).map(Tensor::into_data);
            let weights = weights.grad(&gradients).unwrap();
            let all = [sums.into_data(), weights.into_data()]
                .into_iter()
                .chain(all);
            all.collect::<Vec<_>>()
        };
        let sums = found(HiddenBases::combine);
        let functions = found(|hidden, weights| hidden.functions().matmul(weights));
        assert_eq!(sums.len(), if mean { 4 } else { 3 });
        for (sums, functions) in sums.into_iter().zip(functions) {
            let largest = functions.iter::<f32>().fold(0.0_f32, |m, v| m.max(v.abs()));
            assert!(largest > 0.1);
            for (a, b) in sums.iter::<f32>().zip(functions.iter::<f32>()) {
                assert!((a - b).abs() < 1e-5 * largest, "{a} {b}");
            }
        }
    }
}

#[test]
fn a_seed_names_the_weights() {
    let values = |seed| {
        let net = tiny().init(seed, &Device::flex()).unwrap();
        let bases = net.bases(image(16, 16), None).at((16, 16), &[vec![7]]);
        bases.into_data().iter::<f32>().collect::<Vec<_>>()
    };
    assert_eq!(values(1), values(1));
    assert_ne!(values(1), values(2));
}

#[test]
fn dependent_bases_are_refused() {
    let config = NetworkConfig {
        hidden: vec![64, 64],
        ..NetworkConfig::paper()
    };
    assert!(
        config
            .init(0, &Device::flex())
            .unwrap_err()
            .to_string()
            .contains("hidden")
    );
}
