//! The prepared network against the plain one, with statistics far from the initial ones.

use super::random_encoder::{random_encoder, random_tensors, short};
use super::{
    AnyEncoder, BasisNet, InitNetwork as _, OnDevice, VisionTransformer, encoded_tensor, load,
    weights_of,
};
use burn::module::{Module as _, ModuleMapper, Param};
use burn::tensor::{Device, Tensor, TensorData};
use lsdc_core::network::{ADAPTERS, CpuNetwork, Encoder, Forward, Network as _};
use lsdc_core::network::{
    AdapterConfig, EncoderConfig, ExtractorConfig, NetworkConfig, NormKind, StageConfig,
};
use lsdc_core::weights::Normalisation;
use lsdc_core::{Error, Weights, WeightsError};
use lsdc_kernels::simd::Level;
use lsdc_rng::Rng;
use lsdc_weights::{Precision, to_bytes};
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

/// A network whose running statistics have seen an image.
fn net(config: &NetworkConfig) -> BasisNet {
    let device = Device::flex().autodiff();
    let net = config.init(3, &device).unwrap();
    let image = TensorData::new(image(40, 56), [1, 40, 56, 3]);
    let pixels = vec![(0..40 * 56).collect()];
    let encoded = (config.extractor.encoder > 0).then(|| {
        let encoded = random_encoder()
            .encode(&self::image(40, 56), (40, 56))
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

/// Largest difference as a share of the largest value.
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

    /// With numbers in the place of zeros, so that parts which begin without effect have one.
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
        )
        .unwrap();
        network.forward(&image(size.0, size.1), size).unwrap()
    }

    fn agrees(&self, level: Level, size: (usize, usize), output: (usize, usize)) {
        let prepared = self.prepared(level, size).basis();
        let plain = self.plain(size).basis();
        let pixels = (0..output.0 * output.1).step_by(7);
        let place = |pixel: usize| [(pixel % output.1) as f64, (pixel / output.1) as f64];
        let centres: Vec<_> = pixels.map(place).collect();
        // Between pixels, and up to the rim of the image.
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

/// Pixels are read as places are, in training too.
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

/// Puts numbers in the place of zeros.
struct Fill;

impl ModuleMapper for Fill {
    fn map_float<const D: usize>(&mut self, tensor: Param<Tensor<D>>) -> Param<Tensor<D>> {
        tensor.map(|tensor| {
            let data = tensor.to_data();
            let mut values: Vec<f32> = data.iter::<f32>().collect();
            if D > 1 && values.iter().all(|v| *v == 0.0) {
                let mut rng = Rng::stream(9, &["fill"]);
                // The more there are, the more are added up.
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
        // The same cases every time.
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

/// A network of which adapters are a part, on an encoder whose last blocks they change.
fn adapted() -> NetworkConfig {
    NetworkConfig {
        adapters: Some(AdapterConfig { blocks: 2, rank: 3 }),
        ..NetworkConfig::anything()
    }
}

#[test]
fn a_network_with_adapters_agrees() {
    let trained = Trained::filled(adapted());
    trained.agrees(Level::here(), (57, 76), (57, 76));
    trained.affinities_agree(Level::here(), (57, 76));
    // Also where the encoder is on a device, and adapters are computed beside it.
    let size = (57, 76);
    let transformer = VisionTransformer::new(short(), &random_tensors(), &Device::flex()).unwrap();
    let transformer = AnyEncoder::OnDevice(Arc::new(transformer));
    let network = OnDevice::new(trained.net.clone(), Some(transformer), &Device::flex()).unwrap();
    let image = image(size.0, size.1);
    let places = [[3.0, 4.0], [60.5, 30.25]];
    let found = network
        .forward(&image, size)
        .unwrap()
        .basis()
        .at(size, &places);
    let reference = trained
        .prepared(Level::here(), size)
        .basis()
        .at(size, &places);
    assert!(difference(&found, &reference) < 1e-3);
    let short = EncoderConfig {
        blocks: 1,
        taps: vec![0],
        ..short()
    };
    let transformer = VisionTransformer::new(short, &random_tensors(), &Device::flex()).unwrap();
    let transformer = AnyEncoder::OnDevice(Arc::new(transformer));
    let refused = OnDevice::new(trained.net.clone(), Some(transformer), &Device::flex());
    assert!(refused.unwrap_err().to_string().contains("more blocks"));
    // They do change something.
    let mut weights = weights_of(&trained.net, adapted(), Normalisation::default());
    let without = NetworkConfig::anything();
    weights
        .tensors
        .retain(|name, _| !name.starts_with(ADAPTERS));
    let network = CpuNetwork::new(
        &without,
        &weights.tensors,
        trained.encoder.clone(),
        Level::here(),
    )
    .unwrap();
    let other = network
        .forward(&image, size)
        .unwrap()
        .basis()
        .at(size, &places);
    assert!(difference(&other, &reference) > 1e-2);
}

#[test]
fn untrained_adapters_change_no_bit() {
    let config = adapted();
    let net = config.init(0, &Device::flex()).unwrap();
    let weights = weights_of(&net, config.clone(), Normalisation::default());
    let mut plain = weights.tensors.clone();
    plain.retain(|name, _| !name.starts_with(ADAPTERS));
    assert_eq!(plain.len() + 2 * 2 * 2, weights.tensors.len());
    let (image, size) = (image(57, 76), (57, 76));
    let values = |config: &NetworkConfig, tensors| {
        let encoder = Some(random_encoder());
        let network = CpuNetwork::new(config, tensors, encoder, Level::here()).unwrap();
        let forward = network.forward(&image, size).unwrap();
        (
            forward.basis().at(size, &[[3.0, 4.0], [60.5, 30.25]]),
            forward.affinities(),
        )
    };
    let without = NetworkConfig::anything();
    assert_eq!(values(&config, &weights.tensors), values(&without, &plain));
}

#[test]
fn adapters_are_part_of_the_file() {
    let trained = Trained::filled(adapted());
    let weights = weights_of(&trained.net, adapted(), Normalisation::default());
    let bytes = to_bytes(&weights, Precision::Single).unwrap();
    let read = Weights::from_bytes(&bytes).unwrap();
    assert_eq!(read.network, adapted());
    assert_eq!(read.tensors, weights.tensors);
    let loaded = load(&read, &Device::flex()).unwrap();
    let again = weights_of(&loaded, adapted(), Normalisation::default());
    assert_eq!(again.tensors, weights.tensors);

    // Files without them are as they were before there were any.
    let plain = NetworkConfig::anything();
    let net = plain.init(0, &Device::flex()).unwrap();
    let bytes = to_bytes(
        &weights_of(&net, plain, Normalisation::default()),
        Precision::Half,
    );
    let bytes = bytes.unwrap();
    assert!(!bytes.windows(8).any(|part| part == b"adapters"));

    // Damaged or of other sizes.
    let name = "adapters.blocks.1.values.up.weight";
    let refused = |weights: &Weights| {
        let encoder = Some(random_encoder());
        let prepared = CpuNetwork::new(&weights.network, &weights.tensors, encoder, Level::here());
        let Err(Error::Weights(WeightsError::Tensor { name, reason })) = prepared else {
            panic!("not refused");
        };
        assert!(load(weights, &Device::flex()).is_err());
        format!("{name} {reason}")
    };
    let mut damaged = read.clone();
    damaged.tensors.remove(name);
    assert_eq!(refused(&damaged), format!("{name} is missing"));
    let mut other = read.clone();
    other.network.adapters = Some(AdapterConfig { blocks: 2, rank: 4 });
    assert!(refused(&other).contains("expected [384, 4]"));
    let mut fewer = read.clone();
    fewer.network.adapters = Some(AdapterConfig { blocks: 1, rank: 3 });
    assert!(refused(&fewer).contains("is superfluous"));
    let mut none = read;
    none.network.adapters = None;
    assert!(refused(&none).contains("is superfluous"));
}
