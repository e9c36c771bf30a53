//! Tests of scenes of the weights `anything` guided by the depth head of their encoder, which runs once for both.
#![allow(clippy::unwrap_used)]
#![cfg(feature = "weights")]

#[path = "../../../tests/depth_anything/mod.rs"]
mod depth_anything;

use lsdc_core::network::{DepthHead, Encoder, EncoderConfig};
use lsdc_core::settings::{FitConfig, FitMethod};
use lsdc_core::weights::Tensor;
use lsdc_core::{
    Channels, Completer, DepthAnything, DepthGuide, GuideKind, Image, Observations, Quality, Scene,
};
use lsdc_kernels::simd::Level;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The image has the size of the network's and the encoder's input, so that it is not resized.
const WIDTH: usize = 448;
const HEIGHT: usize = 336;

/// An encoder of sines with the taps of the published one, in fewer and smaller blocks.
fn encoder() -> Arc<Encoder> {
    let config = EncoderConfig {
        blocks: 4,
        hidden: 32,
        side: 4,
        taps: vec![0, 1, 2, 3],
        ..EncoderConfig::small()
    };
    let tensors = depth_anything::encoder_weights_of(&config);
    Arc::new(Encoder::new(config, &tensors, Level::here()).unwrap())
}

fn head_tensors() -> BTreeMap<String, Tensor> {
    depth_anything::head_weights_of(EncoderConfig::small().width)
}

fn network(encoder: &Arc<Encoder>, head: &BTreeMap<String, Tensor>) -> DepthAnything {
    let head = DepthHead::new(head, Level::here()).unwrap();
    DepthAnything::with_parts(encoder.clone(), head).unwrap()
}

fn unguided(encoder: &Arc<Encoder>) -> Completer {
    let weights = lsdc_weights::named("anything").unwrap().read().unwrap();
    let builder = Completer::builder(&weights).encoder(encoder.clone());
    builder.working_size(HEIGHT, WIDTH).build().unwrap()
}

fn rgb() -> Vec<u8> {
    let bytes = 0..3 * WIDTH * HEIGHT;
    bytes.map(|i| (i / 7 % 251) as u8).collect()
}

fn image(rgb: &[u8]) -> Image<'_> {
    Image::new(WIDTH, HEIGHT, Channels::Rgb, rgb).unwrap()
}

fn depth(scene: &Scene) -> Vec<f32> {
    let mut points = Observations::new();
    for i in 0..60 {
        let (u, v) = (37 * i % WIDTH, 53 * i % HEIGHT);
        points.add(u as f64, v as f64, 1.0 + i as f32 / 30.0);
    }
    let completion = scene.complete(&points).unwrap();
    completion.depth().unwrap().values().to_vec()
}

#[test]
fn the_guide_is_what_depth_anything_predicts_for_the_same_image() {
    let encoder = encoder();
    let network = network(&encoder, &head_tensors());
    let without = unguided(&encoder);
    let with = without.with_depth_head(network.depth_head()).unwrap();
    assert!(with.has_depth_head() && !without.has_depth_head());
    let rgb = rgb();
    let image = image(&rgb);

    let own = with.scene(&image).unwrap();
    assert!(own.is_guided());
    let guide = network.predict(&image, HEIGHT).unwrap();
    assert_eq!((guide.width(), guide.height()), (WIDTH, HEIGHT));
    let expected = depth(&without.guided_scene(&image, &guide).unwrap());
    assert_eq!(depth(&own), expected);

    // Without the head, the result is unchanged.
    let plain = without.scene(&image).unwrap();
    let alone = depth(&plain);
    assert!(!plain.is_guided());
    assert_ne!(alone, expected);
    assert_eq!(depth(&own.with_guide(None)), alone);
    let switched_off = with.without_depth_head();
    assert_eq!(depth(&switched_off.scene(&image).unwrap()), alone);

    // A given guide replaces the prediction of the head.
    let ramp: Vec<f32> = (0..64 * 48).map(|i| 1.0 + (i % 64) as f32).collect();
    let ramp = DepthGuide::new(GuideKind::Depth, 64, 48, &ramp).unwrap();
    let given = depth(&without.guided_scene(&image, &ramp).unwrap());
    assert_eq!(depth(&with.guided_scene(&image, &ramp).unwrap()), given);
    assert_eq!(depth(&own.with_guide(Some(&ramp))), given);
}

