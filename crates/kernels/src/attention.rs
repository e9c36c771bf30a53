//! Operations of a transformer (Vaswani et al. 2017) other than matrix products: layer normalisation, GELU, and attention.
//!
//! Tokens are rows. Results are the same bits for any number of threads.

use crate::simd::{Level, Packed, Scratch, Shared, Tail};
use rayon::prelude::*;

/// Number of parallel partial sums: the lanes of the longest vector.
const LANES: usize = 16;
/// Queries per task: a multiple of the register tile of every level.
const QUERIES: usize = 84;

/// Normalises each row of `x [rows, channels]` to mean 0 and variance 1, then applies gain and shift (layer
/// normalisation, Ba, Kiros and Hinton 2016).
///
/// # Panics
/// If lengths do not match.
pub fn layer_norm(
    level: Level,
    x: &[f32],
    (gain, shift): (&[f32], &[f32]),
    epsilon: f32,
    output: &mut [f32],
) {
    let channels = gain.len();
    assert!(
        shift.len() == channels && x.len() == output.len(),
        "lengths"
    );
    assert!(channels > 0 && x.len().is_multiple_of(channels), "rows");
    level.vectorised(
        #[inline(always)]
        || {
            let rows = x.chunks_exact(channels);
            for (x, output) in rows.zip(output.chunks_exact_mut(channels)) {
                let mean = sum(x, |v| v) / channels as f32;
                let variance = sum(x, |v| (v - mean) * (v - mean)) / channels as f32;
                let scale = (variance + epsilon).sqrt().recip();
                let terms = x.iter().zip(gain).zip(shift);
                for (output, ((x, gain), shift)) in output.iter_mut().zip(terms) {
                    *output = (x - mean) * scale * gain + shift;
                }
            }
        },
    );
}

/// The Gaussian error linear unit `x P(X <= x)` of a standard normal X (Hendrycks and Gimpel 2016), in place, to
/// 2e-7 of `1 + |x|`.
pub fn gelu(level: Level, values: &mut [f32]) {
    level.vectorised(
        #[inline(always)]
        || {
            for value in values {
                *value *= normal_distribution(*value);
            }
        },
    );
}

/// Attention `softmax(Q K' / sqrt(depth)) V` of each head, for `rows [tokens, 3, heads, depth]` of queries, keys and
/// values, into `output [tokens, heads, depth]`.
///
/// # Panics
/// If lengths do not match.
pub fn attention(
    level: Level,
    rows: &[f32],
    (heads, depth): (usize, usize),
    scratch: &Scratch,
    output: &mut [f32],
) {
    let width = heads * depth;
    assert!(width > 0 && output.len().is_multiple_of(width), "tokens");
    let tokens = output.len() / width;
    assert_eq!(rows.len(), 3 * output.len(), "queries, keys and values");
    if tokens == 0 {
        return;
    }
    let scale = (depth as f32).sqrt().recip();
    let at = |token: usize, which: usize, head: usize, k: usize| {
        rows[token * 3 * width + which * width + head * depth + k]
    };
    let packed: Vec<(Packed, Packed)> = (0..heads)
        .into_par_iter()
        .map(|head| {
            let keys = |k: usize, token: usize| scale * at(token, 1, head, k);
            let values = |token: usize, k: usize| at(token, 2, head, k);
            (
                Packed::new(level, (depth, tokens), &[], keys),
                Packed::new(level, (tokens, depth), &[], values),
            )
        })
        .collect();
    let blocks = tokens.div_ceil(QUERIES);
    let output = Shared::new(output);
    (0..heads * blocks).into_par_iter().for_each(|task| {
        let (head, first) = (task / blocks, task % blocks * QUERIES);
        let count = QUERIES.min(tokens - first);
        let (keys, values) = &packed[head];
        scratch.with(count * (2 * depth + tokens), |memory| {
            let (queries, memory) = memory.split_at_mut(count * depth);
            let (outputs, scores) = memory.split_at_mut(count * depth);
            for (i, query) in queries.chunks_exact_mut(depth).enumerate() {
                let from = (first + i) * 3 * width + head * depth;
                query.copy_from_slice(&rows[from..][..depth]);
            }
            keys.apply(queries, Tail::default(), scores);
            level.vectorised(
                #[inline(always)]
                || {
                    for row in scores.chunks_exact_mut(tokens) {
                        softmax(row);
                    }
                },
            );
            values.apply(scores, Tail::default(), outputs);
            for (i, head_output) in outputs.chunks_exact(depth).enumerate() {
                let place = (first + i) * width + head * depth;
                // SAFETY: each task has its own tokens and head, inside the output.
                let to = unsafe { std::slice::from_raw_parts_mut(output.at(place, depth), depth) };
                to.copy_from_slice(head_output);
            }
        });
    });
}

