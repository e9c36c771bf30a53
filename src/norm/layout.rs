//! Sums and maps per channel over `[batch, channels, ..]`.
//!
//! Work is cut into the same pieces whatever the number of threads, and sums over pieces run in a
//! fixed order, so results do not depend on the number of threads. Inner loops are compiled for
//! every instruction set and chosen at run time.

use pulp::Arch;
use rayon::prelude::*;

/// A tensor as `[outer, channels, inner]`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    outer: usize,
    channels: usize,
    inner: usize,
}

/// `x * slope + offset`: a normalisation with its gain and shift.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub(super) slope: f32,
    offset: f32,
}

impl Line {
    pub(super) fn of(
        gain: &[f32],
        shift: &[f32],
        mean: &[f32],
        variance: &[f32],
        epsilon: f64,
    ) -> Vec<Self> {
        (0..gain.len())
            .map(|c| {
                let slope = gain[c] / (variance[c] + epsilon as f32).sqrt();
                Self {
                    slope,
                    offset: shift[c] - mean[c] * slope,
                }
            })
            .collect()
    }

    pub(super) fn at(self, x: f32) -> f32 {
        x * self.slope + self.offset
    }
}

/// Rows in one piece of a tensor without inner axes.
const ROWS: usize = 1024;
/// Partial sums kept side by side, for vector units.
const LANES: usize = 16;

impl Layout {
    pub(super) fn of(shape: &[usize]) -> Self {
        Self {
            outer: shape[0],
            channels: shape[1],
            inner: shape[2..].iter().product(),
        }
    }

    /// Values per channel.
    pub(super) fn count(&self) -> usize {
        self.outer * self.inner
    }

    /// Mean and biased variance of each channel.
    pub(super) fn moments(&self, x: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let count = self.count().max(1) as f32;
        let mean: Vec<f32> = self
            .sums(x, x, |_, x, _| (x, 0.0))
            .0
            .iter()
            .map(|s| s / count)
            .collect();
        let squares = self
            .sums(x, x, |c, x, _| ((x - mean[c]) * (x - mean[c]), 0.0))
            .0;
        (mean, squares.iter().map(|s| s / count).collect())
    }

    /// For each channel, the two sums of `f(channel, x, y)` over its values.
    pub(super) fn sums(
        &self,
        x: &[f32],
        y: &[f32],
        f: impl Fn(usize, f32, f32) -> (f32, f32) + Sync,
    ) -> (Vec<f32>, Vec<f32>) {
        let arch = Arch::new();
        let pairs: Vec<(f64, f64)> = if self.inner == 1 {
            self.sums_of_rows(x, y, f)
        } else {
            (0..self.channels)
                .into_par_iter()
                .map(|c| {
                    let mut total = (0.0, 0.0);
                    for b in 0..self.outer {
                        let plane = (b * self.channels + c) * self.inner;
                        let range = plane..plane + self.inner;
                        let (x, y) = (&x[range.clone()], &y[range]);
                        let (s, t) = arch.dispatch(|| sum(x, y, |x, y| f(c, x, y)));
                        total = (total.0 + s, total.1 + t);
                    }
                    total
                })
                .collect()
        };
        pairs.into_iter().map(|(s, t)| (s as f32, t as f32)).unzip()
    }

    fn sums_of_rows(
        &self,
        x: &[f32],
        y: &[f32],
        f: impl Fn(usize, f32, f32) -> (f32, f32) + Sync,
    ) -> Vec<(f64, f64)> {
        let channels = self.channels.max(1);
        let arch = Arch::new();
        let pieces: Vec<(Vec<f32>, Vec<f32>)> = x
            .par_chunks(ROWS * channels)
            .zip(y.par_chunks(ROWS * channels))
            .map(|(x, y)| {
                let (mut first, mut second) = (vec![0.0; channels], vec![0.0; channels]);
                arch.dispatch(|| {
                    for (x, y) in x.chunks_exact(channels).zip(y.chunks_exact(channels)) {
                        let values = x.iter().zip(y).enumerate();
                        let sums = first.iter_mut().zip(&mut second);
                        for ((c, (x, y)), (s, t)) in values.zip(sums) {
                            let (a, b) = f(c, *x, *y);
                            *s += a;
                            *t += b;
                        }
                    }
                });
                (first, second)
            })
            .collect();
        let mut totals = vec![(0.0, 0.0); channels];
        for (first, second) in pieces {
            for (total, (s, t)) in totals.iter_mut().zip(first.iter().zip(&second)) {
                *total = (total.0 + f64::from(*s), total.1 + f64::from(*t));
            }
        }
        totals
    }

    /// `f(channel, x, y)` for every value.
    pub(super) fn map(
        &self,
        x: &[f32],
        y: &[f32],
        f: impl Fn(usize, f32, f32) -> f32 + Sync,
    ) -> Vec<f32> {
        let arch = Arch::new();
        let mut output = vec![0.0; x.len()];
        let (channels, inner) = (self.channels.max(1), self.inner.max(1));
        let piece = if inner == 1 { ROWS * channels } else { inner };
        output
            .par_chunks_mut(piece)
            .zip(x.par_chunks(piece))
            .zip(y.par_chunks(piece))
            .enumerate()
            .for_each(|(i, ((out, x), y))| {
                arch.dispatch(|| {
                    if inner == 1 {
                        let rows = x.chunks_exact(channels).zip(y.chunks_exact(channels));
                        for (out, (x, y)) in out.chunks_exact_mut(channels).zip(rows) {
                            for (c, (out, (x, y))) in
                                out.iter_mut().zip(x.iter().zip(y)).enumerate()
                            {
                                *out = f(c, *x, *y);
                            }
                        }
                    } else {
                        let c = i % channels;
                        for (out, (x, y)) in out.iter_mut().zip(x.iter().zip(y)) {
                            *out = f(c, *x, *y);
                        }
                    }
                });
            });
        output
    }
}

/// The two sums of `f(x, y)`, in f32 over short runs and in f64 between them.
#[inline(always)]
fn sum(x: &[f32], y: &[f32], f: impl Fn(f32, f32) -> (f32, f32)) -> (f64, f64) {
    const RUN: usize = 256 * LANES;
    let mut total = (0.0, 0.0);
    for (x, y) in x.chunks(RUN).zip(y.chunks(RUN)) {
        let (mut first, mut second) = ([0.0_f32; LANES], [0.0_f32; LANES]);
        let (xs, ys) = (x.chunks_exact(LANES), y.chunks_exact(LANES));
        let rest = (xs.remainder(), ys.remainder());
        for (x, y) in xs.zip(ys) {
            for lane in 0..LANES {
                let (s, t) = f(x[lane], y[lane]);
                first[lane] += s;
                second[lane] += t;
            }
        }
        for (lane, (x, y)) in rest.0.iter().zip(rest.1).enumerate() {
            let (s, t) = f(*x, *y);
            first[lane] += s;
            second[lane] += t;
        }
        let add = |lanes: &[f32]| lanes.iter().map(|v| f64::from(*v)).sum::<f64>();
        total = (total.0 + add(&first), total.1 + add(&second));
    }
    total
}
