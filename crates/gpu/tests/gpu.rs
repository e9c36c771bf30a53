//! The network on a GPU against that on the CPU, and what a completion launches and transfers.
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use lsdc_core::network::{CpuNetwork, Network as _};
use lsdc_core::{Channels, Completer, Image, Observations, Weights};
use lsdc_gpu::{Adapter, Gpu, GpuNetwork, Part, Traffic};
use lsdc_kernels::simd::Level;
use lsdc_rng::Rng;
use std::sync::Arc;

/// The best GPU, or a software driver in its place.
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

/// The largest difference over the largest value.
fn off(found: &[f32], expected: &[f32]) -> f32 {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(1e-30, |m: f32, v| m.max(v.abs()));
    let pairs = found.iter().zip(expected);
    pairs.fold(0.0, |m: f32, (a, b)| m.max((a - b).abs())) / scale
}

fn check(weights: &Weights, gpu: &Gpu, size: (usize, usize)) {
    let here = CpuNetwork::new(&weights.network, &weights.tensors, None, Level::here()).unwrap();
    let there = GpuNetwork::new(weights, gpu).unwrap();
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
    let weights: Vec<f64> = random(weights.network.bases + 1, "weights")
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

/// An image with edges, and points on a slope.
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
        // Nothing that depends on the size alone is done twice.
        assert_eq!(parts[Part::Preparation as usize].1, Traffic::default());
        let all: Traffic = parts.into_iter().map(|(_, traffic)| traffic).sum();
        assert!(all.launches <= 120, "{parts:?}");
        assert!(all.uploads <= 3, "{parts:?}");
        assert!(all.readbacks <= 3, "{parts:?}");
        // The image in quads of f32, places with 24 values, and weights.
        assert!(
            all.bytes_up < 16 * 60 * 80 + 300 * 4 * 24 * 4 + 4096,
            "{parts:?}"
        );
        // Affinities, functions of at most four pixels for each point, and the map.
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
