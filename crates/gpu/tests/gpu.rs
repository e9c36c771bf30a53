//! Compares the network on a GPU with the CPU, and checks the launches and transfers of a completion.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

#[path = "../../../tests/depth_anything/mod.rs"]
#[allow(dead_code)]
mod depth_anything;

use depth_anything::{encoder_weights_of, head_weights_with};
use lsdc_core::network::{CpuNetwork, DepthHead, Encoder, EncoderConfig, Network};
use lsdc_core::weights::Tensor;
use lsdc_core::{Channels, Completer, DepthAnything, Image, Observations, Weights};
use lsdc_gpu::{Adapter, Gpu, GpuNetwork, Part, Pretrained, Traffic};
use lsdc_kernels::simd::Level;
use lsdc_rng::Rng;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Returns the best GPU, or a software driver; `None` if there is neither.
fn gpu() -> Option<Gpu> {
    let gpu = Gpu::open(Adapter::Best).ok();
    if gpu.is_none() {
        assert!(
            std::env::var_os("LSDC_REQUIRE_GPU").is_none(),
            "LSDC_REQUIRE_GPU is set, but there is no adapter"
        );
        eprintln!("skipped: this machine has no GPU and no software driver for one");
    }
    gpu
}

fn random(count: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::stream(0, &["gpu", name]);
    (0..count).map(|_| rng.normal()).collect()
}

/// Returns the largest difference relative to the largest value.
fn off(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(1e-30, |m: f32, v| m.max(v.abs()));
    let pairs = found.iter().zip(expected);
    pairs.fold(0.0, |m: f32, (a, b)| m.max((a - b).abs())) / scale
}

fn check(weights: &Weights, gpu: &Gpu, size: (usize, usize)) {
    let here = CpuNetwork::new(&weights.network, &weights.tensors, None, Level::here()).unwrap();
    let there = GpuNetwork::new(weights, gpu).unwrap();
    compare(&here, &there, weights.network.bases, size);
}

fn compare(here: &dyn Network, there: &dyn Network, bases: usize, size: (usize, usize)) {
    let image = random(3 * size.0 * size.1, "image");
    let [here, there] = [
        here.forward(&image, size).unwrap(),
        there.forward(&image, size).unwrap(),
    ];
    let (expected, own) = here.affinities();
    let (found, other) = there.affinities();
    assert_eq!(own, other);
    assert!(found.iter().all(|v| v.is_finite()));
    let logarithms = |values: &[f32]| values.iter().map(|v| v.ln()).collect::<Vec<_>>();
    let difference = off(&logarithms(&found), &logarithms(&expected));
    assert!(
        difference < 1e-4,
        "affinities at {size:?}: {difference:.1e}"
    );
    let (here, there) = (here.basis(), there.basis());
    // Between pixels, at their centres and beyond the outermost centres, of an image of another size.
    let image = (2 * size.0 + 3, size.1 + 7);
    let places = [
        [0.0, 0.0],
        [3.25, 7.5],
        [image.1 as f64 - 0.5, -0.5],
        [5.0, 2.0],
    ];
    for places in [&places[..], &[], &places[1..2]] {
        let (found, expected) = (there.at(image, places), here.at(image, places));
        let difference = off(&found, &expected);
        assert!(difference < 1e-4, "functions at {size:?}: {difference:.1e}");
    }
    let weights: Vec<f64> = random(bases + 1, "weights")
        .into_iter()
        .map(f64::from)
        .collect();
    for image in [size, image] {
        let (found, expected) = (
            there.combine(image, &weights),
            here.combine(image, &weights),
        );
        let difference = off(&found, &expected);
        assert!(
            difference < 1e-4,
            "map of {image:?} at {size:?}: {difference:.1e}"
        );
    }
}

#[test]
fn built_in_networks_agree() {
    let Some(gpu) = gpu() else { return };
    check(&Weights::builtin(), &gpu, (57, 76));
    check(&Weights::builtin(), &gpu, (33, 41));
    check(&Weights::builtin_small(), &gpu, (50, 67));
}

/// The weights `anything` and an encoder of sines with the taps of the published one, in fewer and smaller blocks.
fn anything() -> (Weights, EncoderConfig, BTreeMap<String, Tensor>) {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../weights/weights/anything.safetensors"
    );
    let weights = Weights::from_bytes(&std::fs::read(path).unwrap()).unwrap();
    let config = EncoderConfig {
        blocks: 4,
        hidden: 32,
        side: 4,
        taps: vec![0, 1, 2, 3],
        ..EncoderConfig::small()
    };
    let mut tensors = encoder_weights_of(&config);
    // Attention scores of about 1, as after training: larger scores would amplify rounding errors from block to block.
    for tensor in tensors.values_mut() {
        if let [_, inputs] = *tensor.shape() {
            let scale = 2.0 / (inputs as f32).sqrt();
            let values = tensor.values().iter().map(|value| scale * value);
            *tensor = Tensor::new(tensor.shape().to_vec(), values.collect()).unwrap();
        }
    }
    (weights, config, tensors)
}

