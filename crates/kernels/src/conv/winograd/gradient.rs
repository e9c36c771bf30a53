//! The gradient of the weights, in the frequency domain too: a quarter of the products.
//!
//! Sums over tiles run in a fixed order, whatever the number of threads.

use super::{IN, Images, OUT, SPECTRUM, Tile, frequency_stride, tiles, transform};
use crate::simd::{Kernel, Level, Rows, Scratch, Shared, Vector, product};
use rayon::prelude::*;

/// Tiles of one task of the transforms; their spectra lie together.
const TILES: usize = 64;

/// The gradient of weights `[channels, 3, 3, outputs]` from inputs
/// `x [batch, height, width, channels]` and the gradient of outputs
/// `grad [batch, height, width, outputs]`.
pub(in crate::conv) fn weight_gradient(
    level: Level,
    x: &[f32],
    grad: &[f32],
    size: [usize; 3],
    (channels, outputs): (usize, usize),
    dilation: usize,
    scratch: &Scratch,
) -> Vec<f32> {
    let pixels = size.iter().product::<usize>();
    assert_eq!(x.len(), pixels * channels, "input");
    assert_eq!(grad.len(), pixels * outputs, "gradient");
    let width = 2 * level.lanes();
    let tiles = tiles(size, dilation);
    let (inputs, grads) = (
        channels.next_multiple_of(level.lanes()),
        outputs.next_multiple_of(width),
    );
    let zeros = vec![0.0; inputs.max(grads)];
    let images = |values, channels| Images {
        values,
        size,
        channels,
        dilation,
        zeros: &zeros,
    };
    let blocks = tiles.len().div_ceil(TILES);
    let block = |row: usize| blocks * frequency_stride(TILES, row);
    let lengths = [block(inputs), block(grads), channels * grads];
    let lengths = lengths.map(|length| SPECTRUM * length);
    let mut weights = vec![0.0; 9 * channels * outputs];
    scratch.with_whole(lengths.iter().sum(), |memory| {
        let (x_spectrum, memory) = memory.split_at_mut(lengths[0]);
        let (grad_spectrum, spectrum) = memory.split_at_mut(lengths[1]);
        let (x_shared, grad_shared) = (Shared::new(x_spectrum), Shared::new(grad_spectrum));
        tiles.par_chunks(TILES).enumerate().for_each(|(i, part)| {
            let kernel = Transform {
                x: (images(x, channels), x_shared, inputs),
                grad: (images(grad, outputs), grad_shared, grads),
                first: i * TILES,
                part,
            };
            // SAFETY: lengths were asserted; each tile has its own rows.
            unsafe { level.run(kernel) }
        });

        let shared = Shared::new(spectrum);
        let panels = grads / width;
        (0..SPECTRUM * panels).into_par_iter().for_each(|task| {
            let kernel = Correlate {
                x: (x_spectrum, channels, inputs),
                grad: (grad_spectrum, grads),
                tiles: tiles.len(),
                frequency: task / panels,
                first: task % panels * width,
                spectrum: shared,
            };
            // SAFETY: each task writes its own columns of its frequency.
            unsafe { level.run(kernel) }
        });

        let shared = Shared::new(&mut weights);
        (0..channels).into_par_iter().for_each(|channel| {
            let kernel = Inverse {
                spectrum,
                grads,
                channels,
                outputs,
                channel,
                weights: shared,
            };
            // SAFETY: each channel writes its own rows.
            unsafe { level.run(kernel) }
        });
    });
    weights
}

/// Takes tiles of inputs and of gradients to the frequency domain, `[frequency][tile][padded]`.
struct Transform<'a> {
    x: (Images<'a>, Shared<'a>, usize),
    grad: (Images<'a>, Shared<'a>, usize),
    first: usize,
    part: &'a [Tile],
}

