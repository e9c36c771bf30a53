//! Sums and maps per channel over `[rows, channels]`.
//!
//! Work is cut into the same pieces whatever the number of threads, and pieces are summed in a
//! fixed order, so results do not depend on the number of threads.

use crate::schedule::InTasks;
use crate::simd::{Kernel, Level, Shared, Unset, Vector, written};
use rayon::prelude::*;

/// Floats of one piece: it is read twice, so it should fit second-level caches.
const PIECE: usize = 1 << 16;

/// Floats of the whole rows of one piece.
fn piece(channels: usize) -> usize {
    (PIECE / channels.max(1)).max(1) * channels.max(1)
}

/// `x * slope + offset` per channel: a normalisation with its gain and shift.
#[derive(Clone, Debug)]
pub struct Lines {
    slope: Vec<f32>,
    offset: Vec<f32>,
}

impl Lines {
    /// `(x - mean) / sqrt(variance + epsilon) * gain + shift`.
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn new(gain: &[f32], shift: &[f32], mean: &[f32], variance: &[f32], epsilon: f64) -> Self {
        let channels = gain.len();
        let lengths = [shift.len(), mean.len(), variance.len()];
        assert_eq!(lengths, [channels; 3], "channels");
        let deviations = variance.iter().map(|v| (v + epsilon as f32).sqrt());
        let slope: Vec<f32> = gain.iter().zip(deviations).map(|(g, d)| g / d).collect();
        let terms = shift.iter().zip(mean).zip(&slope);
        Self {
            offset: terms.map(|((shift, mean), s)| shift - mean * s).collect(),
            slope,
        }
    }

    /// The normalisation alone, with gain 1 and shift 0.
    pub fn standard(mean: &[f32], variance: &[f32], epsilon: f64) -> Self {
        let (ones, zeros) = (vec![1.0; mean.len()], vec![0.0; mean.len()]);
        Self::new(&ones, &zeros, mean, variance, epsilon)
    }

    /// What is multiplied by, per channel.
    pub fn slopes(&self) -> &[f32] {
        &self.slope
    }

    /// What is added then, per channel.
    pub fn offsets(&self) -> &[f32] {
        &self.offset
    }

    /// # Safety
    /// As for `Vector`; there are `count` channels from `c` on.
    #[inline(always)]
    unsafe fn at<V: Vector>(&self, x: V, c: usize, count: usize) -> V {
        // SAFETY: as demanded from the caller.
        unsafe {
            let slope = V::load_some(self.slope.as_ptr().add(c), count);
            x.mul_add(slope, V::load_some(self.offset.as_ptr().add(c), count))
        }
    }
}

/// Whether `x` is rows of that many channels.
fn check(x: &[f32], channels: usize) {
    assert!(
        x.is_empty() || (channels > 0 && x.len().is_multiple_of(channels)),
        "{} values are not rows of {channels} channels",
        x.len()
    );
}

/// Mean and biased variance of each channel of `x [rows, channels]`.
///
/// # Panics
/// If `x` is not rows of `channels`.
pub fn moments(x: &[f32], channels: usize) -> (Vec<f32>, Vec<f32>) {
    check(x, channels);
    let mut mean = vec![0.0_f64; channels];
    let mut squares = vec![0.0_f64; channels];
    let mut rows = 0.0;
    let pieces: Vec<_> = pieces(x, channels)
        .map(|piece| {
            let zero = vec![0.0; channels];
            let count = (piece.len() / channels) as f32;
            let sum = sums(piece, channels, Term::Squares { mean: &zero }).0;
            let mean: Vec<f32> = sum.iter().map(|s| s / count).collect();
            let squares = sums(piece, channels, Term::Squares { mean: &mean }).1;
            (f64::from(count), mean, squares)
        })
        .collect();
    // The update of Chan, Golub and LeVeque 1979.
    for (count, piece_mean, piece_squares) in pieces {
        let total = rows + count;
        for c in 0..channels {
            let delta = f64::from(piece_mean[c]) - mean[c];
            mean[c] += delta * count / total;
            squares[c] += f64::from(piece_squares[c]) + delta * delta * rows * count / total;
        }
        rows = total;
    }
    let rows = rows.max(1.0);
    (
        mean.into_iter().map(|m| m as f32).collect(),
        squares.into_iter().map(|s| (s / rows) as f32).collect(),
    )
}