#[test]
fn a_scene_has_its_guide_with_every_fit_and_quality() {
    let encoder = encoder();
    let network = network(&encoder, &head_tensors());
    let without = unguided(&encoder);
    let joint = without.with_depth_head(network.depth_head()).unwrap();
    let rgb = rgb();
    let image = image(&rgb);
    let expected = depth(&joint.scene(&image).unwrap());

    let settings = *joint.fit_config();
    let field = joint.with_fit(FitConfig {
        method: FitMethod::Field,
        ..settings
    });
    let field = field.scene(&image).unwrap();
    assert!(!field.is_guided());
    let again = field.with_fit(settings).unwrap();
    assert!(again.is_guided());
    assert_eq!(depth(&again), expected);
    let off = field.with_guide(None).with_fit(settings).unwrap();
    assert_eq!(depth(&off), depth(&without.scene(&image).unwrap()));

    let best = joint.with_quality(Quality::Best).scene(&image).unwrap();
    assert!(best.is_guided());
    assert_ne!(depth(&best), expected);
}

#[test]
fn a_prediction_that_is_the_same_everywhere_is_no_guide() {
    let encoder = encoder();
    let mut head = head_tensors();
    let last = "depth_head.scratch.output_conv2.2.weight";
    let shape = head[last].shape().to_vec();
    let zeros = vec![0.0; shape.iter().product()];
    head.insert(last.to_owned(), Tensor::new(shape, zeros).unwrap());
    let without = unguided(&encoder);
    let head = network(&encoder, &head).depth_head();
    let with = without.with_depth_head(head).unwrap();
    let rgb = rgb();
    let scene = with.scene(&image(&rgb)).unwrap();
    assert!(!scene.is_guided());
    let expected = depth(&without.scene(&image(&rgb)).unwrap());
    assert_eq!(depth(&scene), expected);
}

#[test]
fn a_head_belongs_to_its_encoder() {
    // A head for 16 channels.
    let other = depth_anything::network().depth_head();
    let error = unguided(&encoder()).with_depth_head(other).unwrap_err();
    assert!(error.to_string().contains("another encoder"), "{error}");

    let small = lsdc_weights::named("small").unwrap().read().unwrap();
    let small = Completer::new(&small).unwrap();
    assert!(!small.can_have_depth_head());
    let head = network(&encoder(), &head_tensors()).depth_head();
    let error = small.with_depth_head(head).unwrap_err();
    assert!(error.to_string().contains("without the encoder"), "{error}");
    assert!(
        !lsdc_weights::guided_by_head(small)
            .unwrap()
            .has_depth_head()
    );
}

#[test]
fn the_encoder_reads_images_of_another_size() {
    let encoder = encoder();
    let completer = unguided(&encoder);
    let rgb = rgb();
    let expected = depth(&completer.scene(&image(&rgb)).unwrap());
    let with = |side: usize| {
        let completer = completer.with_encoder_side(side).unwrap();
        depth(&completer.scene(&image(&rgb)).unwrap())
    };
    assert_eq!(with(336), expected);
    assert!(with(252) != expected);
    assert!(completer.with_encoder_side(600).is_err());

    // The head predicts from the same features.
    let network = network(&encoder, &head_tensors());
    let guided = completer.with_depth_head(network.depth_head()).unwrap();
    let guided = guided.with_encoder_side(252).unwrap();
    let own = depth(&guided.scene(&image(&rgb)).unwrap());
    let other = completer.with_encoder_side(252).unwrap();
    let apart = |side: usize| {
        let guide = network.predict(&image(&rgb), side).unwrap();
        let other = depth(&other.guided_scene(&image(&rgb), &guide).unwrap());
        let pairs = own.iter().zip(&other);
        pairs.map(|(a, b)| (a / b - 1.0).abs()).sum::<f32>() / own.len() as f32
    };
    // Colours are rounded to 8 bits before the prediction.
    let [same, larger] = [252, 336].map(apart);
    assert!(same < 5e-4 && larger > 5.0 * same, "{same} {larger}");

    let small = lsdc_weights::named("small").unwrap().read().unwrap();
    let error = Completer::new(&small)
        .unwrap()
        .with_encoder_side(336)
        .unwrap_err();
    assert!(error.to_string().contains("no encoder"), "{error}");
    assert!(error.hint().unwrap().contains("anything"));
}
