//! The prepared network against the plain one, with statistics far from the initial ones.

use super::Plan;
use crate::model::{BasisNet, ExtractorConfig, NetworkConfig, NormKind};
use burn::module::{Module as _, ModuleMapper, Param};
use burn::tensor::{Device, Tensor, TensorData};
use lsdc_kernels::simd::Level;
use lsdc_rng::Rng;
use proptest::prelude::*;

fn image(height: usize, width: usize) -> Vec<f32> {
    let mut rng = Rng::stream(0, &["image"]);
    (0..3 * height * width).map(|_| rng.normal()).collect()
}

fn tensor(values: Vec<f32>, (height, width): (usize, usize)) -> Tensor<4> {
    Tensor::from_data(
        TensorData::new(values, [1, height, width, 3]),
        &Device::flex(),
    )
}

/// A network whose running statistics have seen an image.
fn net(config: &NetworkConfig) -> BasisNet {
    let device = Device::flex().autodiff();
    let net = config.init(3, &device).unwrap();
    let image = TensorData::new(image(40, 56), [1, 40, 56, 3]);
    let pixels = vec![(0..40 * 56).collect()];
    for _ in 0..20 {
        let image = Tensor::from_data(image.clone(), &device);
        let _ = net.edges(image.clone());
        let _ = net.bases(image).at((40, 56), &pixels);
    }
    net.valid()
}

fn tiny() -> NetworkConfig {
    let mut extractor = ExtractorConfig::slim();
    extractor.stages.iter_mut().for_each(|s| s.blocks = 1);
    NetworkConfig {
        extractor,
        hidden: vec![40, 24],
        bases: 20,
        edges: 0,
        ..NetworkConfig::sharp()
    }
}

/// Largest difference as a share of the largest value.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    let largest = b.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    let pairs = a.iter().zip(b);
    pairs.fold(0.0_f32, |m, (x, y)| m.max((x - y).abs())) / largest
}

fn agree(net: &BasisNet, level: Level, size: (usize, usize), output: (usize, usize)) {
    let plan = Plan::new(net, level).unwrap();
    let planned = plan.bases(&image(size.0, size.1), size);
    let plain = net.bases(tensor(image(size.0, size.1), size));
    let pixels: Vec<u32> = (0..output.0 * output.1)
        .step_by(7)
        .map(|p| p as u32)
        .collect();
    let reference = plain.at(output, std::slice::from_ref(&pixels)).into_data();
    let reference: Vec<f32> = reference.iter::<f32>().collect();
    let rows = planned.at(output, &pixels);
    assert!(difference(&rows, &reference) < 1e-4, "{level:?} {size:?}");

    let functions = rows.len() / pixels.len();
    let mut rng = Rng::stream(1, &["weights"]);
    let weights: Vec<f64> = (0..functions).map(|_| f64::from(rng.normal())).collect();
    let narrow: Vec<f32> = weights.iter().map(|w| *w as f32).collect();
    let dense = planned.combine(output, &weights);
    let plain = plain.combine(output, &narrow);
    assert!(difference(&dense, &plain) < 1e-4, "{level:?} {size:?}");
}

#[test]
fn the_plan_agrees_with_the_network_at_every_size() {
    let net = net(&tiny());
    for level in Level::ALL.into_iter().filter(|l| l.is_available()) {
        for size in [(1, 1), (3, 5), (32, 32), (37, 61), (57, 130), (120, 160)] {
            agree(&net, level, size, size);
        }
        agree(&net, level, (48, 64), (100, 77));
    }
    for size in [(228, 304), (229, 303), (479, 641), (480, 640)] {
        agree(&net, Level::here(), size, size);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, ..Default::default() })]

    #[test]
    fn the_plan_agrees_at_any_size(
        height in 32..200_usize,
        width in 32..260_usize,
        level in prop::sample::select(Level::ALL.to_vec()),
    ) {
        prop_assume!(level.is_available());
        agree(&net(&tiny()), level, (height, width), (height, width));
    }
}

#[test]
fn the_plan_agrees_for_every_kind_of_head() {
    for (octaves, hidden) in [(0, vec![32]), (3, vec![24]), (5, vec![64, 40, 24])] {
        let config = NetworkConfig {
            octaves,
            hidden,
            ..tiny()
        };
        agree(&net(&config), Level::here(), (33, 47), (33, 47));
    }
}

#[test]
fn the_plan_sharpens_as_the_network_does() {
    let mut config = tiny();
    config.extractor.sharpening = 2;
    let net = net(&config).map(&mut Fill);
    for level in Level::ALL.into_iter().filter(|l| l.is_available()) {
        for size in [(1, 1), (3, 5), (37, 61), (57, 130)] {
            agree(&net, level, size, size);
        }
        agree(&net, level, (48, 64), (100, 77));
    }
    agree(&net, Level::here(), (228, 304), (228, 304));
}

#[test]
fn the_plan_judges_edges_as_the_network_does() {
    let net = judging();
    for level in Level::ALL.into_iter().filter(|l| l.is_available()) {
        for size in [(1, 1), (3, 5), (32, 32), (37, 61), (120, 77)] {
            edges_agree(&net, level, size);
        }
    }
    edges_agree(&net, Level::here(), (228, 304));
    edges_agree(&self::net(&tiny()), Level::here(), (57, 76));
}

/// A network that judges edges; it begins without effect, and is given one.
fn judging() -> BasisNet {
    let config = NetworkConfig { edges: 8, ..tiny() };
    net(&config).map(&mut Fill)
}

/// Puts numbers in the place of zeros.
struct Fill;

impl ModuleMapper for Fill {
    fn map_float<const D: usize>(&mut self, tensor: Param<Tensor<D>>) -> Param<Tensor<D>> {
        tensor.map(|tensor| {
            let data = tensor.to_data();
            let mut values: Vec<f32> = data.iter::<f32>().collect();
            if D > 1 && values.iter().all(|v| *v == 0.0) {
                let mut rng = Rng::stream(9, &["fill"]);
                for value in &mut values {
                    *value = 0.3 * rng.normal();
                }
            }
            Tensor::from_data(TensorData::new(values, data.shape()), &tensor.device())
        })
    }
}

fn edges_agree(net: &BasisNet, level: Level, size: (usize, usize)) {
    let plan = Plan::new(net, level).unwrap();
    let (planned, found) = plan.bases(&image(size.0, size.1), size).edges();
    assert_eq!(found, size);
    let plain = net.edges(tensor(image(size.0, size.1), size)).into_data();
    let plain: Vec<f32> = plain.iter::<f32>().collect();
    for (a, b) in planned.iter().zip(&plain) {
        assert!((a - b).abs() < 1e-3 * b, "{level:?} {size:?}: {a} {b}");
    }
}

#[test]
fn every_preset_agrees() {
    let (paper, medium) = (NetworkConfig::paper(), NetworkConfig::medium());
    for config in [
        paper,
        medium,
        NetworkConfig::sharp(),
        NetworkConfig::small(),
    ] {
        let net = net(&config).map(&mut Fill);
        agree(&net, Level::here(), (57, 76), (57, 76));
        edges_agree(&net, Level::here(), (57, 76));
    }
}

#[test]
fn group_normalisation_has_no_plan() {
    let config = NetworkConfig {
        norm: NormKind::Group,
        ..tiny()
    };
    let net = config.init(0, &Device::flex()).unwrap();
    assert!(Plan::new(&net, Level::here()).is_none());
}
