//! The solution against closed forms and plain elimination.

use super::{Problem, Solver, divide, dot, times, transposed_times};
use lsdc_rng::Rng;

const EXACT: Solver = Solver::Truncated(1e-9);

fn random(count: usize, name: &str) -> Vec<f64> {
    let mut rng = Rng::stream(0, &["lstsq", name]);
    (0..count).map(|_| f64::from(rng.normal())).collect()
}

/// Gauss-Jordan elimination with pivoting: the plain reference.
fn gauss(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for c in 0..n {
        let pivot = (c..n)
            .max_by(|&i, &j| a[i][c].abs().total_cmp(&a[j][c].abs()))
            .unwrap();
        a.swap(c, pivot);
        b.swap(c, pivot);
        for r in (0..n).filter(|&r| r != c) {
            let factor = a[r][c] / a[c][c];
            let row = a[c].clone();
            a[r].iter_mut().zip(row).for_each(|(x, y)| *x -= factor * y);
            b[r] -= factor * b[c];
        }
    }
    (0..n).map(|i| b[i] / a[i][i]).collect()
}

fn assert_close(a: &[f64], b: &[f64], tolerance: f64) {
    assert_eq!(a.len(), b.len());
    let scale = b.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
    for (x, y) in a.iter().zip(b) {
        assert!((x - y).abs() <= tolerance * scale, "{x} instead of {y}");
    }
}

#[test]
fn full_rank_meets_the_weighted_normal_equations() {
    let (n, k) = (40, 7);
    let (f, d) = (random(n * k, "f"), random(n, "d"));
    let w: Vec<f64> = random(n, "w").iter().map(|v| v.abs()).collect();
    let sum = |g: &dyn Fn(usize) -> f64| (0..n).map(|i| w[i] * g(i)).sum::<f64>();
    let normal = (0..k)
        .map(|a| {
            (0..k)
                .map(|b| sum(&|i| f[i * k + a] * f[i * k + b]))
                .collect()
        })
        .collect();
    let right = (0..k).map(|a| sum(&|i| f[i * k + a] * d[i])).collect();
    let solution = Problem::new(&f, &d, &w).solve(EXACT).unwrap();
    assert_eq!(solution.rank, k);
    assert_close(&solution.weights, &gauss(normal, right), 1e-10);
}

#[test]
fn fewer_points_than_functions_give_the_least_norm() {
    let (n, k) = (5, 9);
    let (f, d) = (random(n * k, "f"), random(n, "d"));
    let gram = (0..n)
        .map(|a| {
            (0..n)
                .map(|b| (0..k).map(|j| f[a * k + j] * f[b * k + j]).sum())
                .collect()
        })
        .collect();
    let dual = gauss(gram, d.clone());
    let expected: Vec<f64> = (0..k)
        .map(|j| (0..n).map(|i| f[i * k + j] * dual[i]).sum())
        .collect();
    let solution = Problem::new(&f, &d, &vec![1.0; n]).solve(EXACT).unwrap();
    assert_eq!(solution.rank, n);
    assert_close(&solution.weights, &expected, 1e-10);
}

#[test]
fn a_repeated_column_shares_its_weight() {
    let (n, k) = (30, 4);
    let mut f = random(n * k, "f");
    for row in f.chunks_exact_mut(k) {
        row[3] = row[2];
    }
    let d = random(n, "d");
    let solution = Problem::new(&f, &d, &vec![1.0; n]).solve(EXACT).unwrap();
    assert_eq!(solution.rank, 3);
    assert!((solution.weights[2] - solution.weights[3]).abs() < 1e-12);
}

#[test]
fn a_small_ridge_changes_little_and_shrinks() {
    let (n, k) = (50, 6);
    let (f, d, w) = (random(n * k, "f"), random(n, "d"), vec![1.0; n]);
    let norm = |solver| {
        let x = Problem::new(&f, &d, &w).solve(solver).unwrap().weights;
        x.iter().map(|v| v * v).sum::<f64>()
    };
    let plain = norm(EXACT);
    assert!((norm(Solver::Ridge(1e-9)) - plain).abs() < 1e-6 * plain);
    assert!(norm(Solver::Ridge(0.1)) < plain);
}

