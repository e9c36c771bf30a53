//! The prepared network against the plain one, with statistics that differ from the initial ones.

use super::random_encoder::{random_encoder, random_tensors, short};
use super::{
    AnyEncoder, BasisNet, InitNetwork as _, OnDevice, VisionTransformer, encoded_tensor, weights_of,
};
use burn::module::{Module as _, ModuleMapper, Param};
use burn::tensor::{Device, Tensor, TensorData};
use lsdc_core::network::{CpuNetwork, Encoder, EncoderSide, Forward, Network as _};
use lsdc_core::network::{ExtractorConfig, NetworkConfig, NormKind, StageConfig};
use lsdc_core::weights::Normalisation;
use lsdc_kernels::simd::Level;
use lsdc_rng::Rng;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::sync::Arc;

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

/// Returns a network whose running statistics were updated by an image.
fn net(config: &NetworkConfig) -> BasisNet {
    let device = Device::flex().autodiff();
    let net = config.init(3, &device).unwrap();
    let image = TensorData::new(image(40, 56), [1, 40, 56, 3]);
    let pixels = vec![(0..40 * 56).collect()];
    let encoded = (config.extractor.encoder > 0).then(|| {
        let encoded = random_encoder()
            .encode(&self::image(40, 56), (40, 56), EncoderSide::default())
            .unwrap();
        encoded_tensor(&[&encoded], &device)
    });
    for _ in 0..20 {
        let image = Tensor::from_data(image.clone(), &device);
        let _ = net.affinities(image.clone(), encoded.clone());
        let _ = net.bases(image, encoded.clone()).at((40, 56), &pixels);
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
        affinities: 0,
        ..NetworkConfig::sharp()
    }
}

/// Returns the largest difference relative to the largest value.
fn difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    let largest = b.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    let pairs = a.iter().zip(b);
    pairs.fold(0.0_f32, |m, (x, y)| m.max((x - y).abs())) / largest
}

/// A network with its sizes.
struct Trained {
    net: BasisNet,
    encoder: Option<Arc<Encoder>>,
    config: NetworkConfig,
}

impl Trained {
    fn new(config: NetworkConfig) -> Self {
        Self {
            net: net(&config),
            encoder: None,
            config,
        }
    }

    /// Replaces zeros by random values, so that zero-initialised parts have an effect.
    fn filled(config: NetworkConfig) -> Self {
        Self {
            net: net(&config).map(&mut Fill),
            encoder: (config.extractor.encoder > 0).then(random_encoder),
            config,
        }
    }

    fn prepared(&self, level: Level, size: (usize, usize)) -> Box<dyn Forward> {
        let weights = weights_of(&self.net, self.config.clone(), Normalisation::default());
        let network =
            CpuNetwork::new(&self.config, &weights.tensors, self.encoder.clone(), level).unwrap();
        network.forward(&image(size.0, size.1), size).unwrap()
    }

    fn plain(&self, size: (usize, usize)) -> Box<dyn Forward> {
        let network = OnDevice::new(
            self.net.clone(),
            self.encoder.clone().map(AnyEncoder::Prepared),
            &Device::flex(),
        );
        network.forward(&image(size.0, size.1), size).unwrap()
    }

    fn agrees(&self, level: Level, size: (usize, usize), output: (usize, usize)) {
        let prepared = self.prepared(level, size).basis();
        let plain = self.plain(size).basis();
        let pixels = (0..output.0 * output.1).step_by(7);
        let place = |pixel: usize| [(pixel % output.1) as f64, (pixel / output.1) as f64];
        let centres: Vec<_> = pixels.map(place).collect();
        // Positions between pixels, up to the border of the image.
        let mut rng = Rng::stream(2, &["places"]);
        let mut within = |length: usize| f64::from(rng.unit()) * length as f64 - 0.5;
        let mut between: Vec<_> = (0..60)
            .map(|_| [within(output.1), within(output.0)])
            .collect();
        between.push([-0.5, output.0 as f64 - 0.5]);
        let mut functions = 0;
        for places in [centres, between] {
            let rows = prepared.at(output, &places);
            let reference = plain.at(output, &places);
            assert!(difference(&rows, &reference) < 1e-4, "{level:?} {size:?}");
            functions = rows.len() / places.len();
        }
        let mut rng = Rng::stream(1, &["weights"]);
        let weights: Vec<f64> = (0..functions).map(|_| f64::from(rng.normal())).collect();
        let dense = prepared.combine(output, &weights);
        let reference = plain.combine(output, &weights);
        assert!(difference(&dense, &reference) < 1e-4, "{level:?} {size:?}");
    }

    fn affinities_agree(&self, level: Level, size: (usize, usize)) {
        let (found, of) = self.prepared(level, size).affinities();
        let (reference, also) = self.plain(size).affinities();
        assert_eq!((of, also), (size, size));
        for (a, b) in found.iter().zip(&reference) {
            assert!((a - b).abs() < 1e-3 * b, "{level:?} {size:?}: {a} {b}");
        }
    }
}

/// Pixels and positions are read alike, also in training.
#[test]
fn pixels_are_places_on_their_centres() {
    let bases = net(&tiny()).bases(tensor(image(20, 30), (20, 30)), None);
    let pixels: Vec<u32> = (0..1200).step_by(11).collect();
    let place = |pixel: &u32| [f64::from(pixel % 40), f64::from(pixel / 40)];
    let places: Vec<_> = pixels.iter().map(place).collect();
    let by_pixel = bases.at((30, 40), &[pixels]).into_data();
    let by_place = bases.at_places((30, 40), &places).into_data();
    assert!(by_pixel.iter::<f32>().eq(by_place.iter::<f32>()));
}

/// Replaces zeros by random values.
struct Fill;