#[test]
fn a_network_on_an_encoder_agrees_with_its_guide() {
    let Some(gpu) = gpu() else { return };
    let (weights, config, encoder) = anything();
    let head = head_weights_with(config.width, [8, 12, 8, 10]);
    let pretrained = Pretrained {
        config: config.clone(),
        encoder: &encoder,
        head: Some(&head),
    };
    let there = GpuNetwork::with_encoder(&weights, &pretrained, &gpu).unwrap();
    let level = Level::here();
    let prepared = Arc::new(Encoder::new(config.clone(), &encoder, level).unwrap());
    let (config, tensors) = (&weights.network, &weights.tensors);
    let here = CpuNetwork::new(config, tensors, Some(prepared), level).unwrap();
    let size = (57, 76);
    compare(&here, &there, config.bases, size);

    let image = random(3 * size.0 * size.1, "image");
    let features = here.forward(&image, size).unwrap().published_features();
    let features = features.unwrap();
    let head = DepthHead::new(&head, level).unwrap();
    let expected = head.predict(&features).unwrap();
    let before = gpu.traffic();
    let forward = there.forward(&image, size).unwrap();
    let (found, image) = forward.published_depths().unwrap();
    assert_eq!(image, (14 * features.rows, 14 * features.columns));
    let difference = off(&found, &expected);
    assert!(difference < 1e-4, "guide: {difference:.1e}");
    // The depths can be read once, as by a scene.
    assert!(forward.published_depths().is_none());

    // Uploads: the image, and the image resized to whole patches. Readback: the guide.
    let parts = gpu.traffic();
    let part = Part::Network as usize;
    let traffic = parts[part].1 - before[part].1;
    assert_eq!((traffic.uploads, traffic.readbacks), (2, 1));
    assert_eq!(traffic.submissions, 3);
    // 68 for the network and 54 for the head; the embedding, five for each block, and the features. The published encoder has
    // eight more blocks: 62 launches.
    assert!(traffic.launches <= 68 + 54 + (1 + 5 * 4 + 1), "{traffic:?}");
    assert_eq!(
        parts[Part::Preparation as usize],
        before[Part::Preparation as usize]
    );
}

#[test]
fn a_guided_completion_agrees() {
    let Some(gpu) = gpu() else { return };
    let (weights, config, encoder) = anything();
    let head = head_weights_with(config.width, [8, 12, 8, 10]);
    let pretrained = Pretrained {
        config: config.clone(),
        encoder: &encoder,
        head: Some(&head),
    };
    let network = Arc::new(GpuNetwork::with_encoder(&weights, &pretrained, &gpu).unwrap());
    let level = Level::here();
    let encoder = Arc::new(Encoder::new(config, &encoder, level).unwrap());
    let head = DepthHead::new(&head, level).unwrap();
    let head = DepthAnything::with_parts(encoder.clone(), head)
        .unwrap()
        .depth_head();
    let builder = || Completer::builder(&weights).working_size(60, 80);
    let size = (120, 160);
    let (image, points) = scene(size);
    let image = Image::new(size.1, size.0, Channels::Rgb, &image).unwrap();
    let complete = |completer: Completer| {
        let scene = completer.scene(&image).unwrap();
        assert!(scene.is_guided());
        scene.complete(&points).unwrap().depth().unwrap()
    };
    let on_cpu = builder().encoder(encoder).build().unwrap();
    let expected = complete(on_cpu.with_depth_head(head).unwrap());
    let on_gpu = builder().network(network).build().unwrap();
    assert!(on_gpu.has_depth_head() && !on_gpu.can_have_depth_head());
    assert!(
        !on_gpu
            .without_depth_head()
            .scene(&image)
            .unwrap()
            .is_guided()
    );
    let found = complete(on_gpu);
    let squares = expected.values().iter().zip(found.values());
    let squares = squares.map(|(a, b)| f64::from(a - b).powi(2));
    let rms = (squares.sum::<f64>() / expected.values().len() as f64).sqrt();
    assert!(rms < 2e-3, "{rms} m");
}

