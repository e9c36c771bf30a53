//! The least-squares solve alone: 129 basis functions, 500 and 1000 points, one thread.
//!
//!     cargo bench --bench solve

use criterion::{Criterion, criterion_group, criterion_main};
use lsdc_core::fit::{Problem, Solver};
use lsdc_rng::Rng;
use std::hint::black_box;

const FUNCTIONS: usize = 129;

fn solve(criterion: &mut Criterion) {
    for points in [500, 1000] {
        let mut rng = Rng::stream(0, &["bench"]);
        let mut draw = |count: usize| (0..count).map(|_| f64::from(rng.normal())).collect();
        let bases: Vec<f64> = draw(points * FUNCTIONS);
        let (depths, weights): (Vec<f64>, Vec<f64>) = (draw(points), vec![1.0; points]);
        let mut group = criterion.benchmark_group(format!("solve, {points} points"));
        for (name, solver) in [
            ("ridge", Solver::Ridge(1e-4)),
            ("full rank", Solver::Truncated(1e-12)),
            // No matrix is this well conditioned, so the fast path does not apply.
            ("truncated SVD", Solver::Truncated(0.5)),
        ] {
            group.bench_function(name, |bencher| {
                bencher.iter(|| Problem::new(black_box(&bases), &depths, &weights).solve(solver));
            });
        }
    }
}

criterion_group!(benches, solve);
criterion_main!(benches);