impl Kernel for Transform<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let (images, spectrum, padded) = self.x;
        let (grads, grad_spectrum, grad_padded) = self.grad;
        for (t, &tile) in self.part.iter().enumerate() {
            let block = self.first / TILES * SPECTRUM;
            // SAFETY: both spectra have a padded row for each frequency and tile.
            unsafe {
                let window = images.window::<IN>(tile, 1);
                images.spectrum::<V, IN>(
                    &window,
                    padded,
                    #[inline(always)]
                    |d| transform::input(d),
                    #[inline(always)]
                    |c, f, value| {
                        let at = (block + f) * frequency_stride(TILES, padded) + t * padded + c;
                        value.store(spectrum.at(at, V::LANES));
                    },
                );
                let window = grads.window::<OUT>(tile, 0);
                grads.spectrum::<V, OUT>(
                    &window,
                    grad_padded,
                    #[inline(always)]
                    |y| transform::output_adjoint(y),
                    #[inline(always)]
                    |c, f, value| {
                        let stride = frequency_stride(TILES, grad_padded);
                        let at = (block + f) * stride + t * grad_padded + c;
                        value.store(grad_spectrum.at(at, V::LANES));
                    },
                );
            }
        }
    }
}

/// The sum over tiles of inputs times gradients, for one frequency and one panel of outputs.
struct Correlate<'a> {
    /// Values, channels and padded channels.
    x: (&'a [f32], usize, usize),
    /// Values and padded channels.
    grad: (&'a [f32], usize),
    tiles: usize,
    frequency: usize,
    first: usize,
    /// `[frequency][channel][padded output]`
    spectrum: Shared<'a>,
}

impl Kernel for Correlate<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let (x, channels, padded) = self.x;
        let (grad, columns) = self.grad;
        for first in (0..self.tiles).step_by(TILES) {
            let count = TILES.min(self.tiles - first);
            let block = first / TILES * SPECTRUM + self.frequency;
            // SAFETY: both spectra have a padded row for each frequency and tile.
            unsafe {
                let rows = Rows {
                    pointer: x.as_ptr().add(block * frequency_stride(TILES, padded)),
                    row: 1,
                    step: padded,
                };
                let grad = grad.as_ptr();
                let grad = grad.add(block * frequency_stride(TILES, columns) + self.first);
                product::<V>(
                    rows,
                    channels,
                    count,
                    grad,
                    columns,
                    #[inline(always)]
                    |c, sums| {
                        let at = (self.frequency * channels + c) * columns + self.first;
                        let to = self.spectrum.at(at, 2 * V::LANES);
                        let right = to.add(V::LANES);
                        if first == 0 {
                            sums[0].store(to);
                            sums[1].store(right);
                        } else {
                            V::load(to).add(sums[0]).store(to);
                            V::load(right).add(sums[1]).store(right);
                        }
                    },
                );
            }
        }
    }
}

/// Takes the gradient of the spectrum of one channel's filters back to their taps.
struct Inverse<'a> {
    spectrum: &'a [f32],
    grads: usize,
    channels: usize,
    outputs: usize,
    channel: usize,
    weights: Shared<'a>,
}

impl Kernel for Inverse<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        for o in (0..self.outputs).step_by(V::LANES) {
            // SAFETY: rows of the spectrum are padded; only channels below `outputs` are written.
            unsafe {
                let mut rows = [[V::splat(0.0); 3]; IN];
                for (i, row) in rows.iter_mut().enumerate() {
                    *row = transform::filter_adjoint(std::array::from_fn(
                        #[inline(always)]
                        |j| {
                            let row = (i * IN + j) * self.channels + self.channel;
                            V::load(self.spectrum.as_ptr().add(row * self.grads + o))
                        },
                    ));
                }
                for x in 0..3 {
                    let taps = transform::filter_adjoint(transform::column(&rows, x));
                    for (y, value) in taps.into_iter().enumerate() {
                        let row = self.channel * 9 + y * 3 + x;
                        let count = (self.outputs - o).min(V::LANES);
                        let to = self.weights.at(row * self.outputs + o, count);
                        value.store_some(to, count);
                    }
                }
            }
        }
    }
}
