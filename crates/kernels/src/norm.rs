//! Per-channel sums and maps of `[rows, channels]`.
//!
//! Work is divided into the same pieces for any number of threads, and pieces are summed in a fixed order, so results do not
//! depend on the number of threads.

use crate::check_rows;
use crate::schedule::InTasks;
use crate::simd::{Kernel, Level, Shared, Unset, Vector, written};
use rayon::prelude::*;

/// Floats per piece: it is read twice, so it should fit second-level caches.
const PIECE: usize = 1 << 16;

/// Returns the number of floats of the whole rows of one piece.
fn piece(channels: usize) -> usize {
    (PIECE / channels.max(1)).max(1) * channels.max(1)
}

/// `x * slope + offset` per channel, as a normalisation with its gain and shift.
#[derive(Clone, Debug)]
pub struct ChannelAffine {
    slope: Vec<f32>,
    offset: Vec<f32>,
}

impl ChannelAffine {
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

    /// The slope of each channel.
    pub fn slopes(&self) -> &[f32] {
        &self.slope
    }

    /// The offset of each channel.
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

/// Mean and biased variance of each channel of `x [rows, channels]`.
///
/// # Panics
/// If `x` is not rows of `channels`.
pub fn moments(x: &[f32], channels: usize) -> (Vec<f32>, Vec<f32>) {
    check_rows(x, channels);
    let mut mean = vec![0.0_f64; channels];
    let mut squares = vec![0.0_f64; channels];
    let mut rows = 0.0;
    let pieces: Vec<_> = pieces(x, channels)
        .map(|piece| {
            let count = (piece.len() / channels) as f32;
            let sum = sums(piece, channels, Term::Values).0;
            let mean: Vec<f32> = sum.iter().map(|s| s / count).collect();
            let squares = sums(piece, channels, Term::Squares { mean: &mean }).1;
            (f64::from(count), mean, squares)
        })
        .collect();
    // The parallel update of Chan, Golub and LeVeque 1979.
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

/// `x [rows, channels]` normalised, with a ReLU if `relu` is set.
///
/// # Panics
/// If `x` is not rows of the channels of `affine`.
pub fn normalise(x: &[f32], affine: &ChannelAffine, relu: bool) -> Vec<f32> {
    let operation = Operation::Normalise { affine, relu };
    map(x, x, affine.slope.len(), operation)
}

/// The parameters of a forward pass, for the backward pass.
#[derive(Clone, Copy)]
pub struct Backward<'a> {
    /// The normalisation with gain and shift.
    pub affine: &'a ChannelAffine,
    /// The normalisation without gain and shift, with the same number of channels.
    pub standard: &'a ChannelAffine,
    /// Whether a ReLU followed.
    pub relu: bool,
}

impl Backward<'_> {
    /// Checks all lengths, and returns the number of channels.
    fn check(&self, x: &[f32], grad: &[f32]) -> usize {
        let channels = self.affine.slope.len();
        assert_eq!(self.standard.slope.len(), channels, "channels");
        assert_eq!(x.len(), grad.len(), "gradient");
        check_rows(x, channels);
        channels
    }

    /// The gradients of gain and shift.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn parameter_gradients(&self, x: &[f32], grad: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let channels = self.check(x, grad);
        let parts: Vec<_> = pieces(x, channels)
            .zip(pieces(grad, channels))
            .map(|(x, grad)| sums(x, channels, Term::Gradients { back: *self, grad }))
            .collect();
        let (shifts, gains): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
        (total(gains, channels), total(shifts, channels))
    }

    /// The gradient of the input; `statistics` is its part that passes through the statistics, an affine function of the
    /// normalised input.
    ///
    /// # Panics
    /// If lengths do not match.
    pub fn input_gradient(
        &self,
        x: &[f32],
        grad: &[f32],
        statistics: Option<&ChannelAffine>,
    ) -> Vec<f32> {
        let channels = self.check(x, grad);
        assert!(statistics.is_none_or(|affine| affine.slope.len() == channels));
        let operation = Operation::Backward {
            back: *self,
            statistics,
        };
        map(x, grad, channels, operation)
    }

    /// The `statistics` of [`Self::input_gradient`] if the statistics are those of the input itself, from the gradients of gain
    /// and shift over `rows` rows.
    ///
    /// # Panics
    /// If the numbers of gains and shifts differ.
    pub fn through_statistics(gain_grad: &[f32], shift_grad: &[f32], rows: usize) -> ChannelAffine {
        assert_eq!(gain_grad.len(), shift_grad.len(), "channels");
        let share = |v: &[f32]| v.iter().map(|v| v / rows as f32).collect();
        ChannelAffine {
            slope: share(gain_grad),
            offset: share(shift_grad),
        }
    }

    /// # Safety
    /// As for `ChannelAffine::at`.
    #[inline(always)]
    unsafe fn through_relu<V: Vector>(&self, x: V, grad: V, c: usize, count: usize) -> V {
        // SAFETY: as demanded from the caller.
        unsafe {
            if self.relu {
                grad.where_positive(self.affine.at(x, c, count))
            } else {
                grad
            }
        }
    }
}

