use super::*;
use crate::simd::Level;
use lsdc_rng::Rng;

/// Returns a positive definite matrix of `size` rows; the last `padding` rows are padding.
fn example(size: usize, padding: usize, seed: u64) -> Vec<f64> {
    let mut rng = Rng::stream(seed, &["cholesky"]);
    let half: Vec<f64> = (0..size * size)
        .map(|_| f64::from(rng.unit()) - 0.5)
        .collect();
    let used = |i: usize| i < size - padding;
    let mut matrix = vec![0.0; size * size];
    for i in (0..size).filter(|i| used(*i)) {
        for j in (0..size).filter(|j| used(*j)) {
            let products = (0..size).map(|k| half[i * size + k] * half[j * size + k]);
            let shift = if i == j { 1.0 } else { 0.0 };
            matrix[j * size + i] = products.sum::<f64>() + shift;
        }
    }
    matrix
}

/// Factorises column by column, in the order of a textbook.
fn reference(matrix: &[f64], size: usize, columns: usize) -> Vec<f64> {
    let mut all = matrix.to_vec();
    for j in 0..columns {
        let scale = all[j * size + j].sqrt();
        for i in j..size {
            all[j * size + i] /= scale;
        }
        for k in j + 1..size {
            for i in k..size {
                all[k * size + i] -= all[j * size + i] * all[j * size + k];
            }
        }
    }
    all
}

/// Splits a matrix into panel and update matrix.
fn split(matrix: &[f64], size: usize, columns: usize) -> (Vec<f64>, Vec<f64>) {
    let (panel, others) = matrix.split_at(size * columns);
    let update = others.chunks(size).flat_map(|c| &c[columns..]).copied();
    (panel.to_vec(), update.collect())
}

/// Checks that lower halves agree: `found [size, columns]` with columns of the reference, starting at a row and column.
fn assert_lower(found: &[f64], rows: usize, all: &[f64], size: usize, first: usize) {
    for (j, column) in found.chunks(rows).enumerate() {
        for (i, value) in column.iter().enumerate().skip(j) {
            let expected = all[(first + j) * size + first + i];
            assert!(
                (value - expected).abs() < 1e-12,
                "({i}, {j}): {value} {expected}"
            );
        }
    }
}

#[test]
fn factors_are_those_of_the_textbook() {
    for (columns, below, padding) in [(1, 0, 0), (5, 8, 3), (8, 16, 0), (19, 40, 5), (64, 72, 7)] {
        let size = columns + below;
        let matrix = example(size, padding, size as u64);
        let all = reference(&matrix, size, columns);
        for level in Level::available() {
            let (mut panel, mut update) = split(&matrix, size, columns);
            assert!(factorise(level, &mut panel, columns, &mut update));
            assert_lower(&panel, size, &all, size, 0);
            assert_lower(&update, below.max(1), &all, size, columns);
        }
    }
}

#[test]
fn eight_factors_are_those_of_each() {
    for (columns, below) in [(1, 0), (3, 8), (9, 12), (7, 28)] {
        let size = columns + below;
        let matrices: Vec<_> = (0..8).map(|lane| example(size, 0, lane)).collect();
        let parts: Vec<_> = matrices.iter().map(|m| split(m, size, columns)).collect();
        let gather = |part: &dyn Fn(usize) -> Vec<f64>| -> Vec<F64x8> {
            let lanes: Vec<_> = (0..8).map(part).collect();
            (0..lanes[0].len())
                .map(|i| std::array::from_fn(|lane| lanes[lane][i]))
                .collect()
        };
        for level in Level::available() {
            let mut panel = gather(&|lane| parts[lane].0.clone());
            let mut update = gather(&|lane| parts[lane].1.clone());
            assert!(factorise_eight(level, &mut panel, columns, &mut update));
            for (lane, matrix) in matrices.iter().enumerate() {
                let all = reference(matrix, size, columns);
                let own = |list: &[F64x8]| -> Vec<f64> { list.iter().map(|v| v[lane]).collect() };
                assert_lower(&own(&panel), size, &all, size, 0);
                assert_lower(&own(&update), below.max(1), &all, size, columns);
            }
        }
    }
}

#[test]
fn further_rows_are_those_of_the_larger_matrix() {
    for (columns, below, count) in [(3, 8, 8), (21, 24, 40), (40, 0, 16)] {
        let inner = columns + below;
        let size = inner + count;
        let matrix = example(size, 0, size as u64);
        let all = reference(&matrix, size, columns);
        for level in Level::available() {
            let part = |first: usize, rows: usize, columns: std::ops::Range<usize>| -> Vec<f64> {
                let columns = matrix.chunks(size).take(columns.end).skip(columns.start);
                columns
                    .flat_map(|c| &c[first..first + rows])
                    .copied()
                    .collect()
            };
            let (mut panel, mut update) = (part(0, inner, 0..columns), vec![0.0; below * below]);
            assert!(factorise(level, &mut panel, columns, &mut update));
            let mut extra = part(inner, count, 0..columns);
            let mut lower = part(inner, count, columns..inner);
            let mut square = part(inner, count, inner..size);
            solve_rows(level, &panel, columns, &mut extra, &mut lower);
            let rows = MatrixBlock {
                values: &extra,
                stride: count,
            };
            subtract_product(
                level,
                (&mut square, count),
                [count, count, columns],
                rows,
                rows,
            );
            for (list, first) in [(&extra, 0), (&lower, columns)] {
                for (j, column) in list.chunks(count).enumerate() {
                    for (i, value) in column.iter().enumerate() {
                        let expected = all[(first + j) * size + inner + i];
                        assert!((value - expected).abs() < 1e-12, "{value} {expected}");
                    }
                }
            }
            assert_lower(&square, count, &all, size, inner);
        }
    }
}

#[test]
fn what_is_not_positive_definite_is_refused() {
    for level in Level::available() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut panel = example(9, 0, 1);
            panel[4 * 9 + 4] = bad;
            assert!(!factorise(level, &mut panel, 9, &mut []), "{bad}");
            let mut eight: Vec<F64x8> = example(9, 0, 1).into_iter().map(|v| [v; 8]).collect();
            eight[4 * 9 + 4][6] = bad;
            assert!(!factorise_eight(level, &mut eight, 9, &mut []), "{bad}");
        }
    }
}

#[test]
fn lengths_that_do_not_go_together_are_refused() {
    let panics =
        |run: &(dyn Fn() + std::panic::RefUnwindSafe)| std::panic::catch_unwind(run).is_err();
    let level = Level::Portable;
    assert!(panics(&|| {
        factorise(level, &mut [1.0; 7], 2, &mut []);
    }));
    assert!(panics(&|| {
        factorise(level, &mut [1.0; 9], 1, &mut [0.0; 9]);
    }));
    assert!(panics(&|| {
        factorise_eight(level, &mut [[1.0; 8]; 5], 1, &mut [[0.0; 8]; 15]);
    }));
    assert!(panics(&|| {
        solve_rows(level, &[1.0; 9], 1, &mut [0.0; 8], &mut [0.0; 63]);
    }));
    let block = |values| MatrixBlock { values, stride: 8 };
    assert!(panics(&|| {
        let short = block(&[0.0; 15]);
        subtract_product(level, (&mut [0.0; 64], 8), [8, 8, 2], short, short);
    }));
}