/// `x [rows, channels]` normalised, cut off below 0 if asked for.
///
/// # Panics
/// If `x` is not rows of the channels of `lines`.
pub fn normalise(x: &[f32], lines: &Lines, relu: bool) -> Vec<f32> {
    let job = Map::Normalise { lines, relu };
    map(x, x, lines.slope.len(), job)
}

/// A backward pass: what it needs to know of the forward one.
#[derive(Clone, Copy)]
pub struct Backward<'a> {
    /// The normalisation with gain and shift.
    pub lines: &'a Lines,
    /// The normalisation alone, of as many channels.
    pub standard: &'a Lines,
    /// Whether a ReLU followed.
    pub relu: bool,
}

impl Backward<'_> {
    /// As many channels as `lines` has, in rows of `x` and as many of `grad`.
    fn check(&self, x: &[f32], grad: &[f32]) -> usize {
        let channels = self.lines.slope.len();
        assert_eq!(self.standard.slope.len(), channels, "channels");
        assert_eq!(x.len(), grad.len(), "gradient");
        check(x, channels);
        channels
    }

    /// The gradients of gain and shift.
    ///
    /// # Panics
    /// If lengths do not go together.
    pub fn sums(&self, x: &[f32], grad: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let channels = self.check(x, grad);
        let piece = piece(channels);
        let parts: Vec<_> = pieces(x, channels)
            .zip(grad.par_chunks(piece))
            .map(|(x, grad)| sums(x, channels, Term::Gradients { back: *self, grad }))
            .collect();
        let mut totals = (vec![0.0_f64; channels], vec![0.0_f64; channels]);
        for (shift, gain) in parts {
            let add = |to: &mut [f64], from: Vec<f32>| {
                to.iter_mut()
                    .zip(from)
                    .for_each(|(t, v)| *t += f64::from(v));
            };
            add(&mut totals.0, shift);
            add(&mut totals.1, gain);
        }
        let narrow = |v: Vec<f64>| v.into_iter().map(|v| v as f32).collect();
        (narrow(totals.1), narrow(totals.0))
    }

    /// The gradient of the input; `common` are the parts that come through the statistics, per row:
    /// a constant and a multiple of the normalised input.
    ///
    /// # Panics
    /// If lengths do not go together.
    pub fn input(&self, x: &[f32], grad: &[f32], common: Option<&Lines>) -> Vec<f32> {
        let channels = self.check(x, grad);
        assert!(common.is_none_or(|common| common.slope.len() == channels));
        let job = Map::Backward {
            back: *self,
            common,
        };
        map(x, grad, channels, job)
    }

    /// What `input` needs for statistics of the input itself, from the sums over `rows` rows.
    ///
    /// # Panics
    /// If there are not as many gains as shifts.
    pub fn common(gain_grad: &[f32], shift_grad: &[f32], rows: usize) -> Lines {
        assert_eq!(gain_grad.len(), shift_grad.len(), "channels");
        let share = |v: &[f32]| v.iter().map(|v| v / rows as f32).collect();
        Lines {
            slope: share(gain_grad),
            offset: share(shift_grad),
        }
    }

    /// # Safety
    /// As for `Lines::at`.
    #[inline(always)]
    unsafe fn passed<V: Vector>(&self, x: V, grad: V, c: usize, count: usize) -> V {
        // SAFETY: as demanded from the caller.
        unsafe {
            if self.relu {
                grad.where_positive(self.lines.at(x, c, count))
            } else {
                grad
            }
        }
    }
}