#[test]
fn the_fast_path_is_taken_only_where_it_is_safe_and_agrees_with_the_decomposition() {
    let (n, k) = (60, 9);
    let (f, d, w) = (random(n * k, "f"), random(n, "d"), vec![1.0; n]);
    // The last column is another one plus a little: singular values from 1 down to `little`.
    let squeezed = |little: f64| {
        let mut f = f.clone();
        for row in f.chunks_exact_mut(k) {
            row[k - 1] = row[0] + little * row[k - 1];
        }
        Problem::new(&f, &d, &w)
    };
    for little in [1.0, 1e-2, 1e-3] {
        let problem = squeezed(little);
        let fast = problem.full_rank(1e-9).unwrap();
        let kept = problem.decompose(1e-9).unwrap();
        let inner = divide(transposed_times(kept.u.as_ref(), &problem.depths), &kept.s);
        assert_close(&fast.weights, &times(kept.v.as_ref(), &inner), 1e-9);
        assert_eq!(fast.rank, k);
    }
    for little in [1e-5, 1e-8, 0.0] {
        assert!(squeezed(little).full_rank(1e-9).is_none());
    }
    assert!(squeezed(1e-2).full_rank(0.1).is_none(), "must be truncated");
    let few = Problem::new(&f[..5 * k], &d[..5], &w[..5]);
    assert!(few.full_rank(1e-9).is_none(), "fewer points than functions");
}

/// `depths - bases x`.
fn residuals(bases: &[f64], depths: &[f64], x: &[f64]) -> Vec<f64> {
    let fitted = bases.chunks_exact(x.len()).map(|row| dot(row, x));
    depths.iter().zip(fitted).map(|(d, f)| d - f).collect()
}

#[test]
fn a_residual_over_one_minus_leverage_is_that_of_the_point_left_out() {
    let (n, k) = (30, 5);
    let (f, d) = (random(n * k, "f"), random(n, "d"));
    let mut w: Vec<f64> = random(n, "w").iter().map(|v| v.abs()).collect();
    w[3] = 0.0;
    let problem = Problem::new(&f, &d, &w);
    let solution = problem.solve(EXACT).unwrap();
    let leverages = solution.leverages(&f, &w);
    let found = residuals(&f, &d, &solution.weights);
    assert_eq!(leverages[3], 0.0);
    for i in 0..n {
        let mut without = w.clone();
        without[i] = 0.0;
        let other = Problem::new(&f, &d, &without).solve(EXACT).unwrap();
        let expected = residuals(&f, &d, &other.weights)[i];
        assert_close(&[found[i] / (1.0 - leverages[i])], &[expected], 1e-9);
    }
    // They sum to the number of unknowns.
    let sum: f64 = leverages.iter().sum();
    assert!((sum - k as f64).abs() < 1e-9, "{sum}");
}

#[test]
fn leverages_under_a_ridge_are_the_diagonal_of_the_smoother() {
    let (n, k, share) = (12, 4, 0.3);
    let (f, d) = (random(n * k, "f"), random(n, "d"));
    let solver = Solver::Ridge(share);
    let ones = vec![1.0; n];
    let solution = Problem::new(&f, &d, &ones).solve(solver).unwrap();
    let leverages = solution.leverages(&f, &ones);
    // The fit is linear in the depths with the bases fixed: a unit depth at i gives column i.
    for i in 0..n {
        let mut unit = vec![0.0; n];
        unit[i] = 1.0;
        let solution = Problem::new(&f, &unit, &vec![1.0; n])
            .solve(solver)
            .unwrap();
        let fitted = 1.0 - residuals(&f, &unit, &solution.weights)[i];
        assert!(
            (fitted - leverages[i]).abs() < 1e-12,
            "{fitted} {}",
            leverages[i]
        );
    }
}