/// The gradient of the input of a ReLU from its `outputs [rows, channels]` and their gradient `grad`, and its sums over the
/// rows, per channel.
///
/// # Panics
/// If `grad` is not rows of `channels`, or the number of outputs differs.
pub fn relu_gradient(outputs: &[f32], grad: &[f32], channels: usize) -> (Vec<f32>, Vec<f32>) {
    check_rows(grad, channels);
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
                operation: Operation::Relu,
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
    // SAFETY: the pieces cover the whole slice.
    let gradient = unsafe { written(grad.len(), write) };
    (gradient, total(parts, channels))
}

/// The sums of `x [rows, channels]` over the rows, per channel.
///
/// # Panics
/// If `x` is not rows of `channels`.
pub fn row_sums(x: &[f32], channels: usize) -> Vec<f32> {
    check_rows(x, channels);
    let parts = pieces(x, channels).map(|piece| sums(piece, channels, Term::Values).0);
    total(parts.collect(), channels)
}

/// Returns the total of the sums of pieces, in their order.
fn total(parts: Vec<Vec<f32>>, channels: usize) -> Vec<f32> {
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

/// The terms of the sums over the rows of a piece.
#[derive(Clone, Copy)]
enum Term<'a> {
    /// x.
    Values,
    /// x, and (x - mean)^2.
    Squares { mean: &'a [f32] },
    /// The gradient of the input of the ReLU, and its product with the normalised input.
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
        // SAFETY: as demanded from the caller; columns are below `channels`.
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
    /// Adds the sums of `N` vectors of channels.
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
                            let grad = back.through_relu(x, grad, c, count);
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

/// An operation on each value x, with a corresponding value y.
#[derive(Clone, Copy)]
enum Operation<'a> {
    Normalise {
        affine: &'a ChannelAffine,
        relu: bool,
    },
    Backward {
        back: Backward<'a>,
        statistics: Option<&'a ChannelAffine>,
    },
    /// y where x is above 0.
    Relu,
}

fn map(x: &[f32], y: &[f32], channels: usize, operation: Operation<'_>) -> Vec<f32> {
    check_rows(x, channels);
    let piece = piece(channels);
    let write = |output: &mut Unset| {
        let inputs = x.par_chunks(piece).zip(y.par_chunks(piece));
        let outputs = output.par_chunks_mut(piece);
        outputs.zip(inputs).each(|(output, (x, y))| {
            let kernel = Mapping {
                x,
                y,
                channels,
                operation,
                output: Shared::unset(output),
            };
            // SAFETY: all slices have the lengths that the kernel relies on.
            unsafe { Level::here().run(kernel) }
        });
    };
    // SAFETY: the pieces cover the whole slice.
    unsafe { written(x.len(), write) }
}

struct Mapping<'a> {
    x: &'a [f32],
    y: &'a [f32],
    channels: usize,
    operation: Operation<'a>,
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
                    let value = match self.operation {
                        Operation::Normalise { affine, relu } => {
                            let value = affine.at(x, c, count);
                            if relu {
                                value.max(V::splat(0.0))
                            } else {
                                value
                            }
                        }
                        Operation::Relu => {
                            let grad = V::load_some(self.y.as_ptr().add(row + c), count);
                            grad.where_positive(x)
                        }
                        Operation::Backward { back, statistics } => {
                            let grad = V::load_some(self.y.as_ptr().add(row + c), count);
                            let mut grad = back.through_relu(x, grad, c, count);
                            if let Some(statistics) = statistics {
                                let x = back.standard.at(x, c, count);
                                grad = grad.sub(statistics.at(x, c, count));
                            }
                            grad.mul(V::load_some(back.affine.slope.as_ptr().add(c), count))
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
        let affine = || ChannelAffine::new(&[1.0; 4], &[0.0; 4], &[0.0; 4], &[1.0; 4], 1e-5);
        assert_eq!(normalise(&[2.0; 8], &affine(), false).len(), 8);
        assert!(refused(|| drop(ChannelAffine::new(
            &[1.0; 4], &[0.0; 3], &[0.0; 4], &[1.0; 4], 1e-5
        ))));
        assert!(refused(|| {
            let affine = ChannelAffine::new(&[1.0; 4], &[0.0; 4], &[0.0; 4], &[1.0; 4], 1e-5);
            drop(normalise(&[2.0; 9], &affine, false));
        }));
        assert!(refused(|| drop(moments(&[1.0; 7], 3))));
        assert!(refused(|| drop(moments(&[1.0; 7], 0))));
    }
}