/// Where the `outputs [rows, channels]` of a ReLU are above 0, their gradient `grad`, else 0; and the sums of that over
/// the rows, per channel.
///
/// # Panics
/// If `grad` is not rows of `channels`, or there are not as many outputs.
pub fn passed(outputs: &[f32], grad: &[f32], channels: usize) -> (Vec<f32>, Vec<f32>) {
    check(grad, channels);
    assert_eq!(outputs.len(), grad.len(), "gradient");
    let size = piece(channels);
    let mut parts = Vec::new();
    let write = |to: &mut Unset| {
        let from = grad.par_chunks(size).zip(outputs.par_chunks(size));
        let part = |(to, (grad, outputs)): (&mut Unset, (&[f32], &[f32]))| {
            let kernel = Mapping {
                x: outputs,
                y: grad,
                channels,
                job: Map::Passed,
                output: Shared::unset(to),
            };
            // SAFETY: all slices have the lengths that the kernel relies on, and it sets every float.
            let to = unsafe {
                Level::here().run(kernel);
                std::slice::from_raw_parts(to.as_ptr().cast(), to.len())
            };
            sums(to, channels, Term::Values).0
        };
        parts = to.par_chunks_mut(size).zip(from).map(part).collect();
    };
    // SAFETY: the pieces make up the whole.
    let passed = unsafe { written(grad.len(), write) };
    (passed, added(parts, channels))
}

/// The sums of `x [rows, channels]` over the rows, per channel.
///
/// # Panics
/// If `x` is not rows of `channels`.
pub fn row_sums(x: &[f32], channels: usize) -> Vec<f32> {
    check(x, channels);
    let parts = pieces(x, channels).map(|piece| sums(piece, channels, Term::Values).0);
    added(parts.collect(), channels)
}

/// The sums of pieces, in their order.
fn added(parts: Vec<Vec<f32>>, channels: usize) -> Vec<f32> {
    let mut totals = vec![0.0_f64; channels];
    for part in parts {
        let pairs = totals.iter_mut().zip(part);
        pairs.for_each(|(total, value)| *total += f64::from(value));
    }
    totals.into_iter().map(|total| total as f32).collect()
}

fn pieces(x: &[f32], channels: usize) -> impl IndexedParallelIterator<Item = &[f32]> {
    x.par_chunks(piece(channels))
}

/// What is summed over the rows of a piece.
#[derive(Clone, Copy)]
enum Term<'a> {
    /// x.
    Values,
    /// x, and (x - mean)^2.
    Squares { mean: &'a [f32] },
    /// The gradient that passed the ReLU, and that times the normalised input.
    Gradients { back: Backward<'a>, grad: &'a [f32] },
}

/// Two sums per channel over the rows of one piece.
fn sums(x: &[f32], channels: usize, term: Term<'_>) -> (Vec<f32>, Vec<f32>) {
    let mut first = vec![0.0; channels];
    let mut second = vec![0.0; channels];
    let kernel = Sums {
        x,
        channels,
        term,
        first: &mut first,
        second: &mut second,
    };
    // SAFETY: all slices have the lengths that the kernel relies on.
    unsafe { Level::here().run(kernel) };
    (first, second)
}

struct Sums<'a> {
    x: &'a [f32],
    channels: usize,
    term: Term<'a>,
    first: &'a mut [f32],
    second: &'a mut [f32],
}

impl Kernel for Sums<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(mut self) {
        let mut c = 0;
        // SAFETY: as demanded from the caller; columns lie below `channels`.
        unsafe {
            while c + 4 * V::LANES <= self.channels {
                self.columns::<V, 4>(c);
                c += 4 * V::LANES;
            }
            while c < self.channels {
                self.columns::<V, 1>(c);
                c += V::LANES;
            }
        }
    }
}

impl Sums<'_> {
    /// The sums of `N` vectors of channels.
    #[inline(always)]
    unsafe fn columns<V: Vector, const N: usize>(&mut self, start: usize) {
        // SAFETY: as demanded from the caller.
        unsafe {
            let mut sums = [[V::splat(0.0); 2]; N];
            for row in (0..self.x.len()).step_by(self.channels) {
                for (i, sum) in sums.iter_mut().enumerate() {
                    let c = start + i * V::LANES;
                    let count = self.channels - c;
                    let x = V::load_some(self.x.as_ptr().add(row + c), count);
                    match self.term {
                        Term::Values => sum[0] = sum[0].add(x),
                        Term::Squares { mean } => {
                            let off = x.sub(V::load_some(mean.as_ptr().add(c), count));
                            sum[0] = sum[0].add(x);
                            sum[1] = off.mul_add(off, sum[1]);
                        }
                        Term::Gradients { back, grad } => {
                            let grad = V::load_some(grad.as_ptr().add(row + c), count);
                            let grad = back.passed(x, grad, c, count);
                            sum[0] = sum[0].add(grad);
                            sum[1] = grad.mul_add(back.standard.at(x, c, count), sum[1]);
                        }
                    }
                }
            }
            for (i, sum) in sums.into_iter().enumerate() {
                let c = start + i * V::LANES;
                let count = self.channels - c;
                sum[0].store_some(self.first.as_mut_ptr().add(c), count);
                sum[1].store_some(self.second.as_mut_ptr().add(c), count);
            }
        }
    }
}