impl ModuleMapper for Fill {
    fn map_float<const D: usize>(&mut self, tensor: Param<Tensor<D>>) -> Param<Tensor<D>> {
        tensor.map(|tensor| {
            let data = tensor.to_data();
            let mut values: Vec<f32> = data.iter::<f32>().collect();
            if D > 1 && values.iter().all(|v| *v == 0.0) {
                let mut rng = Rng::stream(9, &["fill"]);
                // More values are scaled down, because more of them are summed.
                let scale = 0.3 * (4096.0 / values.len() as f32).min(1.0).sqrt();
                for value in &mut values {
                    *value = scale * rng.normal();
                }
            }
            Tensor::from_data(TensorData::new(values, data.shape()), &tensor.device())
        })
    }
}

#[test]
fn the_prepared_network_agrees_at_every_size() {
    let trained = Trained::new(tiny());
    for level in Level::available() {
        for size in [(1, 1), (3, 5), (32, 32), (37, 61), (57, 130), (120, 160)] {
            trained.agrees(level, size, size);
        }
        trained.agrees(level, (48, 64), (100, 77));
    }
    for size in [(228, 304), (229, 303), (479, 641), (480, 640)] {
        trained.agrees(Level::here(), size, size);
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 12,
        failure_persistence: None,
        // The same cases in every run.
        rng_seed: RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    #[test]
    fn the_prepared_network_agrees_at_any_size(
        height in 32..200_usize,
        width in 32..260_usize,
        level in prop::sample::select(Level::ALL.to_vec()),
    ) {
        prop_assume!(level.is_available());
        Trained::new(tiny()).agrees(level, (height, width), (height, width));
    }
}

#[test]
fn the_prepared_network_agrees_for_every_kind_of_head() {
    for (octaves, hidden) in [(0, vec![32]), (3, vec![24]), (5, vec![64, 40, 24])] {
        let config = NetworkConfig {
            octaves,
            hidden,
            ..tiny()
        };
        Trained::new(config).agrees(Level::here(), (33, 47), (33, 47));
    }
}

#[test]
fn the_prepared_network_sharpens_as_the_plain_one_does() {
    let mut config = tiny();
    config.extractor.sharpening = 2;
    let trained = Trained::filled(config);
    for level in Level::available() {
        for size in [(1, 1), (3, 5), (37, 61), (57, 130)] {
            trained.agrees(level, size, size);
        }
        trained.agrees(level, (48, 64), (100, 77));
    }
    trained.agrees(Level::here(), (228, 304), (228, 304));
}

#[test]
fn the_prepared_network_adds_context_as_the_plain_one_does() {
    let mut config = tiny();
    let stage = |width, blocks| StageConfig { width, blocks };
    config.extractor.context = vec![stage(24, 1), stage(40, 2)];
    let trained = Trained::filled(config);
    for level in Level::available() {
        for size in [(1, 1), (3, 5), (37, 61), (57, 130)] {
            trained.agrees(level, size, size);
        }
    }
    trained.agrees(Level::here(), (228, 304), (228, 304));
}

#[test]
fn affinities_of_the_prepared_network_are_those_of_the_plain_one() {
    let trained = Trained::filled(NetworkConfig {
        affinities: 8,
        ..tiny()
    });
    for level in Level::available() {
        for size in [(1, 1), (3, 5), (32, 32), (37, 61), (120, 77)] {
            trained.affinities_agree(level, size);
        }
    }
    trained.affinities_agree(Level::here(), (228, 304));
    Trained::new(tiny()).affinities_agree(Level::here(), (57, 76));
}

#[test]
fn every_preset_agrees() {
    for config in [
        NetworkConfig::paper(),
        NetworkConfig::medium(),
        NetworkConfig::sharp(),
        NetworkConfig::small(),
        NetworkConfig::anything(),
        NetworkConfig::taught(),
        NetworkConfig::lite(),
        NetworkConfig::lite_small(),
    ] {
        let trained = Trained::filled(config);
        trained.agrees(Level::here(), (57, 76), (57, 76));
        trained.affinities_agree(Level::here(), (57, 76));
    }
}

#[test]
fn group_normalisation_cannot_be_prepared() {
    let config = NetworkConfig {
        norm: NormKind::Group,
        ..tiny()
    };
    let net = config.init(0, &Device::flex()).unwrap();
    let weights = weights_of(&net, config.clone(), Normalisation::default());
    let error = CpuNetwork::new(&config, &weights.tensors, None, Level::here()).unwrap_err();
    assert!(error.to_string().contains("group normalisation"), "{error}");
}

#[test]
fn a_network_without_its_encoder_is_refused() {
    let config = NetworkConfig::anything();
    let weights = weights_of(&net(&config), config.clone(), Normalisation::default());
    let error = CpuNetwork::new(&config, &weights.tensors, None, Level::here()).unwrap_err();
    assert!(error.to_string().contains("encoder"), "{error}");
}

#[test]
fn an_encoder_on_a_device_agrees() {
    let trained = Trained::filled(NetworkConfig::anything());
    let (size, device) = ((57, 76), Device::flex());
    let transformer = VisionTransformer::new(short(), &random_tensors(), &device).unwrap();
    let transformer = AnyEncoder::OnDevice(Arc::new(transformer));
    let network = OnDevice::new(trained.net.clone(), Some(transformer), &device);
    let forward = network.forward(&image(size.0, size.1), size).unwrap();
    let prepared = trained.prepared(Level::here(), size);
    let places = [[3.0, 4.0], [60.5, 30.25]];
    let at = |forward: &dyn Forward| forward.basis().at(size, &places);
    assert!(difference(&at(&*forward), &at(&*prepared)) < 1e-3);
}
