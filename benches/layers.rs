//! Every layer shape of the paper's network at 228x304, and of the default network where it differs, forward and backward.
//!
//!     cargo bench --bench layers

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use lsdc::process::keep_pages;
use lsdc_kernels::conv::{self, ConvSpec, Layer, Shape};
use lsdc_kernels::simd::{Level, Scratch, Tail};
use lsdc_rng::Rng;
use std::hint::black_box;

/// Rows and columns at full, half and quarter resolution.
const FULL: [usize; 2] = [228, 304];
const HALF: [usize; 2] = [114, 152];
const QUARTER: [usize; 2] = [57, 76];

fn cases() -> Vec<(&'static str, Shape)> {
    let case = |name, [height, width]: [usize; 2], channels, outputs, taps, spec| {
        let shape = Shape {
            batch: 1,
            height,
            width,
            channels,
            outputs,
            taps,
            spec,
        };
        (name, shape)
    };
    let same = ConvSpec::same;
    vec![
        case("3-32 stride 2", FULL, 3, 32, 3, ConvSpec::halving()),
        case("32-32", HALF, 32, 32, 3, same(1)),
        case("32-64 stride 2", HALF, 32, 64, 3, ConvSpec::halving()),
        case("64-64", QUARTER, 64, 64, 3, same(1)),
        case("64-128", QUARTER, 64, 128, 3, same(1)),
        case("128-128", QUARTER, 128, 128, 3, same(1)),
        case("128-128 dilated", QUARTER, 128, 128, 3, same(2)),
        case("320-128", QUARTER, 320, 128, 3, same(1)),
        case("512-128 1x1", FULL, 512, 128, 1, ConvSpec::pointwise()),
        case("128-128 1x1", FULL, 128, 128, 1, ConvSpec::pointwise()),
        case("16-16 full", FULL, 16, 16, 3, same(1)),
        case("16-16", HALF, 16, 16, 3, same(1)),
        case("32-32 quarter", QUARTER, 32, 32, 3, same(1)),
        case("160-64", QUARTER, 160, 64, 3, same(1)),
        case("64-64 half", HALF, 64, 64, 3, same(1)),
    ]
}

/// Multiply-adds of a forward pass.
fn products(shape: &Shape) -> Throughput {
    Throughput::Elements((shape.out_pixels() * shape.depth() * shape.outputs) as u64)
}

fn random(count: usize) -> Vec<f32> {
    let mut rng = Rng::stream(0, &["bench"]);
    (0..count).map(|_| rng.normal()).collect()
}

fn forward(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("layer");
    let scratch = Scratch::new();
    for (name, shape) in cases() {
        let weights = random(shape.outputs * shape.depth());
        let sizes = [shape.outputs, shape.channels, shape.taps];
        let layer = Layer::new(Level::here(), &weights, sizes, &[], shape.spec);
        let x = random(shape.height * shape.width * shape.channels);
        let mut output = vec![0.0; shape.out_pixels() * shape.outputs];
        let tail = Tail {
            relu: true,
            ..Tail::default()
        };
        group.throughput(products(&shape));
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                let x = black_box(&x);
                layer.apply(x, shape.size(), tail, &scratch, &mut output);
            });
        });
    }
}

/// Both gradients for a batch of four images, as in a training step, for each kernel.
fn backward(criterion: &mut Criterion) {
    const BATCH: usize = 4;
    keep_pages();
    let scratch = Scratch::new();
    let level = Level::here();
    for part in ["inputs", "weights"] {
        let mut group = criterion.benchmark_group(format!("gradient of {part}, batch {BATCH}"));
        group.sample_size(20);
        for (name, shape) in cases() {
            let shape = Shape {
                batch: BATCH,
                ..shape
            };
            let x = random(BATCH * shape.height * shape.width * shape.channels);
            let weights = random(shape.outputs * shape.depth());
            let grad = random(shape.out_pixels() * shape.outputs);
            group.throughput(products(&shape));
            group.bench_function(name, |bencher| {
                bencher.iter(|| match part {
                    "inputs" => conv::input_gradient(level, &weights, &grad, &shape, &scratch),
                    _ => conv::weight_gradient(level, &x, &grad, &shape, &scratch),
                });
            });
        }
    }
}

criterion_group!(benches, forward, backward);
criterion_main!(benches);