/// Computes the softmax of a row in place.
#[inline(always)]
fn softmax(row: &mut [f32]) {
    let mut maxima = [f32::NEG_INFINITY; LANES];
    let (chunks, remainder) = row.as_chunks::<LANES>();
    for values in chunks {
        for (max, value) in maxima.iter_mut().zip(values) {
            *max = if *value > *max { *value } else { *max };
        }
    }
    let all = maxima.iter().chain(remainder);
    let max = all.fold(f32::NEG_INFINITY, |a, b| a.max(*b));
    for value in row.iter_mut() {
        *value = exponential(*value - max);
    }
    let scale = sum(row, |v| v).recip();
    for value in row {
        *value *= scale;
    }
}

/// Returns the sum of a function of all values.
#[inline(always)]
fn sum(values: &[f32], of: impl Fn(f32) -> f32) -> f32 {
    let mut sums = [0.0; LANES];
    let (chunks, remainder) = values.as_chunks::<LANES>();
    for values in chunks {
        for (sum, value) in sums.iter_mut().zip(values) {
            *sum += of(*value);
        }
    }
    for (sum, value) in sums.iter_mut().zip(remainder) {
        *sum += of(*value);
    }
    sums.iter().sum()
}

/// Returns `e^x` for x of at most 0, to a relative error of 2e-7, and 0 below the smallest normal number. It has no branch, so
/// that the compiler can vectorise it.
#[inline(always)]
fn exponential(x: f32) -> f32 {
    /// Added to a number up to 2^22, it rounds to the nearest integer, in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    const LEAST: f32 = -87.0;
    // The natural logarithm of 2 in two parts; the first has few bits.
    const HIGH: f32 = 0.693_359_4;
    const LOW: f32 = -2.121_944_4e-4;
    let bounded = if x > LEAST { x } else { LEAST };
    let shifted = bounded * std::f32::consts::LOG2_E + ROUND;
    let whole = shifted - ROUND;
    let remainder = bounded - whole * HIGH - whole * LOW;
    // Taylor's series; |remainder| is at most ln 2 / 2.
    let mut series = 1.0 / 5040.0;
    for factor in [
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
        1.0,
    ] {
        series = series * remainder + factor;
    }
    let power = f32::from_bits((shifted.to_bits() << 23).wrapping_add(127 << 23));
    if x > LEAST { series * power } else { 0.0 }
}

