//! A smooth field on a grid of 228x304 pixels, alone and with 129 basis functions.
//!
//!     cargo bench --bench field

use criterion::{Criterion, criterion_group, criterion_main};
use lsdc_core::bilinear::InterpolationWeights;
use lsdc_core::field::{CovarianceSolver, FieldPrior, Grid, MOST, PrecisionSolver};
use lsdc_rng::Rng;
use std::hint::black_box;

const SIZE: [usize; 2] = [228, 304];

fn field(criterion: &mut Criterion) {
    let [height, width] = SIZE;
    let mut rng = Rng::stream(0, &["bench"]);
    // From 1e-4 to 1, like affinities of images.
    let mut strengths = || -> Vec<f64> {
        let unit = (0..height * width).map(|_| f64::from(rng.unit()));
        unit.map(|v| 10f64.powf(-4.0 * v)).collect()
    };
    let (right, down) = (strengths(), strengths());
    let grid = Grid {
        height,
        width,
        right: &right,
        down: &down,
        diagonal_regularisation: 1e-7,
    };
    let Some(prior) = FieldPrior::new(&grid) else {
        return;
    };
    criterion.bench_function("field without points", |bencher| {
        bencher.iter(|| FieldPrior::new(black_box(&grid)));
    });
    for (points, count) in [(500, 1), (500, 130), (5000, 130)] {
        let mut rng = Rng::stream(1, &["bench"]);
        let columns: Vec<f64> = (0..points * count)
            .map(|_| f64::from(rng.normal()))
            .collect();
        let mut pixels: Vec<u32> = (0..(height * width) as u32).collect();
        rng.choose(&mut pixels, points);
        let taps: Vec<InterpolationWeights> = pixels[..points]
            .iter()
            .map(|&p| InterpolationWeights::pixel(p))
            .collect();
        let weights = vec![100.0; points];
        let mut group =
            criterion.benchmark_group(format!("field, {points} points, {count} columns"));
        group.sample_size(20);
        group.bench_function("factorise", |bencher| {
            bencher.iter(|| PrecisionSolver::new(black_box(&grid), &taps, &weights));
        });
        if points <= MOST {
            group.bench_function("add points to that without", |bencher| {
                bencher
                    .iter(|| CovarianceSolver::new(black_box(&prior), &taps, &weights, &columns));
            });
        }
        let Some(field) = PrecisionSolver::new(&grid, &taps, &weights) else {
            continue;
        };
        let targets = vec![1.0; points];
        group.bench_function("extend", |bencher| {
            bencher.iter(|| field.extend(black_box(&targets)));
        });
        let sides = vec![1.0; height * width];
        group.bench_function("solve", |bencher| {
            bencher.iter(|| field.solve(black_box(&sides)));
        });
        group.bench_function("variances", |bencher| {
            bencher.iter(|| field.pixel_variances());
        });
    }
}

criterion_group!(benches, field);
criterion_main!(benches);
