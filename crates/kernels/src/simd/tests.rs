//! Comparison of products and vectors of every level with plain loops.

use super::{Kernel, Level, Packed, Tail, Vector};
use lsdc_rng::Rng;

fn random(count: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::stream(0, &["simd", name]);
    (0..count).map(|_| rng.normal()).collect()
}

#[test]
fn products_agree_with_plain_loops() {
    for (rows, depth, columns) in [(1, 1, 1), (3, 7, 5), (15, 20, 16), (100, 33, 70), (0, 4, 4)] {
        let (x, weights) = (random(rows * depth, "x"), random(depth * columns, "w"));
        let (bias, skip) = (random(columns, "b"), random(rows * columns, "s"));
        for level in Level::available() {
            let packed = Packed::new(level, (depth, columns), &bias, |r, c| {
                weights[r * columns + c]
            });
            for relu in [false, true] {
                let tail = Tail {
                    skip: Some(&skip),
                    relu,
                };
                let mut alone = vec![f32::NAN; rows * columns];
                packed.apply(&x, tail, &mut alone);
                let mut together = vec![f32::NAN; rows * columns];
                packed.apply_parallel(&x, tail, &mut together);
                assert_eq!(alone, together);
                // Rows with gaps between them.
                let mut apart = vec![f32::NAN; rows * (depth + 3)];
                for (to, from) in apart.chunks_exact_mut(depth + 3).zip(x.chunks_exact(depth)) {
                    to[..depth].copy_from_slice(from);
                }
                packed.apply(&apart, tail, &mut together);
                assert_eq!(alone, together);
                for (i, value) in alone.into_iter().enumerate() {
                    let (row, column) = (i / columns, i % columns);
                    let sum: f64 = (0..depth)
                        .map(|k| {
                            f64::from(x[row * depth + k]) * f64::from(weights[k * columns + column])
                        })
                        .sum();
                    let sum = sum + f64::from(bias[column]) + f64::from(skip[i]);
                    let expected = if relu { sum.max(0.0) } else { sum };
                    assert!((f64::from(value) - expected).abs() < 1e-4, "{level:?}");
                }
            }
        }
    }
}

#[test]
fn zeros_that_are_left_out_change_no_bit() {
    for (rows, depth, columns) in [(1, 1, 1), (15, 20, 16), (84, 128, 70), (0, 4, 4)] {
        let mut x = random(rows * depth, "x");
        let (weights, bias) = (random(depth * columns, "w"), random(columns, "b"));
        // Some values of each row, and whole columns.
        for (i, value) in x.iter_mut().enumerate() {
            let column = i % depth;
            let nothing = if i % 2 == 0 { 0.0 } else { -0.0 };
            if *value < 0.0 || column % 3 == 1 {
                *value = nothing;
            }
        }
        for level in Level::available() {
            let packed = Packed::new(level, (depth, columns), &bias, |r, c| {
                weights[r * columns + c]
            });
            let mut all = vec![f32::NAN; rows * columns];
            packed.apply(&x, Tail::default(), &mut all);
            let mut some = vec![f32::NAN; rows * columns];
            packed.apply_sparse(&x, Tail::default(), &mut some);
            assert_eq!(all, some, "{level:?}");
        }
    }
}

#[test]
fn the_relu_of_nan_is_0() {
    for level in Level::available() {
        let packed = Packed::new(level, (1, 1), &[], |_, _| 1.0);
        let tail = Tail {
            skip: None,
            relu: true,
        };
        let mut output = vec![f32::NAN; 3];
        packed.apply(&[f32::NAN, -1.0, 2.0], tail, &mut output);
        assert_eq!(output, [0.0, 0.0, 2.0], "{level:?}");
    }
}

struct Everything<'a>(&'a [f32], &'a [f32]);

impl Kernel for Everything<'_> {
    type Output = Vec<Vec<f32>>;

    unsafe fn run<V: Vector>(self) -> Self::Output {
        // SAFETY: both slices have 16 floats, the longest vector's length.
        unsafe {
            let (a, b) = (V::load(self.0.as_ptr()), V::load(self.1.as_ptr()));
            let results = [
                V::splat(3.0),
                a.add(b),
                a.sub(b),
                a.mul(b),
                a.max(b),
                a.mul_add(b, a),
                a.where_positive(b),
                V::load_some(self.0.as_ptr(), 3),
                V::splat(a.total()),
            ];
            let store = |v: V| {
                let mut values = vec![0.0; V::LANES];
                v.store(values.as_mut_ptr());
                let mut some = vec![0.0; V::LANES];
                v.store_some(some.as_mut_ptr(), 5);
                assert_eq!(values[..5], some[..5]);
                assert!(some[5..].iter().all(|s| *s == 0.0));
                values
            };
            results.into_iter().map(store).collect()
        }
    }
}

#[test]
fn vectors_do_what_floats_do() {
    let (a, b) = (random(16, "a"), random(16, "b"));
    for level in Level::available() {
        // SAFETY: the kernel's slices are long enough.
        let results = unsafe { level.run(Everything(&a, &b)) };
        let lanes = level.lanes();
        let total: f32 = a[..lanes].iter().sum();
        for i in 0..lanes {
            let (x, y) = (a[i], b[i]);
            let expected = [
                3.0,
                x + y,
                x - y,
                x * y,
                x.max(y),
                x * y + x,
                if y > 0.0 { x } else { 0.0 },
                if i < 3 { x } else { 0.0 },
                total,
            ];
            for (result, expected) in results.iter().zip(expected) {
                assert!((result[i] - expected).abs() < 1e-5, "{level:?} {i}");
            }
        }
    }
}