/// Returns the distribution function of the standard normal distribution, to 1e-7 (Abramowitz and Stegun 1964, 7.1.26).
#[inline(always)]
fn normal_distribution(x: f32) -> f32 {
    let z = x.abs() * std::f32::consts::FRAC_1_SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let mut series = 1.061_405_4;
    for factor in [-1.453_152, 1.421_413_8, -0.284_496_74, 0.254_829_6, 0.0] {
        series = series * t + factor;
    }
    let tail = 0.5 * series * exponential(-z * z);
    if x > 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;
    use rayon::ThreadPoolBuilder;

    fn drawn(length: usize) -> Vec<f32> {
        let mut rng = Rng::stream(4, &["attention"]);
        (0..length).map(|_| rng.normal()).collect()
    }

    #[test]
    fn exponentials_are_those_of_the_standard_library() {
        for i in 0..=200_000 {
            let x = -100.0 * i as f32 / 200_000.0;
            let (found, exact) = (exponential(x), f64::from(x).exp());
            if exact > 2e-38 {
                assert!(
                    (f64::from(found) / exact - 1.0).abs() < 3e-7,
                    "{x}: {found}"
                );
            } else {
                assert!(found < 3e-38, "{x}: {found}");
            }
        }
        assert_eq!(exponential(0.0), 1.0);
        assert_eq!(exponential(f32::NEG_INFINITY), 0.0);
    }

    /// Values of x P(X <= x) from tables of the normal distribution.
    #[test]
    fn gelu_is_that_of_the_tables() {
        let cases = [
            (0.0, 0.0),
            (1.0, 0.841_344_8),
            (-1.0, -0.158_655_3),
            (2.0, 1.954_499_7),
            (-3.0, -0.004_049_694),
            (0.5, 0.345_731_23),
            (8.0, 8.0),
            (-12.0, 0.0),
        ];
        for level in Level::available() {
            let mut values: Vec<f32> = cases.iter().map(|case| case.0).collect();
            gelu(level, &mut values);
            for ((x, exact), found) in cases.iter().zip(&values) {
                assert!(
                    (found - exact).abs() < 2e-7 * (1.0 + x.abs()),
                    "{x}: {found}"
                );
            }
        }
    }

    #[test]
    fn rows_are_normalised() {
        const CHANNELS: usize = 37;
        let x = drawn(5 * CHANNELS);
        let (gain, shift) = (drawn(CHANNELS), drawn(CHANNELS + 1)[1..].to_vec());
        for level in Level::available() {
            let mut output = vec![0.0; x.len()];
            layer_norm(level, &x, (&gain, &shift), 1e-6, &mut output);
            for (x, output) in x.chunks(CHANNELS).zip(output.chunks(CHANNELS)) {
                let x: Vec<f64> = x.iter().map(|&v| f64::from(v)).collect();
                let mean = x.iter().sum::<f64>() / CHANNELS as f64;
                let squares = x.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
                let scale = (squares / CHANNELS as f64 + 1e-6).sqrt();
                for (i, found) in output.iter().enumerate() {
                    let exact = (x[i] - mean) / scale * f64::from(gain[i]) + f64::from(shift[i]);
                    assert!((f64::from(*found) - exact).abs() < 1e-5);
                }
            }
        }
    }

    #[test]
    fn attention_is_the_weighted_mean_of_values() {
        for (tokens, heads, depth) in [(1, 1, 1), (7, 2, 5), (130, 3, 16)] {
            let width = heads * depth;
            let rows = drawn(tokens * 3 * width);
            let at = |token: usize, which: usize, column: usize| {
                f64::from(rows[token * 3 * width + which * width + column])
            };
            let mut exact = vec![0.0; tokens * width];
            for head in 0..heads {
                let columns = head * depth..(head + 1) * depth;
                for query in 0..tokens {
                    let score = |key: usize| {
                        let products = columns.clone().map(|k| at(query, 0, k) * at(key, 1, k));
                        (products.sum::<f64>() / (depth as f64).sqrt()).exp()
                    };
                    let scores: Vec<f64> = (0..tokens).map(score).collect();
                    let total: f64 = scores.iter().sum();
                    for column in columns.clone() {
                        let terms = scores.iter().enumerate();
                        let sum: f64 = terms.map(|(key, s)| s * at(key, 2, column)).sum();
                        exact[query * width + column] = sum / total;
                    }
                }
            }
            for level in Level::available() {
                let found = |threads: usize| {
                    let pool = ThreadPoolBuilder::new()
                        .num_threads(threads)
                        .build()
                        .unwrap();
                    let mut output = vec![0.0; tokens * width];
                    pool.install(|| {
                        let scratch = Scratch::new();
                        attention(level, &rows, (heads, depth), &scratch, &mut output);
                    });
                    output
                };
                let one = found(1);
                for (found, exact) in one.iter().zip(&exact) {
                    assert!((f64::from(*found) - exact).abs() < 1e-5);
                }
                assert_eq!(one, found(3));
            }
        }
    }
}