#[test]
fn images_are_in_flight_until_they_are_waited_for() {
    let Some(gpu) = gpu() else { return };
    let network = GpuNetwork::new(&Weights::builtin_small(), &gpu).unwrap();
    let size = (33, 41);
    let image = random(3 * size.0 * size.1, "image");
    let forward = || network.forward(&image, size).unwrap();
    assert_eq!(gpu.most_in_flight(), 0);
    drop(forward().affinities());
    drop(forward().affinities());
    assert_eq!(gpu.most_in_flight(), 1);
    let all = [forward(), forward(), forward()];
    assert_eq!(gpu.most_in_flight(), 3);
    let maps = all.each_ref().map(|forward| forward.affinities());
    assert!(maps.iter().all(|map| *map == maps[0]));
    drop(all);
    drop([forward(), forward()]);
    assert_eq!(gpu.most_in_flight(), 3);
}

/// Returns an image with edges, and points on a slope.
fn scene((height, width): (usize, usize)) -> (Vec<u8>, Observations) {
    let colour = |i: usize| {
        let (pixel, channel) = (i / 3, i % 3);
        let (y, x) = (pixel / width, pixel % width);
        (40 * (1 + channel) * (1 + (x / 23 + y / 17) % 2) + (x + y) % 7) as u8
    };
    let image = (0..3 * height * width).map(colour).collect();
    let mut points = Observations::new();
    let mut rng = Rng::stream(0, &["points"]);
    for _ in 0..300 {
        let (u, v) = (rng.below(width as u32), rng.below(height as u32));
        points.add(u.into(), v.into(), 1.0 + 2.0 * u as f32 / width as f32);
    }
    (image, points)
}

#[test]
fn a_completion_agrees_and_is_within_its_budget() {
    let Some(gpu) = gpu() else { return };
    let size = (120, 160);
    let (image, points) = scene(size);
    let image = Image::new(size.1, size.0, Channels::Rgb, &image).unwrap();
    let weights = Weights::builtin();
    let network = Arc::new(GpuNetwork::new(&weights, &gpu).unwrap());
    let builder = || Completer::builder(&weights).working_size(60, 80);
    let there = builder().network(network).build().unwrap();
    let here = builder().build().unwrap();
    let complete = |completer: &Completer| {
        let scene = completer.scene(&image).unwrap();
        scene.complete(&points).unwrap().depth().unwrap()
    };
    let expected = complete(&here);
    let mut before = gpu.traffic();
    for run in 0..2 {
        let found = complete(&there);
        let squares = expected.values().iter().zip(found.values());
        let squares = squares.map(|(a, b)| f64::from(a - b).powi(2));
        let rms = (squares.sum::<f64>() / expected.values().len() as f64).sqrt();
        assert!(rms < 2e-3, "{rms} m");
        let after = gpu.traffic();
        let parts = after.map(|(part, _)| (part, after[part as usize].1 - before[part as usize].1));
        before = after;
        if run == 0 {
            continue;
        }
        // Preparation that depends only on the size is not repeated.
        assert_eq!(parts[Part::Preparation as usize].1, Traffic::default());
        let all: Traffic = parts.into_iter().map(|(_, traffic)| traffic).sum();
        assert!(all.launches <= 120, "{parts:?}");
        assert!(all.uploads <= 3, "{parts:?}");
        assert!(all.readbacks <= 3, "{parts:?}");
        // The image as four f32 per pixel, places with 24 values, and weights.
        assert!(
            all.bytes_up < 16 * 60 * 80 + 300 * 4 * 24 * 4 + 4096,
            "{parts:?}"
        );
        // Affinities, basis functions at up to four pixels per point, and the map.
        let functions = 4 * 300 * (weights.network.bases as u64 + 1);
        assert!(all.bytes_down <= 4 * (3 * 60 * 80 + functions), "{parts:?}");
    }
}

#[test]
fn images_of_several_threads_do_not_mix() {
    let Some(gpu) = gpu() else { return };
    let network = GpuNetwork::new(&Weights::builtin_small(), &gpu).unwrap();
    let size = (33, 41);
    let places = [[3.0, 4.0], [17.5, 20.25]];
    let run = |image: &[f32]| {
        let forward = network.forward(image, size).unwrap();
        let (affinities, _) = forward.affinities();
        (affinities, forward.basis().at(size, &places))
    };
    let names = ["one", "two", "three", "four"];
    let images = names.map(|name| random(3 * size.0 * size.1, name));
    let alone = images.each_ref().map(|image| run(image));
    assert_ne!(alone[0], alone[1]);
    std::thread::scope(|scope| {
        let threads = images
            .each_ref()
            .map(|image| scope.spawn(|| [run(image), run(image)]));
        for (thread, expected) in threads.into_iter().zip(&alone) {
            assert!(thread.join().unwrap().iter().all(|found| found == expected));
        }
    });
}