/// What becomes of each value.
#[derive(Clone, Copy)]
enum Map<'a> {
    Normalise {
        lines: &'a Lines,
        relu: bool,
    },
    Backward {
        back: Backward<'a>,
        common: Option<&'a Lines>,
    },
    /// y where x is above 0.
    Passed,
}

fn map(x: &[f32], y: &[f32], channels: usize, job: Map<'_>) -> Vec<f32> {
    check(x, channels);
    let piece = piece(channels);
    let write = |output: &mut Unset| {
        let inputs = x.par_chunks(piece).zip(y.par_chunks(piece));
        let outputs = output.par_chunks_mut(piece);
        outputs.zip(inputs).each(|(output, (x, y))| {
            let kernel = Mapping {
                x,
                y,
                channels,
                job,
                output: Shared::unset(output),
            };
            // SAFETY: all slices have the lengths that the kernel relies on.
            unsafe { Level::here().run(kernel) }
        });
    };
    // SAFETY: the pieces make up the whole.
    unsafe { written(x.len(), write) }
}

struct Mapping<'a> {
    x: &'a [f32],
    y: &'a [f32],
    channels: usize,
    job: Map<'a>,
    output: Shared<'a>,
}

impl Kernel for Mapping<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        for row in (0..self.x.len()).step_by(self.channels) {
            for c in (0..self.channels).step_by(V::LANES) {
                let count = self.channels - c;
                // SAFETY: rows have `channels` floats.
                unsafe {
                    let x = V::load_some(self.x.as_ptr().add(row + c), count);
                    let value = match self.job {
                        Map::Normalise { lines, relu } => {
                            let value = lines.at(x, c, count);
                            if relu {
                                value.max(V::splat(0.0))
                            } else {
                                value
                            }
                        }
                        Map::Passed => {
                            let grad = V::load_some(self.y.as_ptr().add(row + c), count);
                            grad.where_positive(x)
                        }
                        Map::Backward { back, common } => {
                            let grad = V::load_some(self.y.as_ptr().add(row + c), count);
                            let mut grad = back.passed(x, grad, c, count);
                            if let Some(common) = common {
                                let x = back.standard.at(x, c, count);
                                grad = grad.sub(common.at(x, c, count));
                            }
                            grad.mul(V::load_some(back.lines.slope.as_ptr().add(c), count))
                        }
                    };
                    let to = self.output.at(row + c, count.min(V::LANES));
                    value.store_some(to, count);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_that_do_not_go_together_are_refused() {
        let refused = |run: fn()| std::panic::catch_unwind(run).is_err();
        let lines = || Lines::new(&[1.0; 4], &[0.0; 4], &[0.0; 4], &[1.0; 4], 1e-5);
        assert_eq!(normalise(&[2.0; 8], &lines(), false).len(), 8);
        assert!(refused(|| drop(Lines::new(
            &[1.0; 4], &[0.0; 3], &[0.0; 4], &[1.0; 4], 1e-5
        ))));
        assert!(refused(|| {
            let lines = Lines::new(&[1.0; 4], &[0.0; 4], &[0.0; 4], &[1.0; 4], 1e-5);
            drop(normalise(&[2.0; 9], &lines, false));
        }));
        assert!(refused(|| drop(moments(&[1.0; 7], 3))));
        assert!(refused(|| drop(moments(&[1.0; 7], 0))));
    }
}
