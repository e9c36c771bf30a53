//! The gradient of the weights, also in the frequency domain: a quarter of the products.
//!
//! Sums over tiles have a fixed order for any number of threads.

use super::{IN, Images, OUT, SPECTRUM, Tile, frequency_stride, tiles, transform};
use crate::conv::Shape;
use crate::simd::{Kernel, Level, Rows, Scratch, Shared, Vector, product};
use rayon::prelude::*;
use std::ops::Range;

/// Largest number of tiles per block; the spectra of a block are contiguous.
const TILES: usize = 64;
/// Largest number of floats of the spectra of a block, if every part has its own sums: spectra and sums fit second-level
/// caches.
const CACHE: usize = 96 << 10;
/// Largest number of floats of the sums of a part.
const SUMS: usize = 160 << 10;
/// Largest number of parts with sums computed in parallel.
const PARTS: usize = 16;
/// Least number of tiles per part, because its sums are read once more at the end.
const PART: usize = 128;

/// Returns the gradient of weights `[channels, 3, 3, outputs]` from inputs `x [batch, height, width, channels]` and the
/// gradient of outputs `grad [batch, height, width, outputs]`.
pub(in crate::conv) fn weight_gradient(
    level: Level,
    x: &[f32],
    grad: &[f32],
    shape: &Shape,
    scratch: &Scratch,
) -> Vec<f32> {
    assert!(shape.is_winograd(), "shape");
    let (channels, outputs) = (shape.channels, shape.outputs);
    let (size, dilation) = (shape.size(), shape.spec.dilation);
    assert_eq!(x.len(), shape.input_len(), "input");
    assert_eq!(grad.len(), shape.output_len(), "gradient");
    let panel = level.panel(outputs);
    let [inputs, grads] = [
        channels.next_multiple_of(level.lanes()),
        outputs.next_multiple_of(panel),
    ];
    let zeros = vec![0.0; inputs.max(grads)];
    let images = |values, channels| Images {
        values,
        size,
        channels,
        dilation,
        zeros: &zeros,
    };
    let tiles = tiles(size, dilation);
    let sum = SPECTRUM * channels * grads;
    let parts = if sum <= SUMS {
        (tiles.len() / PART).clamp(1, PARTS)
    } else {
        1
    };
    let block_tiles = if parts > 1 {
        (CACHE / (SPECTRUM * (inputs + grads))).clamp(1, TILES)
    } else {
        TILES
    };
    let correlation = Correlation {
        level,
        x: images(x, channels),
        grad: images(grad, outputs),
        padded: [inputs, grads],
        panel,
        tiles: &tiles,
        block_tiles,
    };
    let spectra = if parts > 1 {
        0
    } else {
        tiles.len().div_ceil(block_tiles) * correlation.block().iter().sum::<usize>()
    };
    let mut weights = vec![0.0; 9 * channels * outputs];
    scratch.with_whole(spectra + parts * sum, |memory| {
        let (spectra, sums) = memory.split_at_mut(spectra);
        if parts > 1 {
            correlation.by_parts(sums, parts, scratch);
        } else {
            correlation.by_frequencies(spectra, sums);
        }
        let sums = &*sums;
        let shared = Shared::new(&mut weights);
        (0..channels).into_par_iter().for_each(|channel| {
            let kernel = Inverse {
                sums,
                parts,
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

/// Inputs and gradients of outputs; their products are summed over tiles for every frequency.
struct Correlation<'a> {
    level: Level,
    x: Images<'a>,
    grad: Images<'a>,
    /// Channels, padded to whole vectors, and outputs, padded to whole panels.
    padded: [usize; 2],
    /// Outputs multiplied at once.
    panel: usize,
    tiles: &'a [Tile],
    /// Tiles per block.
    block_tiles: usize,
}

impl Correlation<'_> {
    /// Returns the numbers of floats of the spectra of a block, for inputs and for gradients.
    fn block(&self) -> [usize; 2] {
        let padded = self.padded;
        padded.map(|padded| SPECTRUM * frequency_stride(self.block_tiles, padded))
    }

    fn transform(&self, tiles: &[Tile], x: &mut [f32], grad: &mut [f32]) {
        let kernel = Transform {
            of: self,
            tiles,
            x,
            grad,
        };
        // SAFETY: the memory has the lengths of `block`, and rows of pixels have their lengths.
        unsafe { self.level.run(kernel) }
    }

    fn panels(&self) -> usize {
        self.padded[1] / self.panel
    }

    /// For many tiles: computes sums over parts of the tiles, `[part][frequency][channel][padded output]`, each by one thread
    /// within its cache. The caller adds them.
    fn by_parts(&self, sums: &mut [f32], parts: usize, scratch: &Scratch) {
        let sum = sums.len() / parts;
        let part = self.tiles.len().div_ceil(parts);
        let [x, grad] = self.block();
        let sums = sums.par_chunks_mut(sum).enumerate();
        sums.for_each(|(i, sum)| {
            sum.fill(0.0);
            let first = (i * part).min(self.tiles.len());
            let tiles = &self.tiles[first..(first + part).min(self.tiles.len())];
            scratch.with(x + grad, |memory| {
                let (x, grad) = memory.split_at_mut(x);
                for tiles in tiles.chunks(self.block_tiles) {
                    self.transform(tiles, x, grad);
                    let kernel = Products {
                        of: self,
                        tiles: tiles.len(),
                        x,
                        grad,
                        frequencies: 0..SPECTRUM,
                        panels: 0..self.panels(),
                        sums: Shared::new(sum),
                        overwrite: false,
                    };
                    // SAFETY: the sums belong to this part.
                    unsafe { self.level.run(kernel) }
                }
            });
        });
    }

    /// For few tiles: computes all spectra, then the products of each frequency, `sums [frequency][channel][padded output]`.
    fn by_frequencies(&self, spectra: &mut [f32], sums: &mut [f32]) {
        let [x_block, grad_block] = self.block();
        let blocks = self.tiles.len().div_ceil(self.block_tiles);
        let (x, grad) = spectra.split_at_mut(blocks * x_block);
        let memory = x
            .par_chunks_mut(x_block)
            .zip(grad.par_chunks_mut(grad_block));
        memory
            .zip(self.tiles.par_chunks(self.block_tiles))
            .for_each(|((x, grad), tiles)| self.transform(tiles, x, grad));
        let (x, grad) = (&*x, &*grad);
        let sums = Shared::new(sums);
        let panels = self.panels();
        (0..SPECTRUM * panels).into_par_iter().for_each(|task| {
            let (frequency, panel) = (task / panels, task % panels);
            for (i, tiles) in self.tiles.chunks(self.block_tiles).enumerate() {
                let kernel = Products {
                    of: self,
                    tiles: tiles.len(),
                    x: &x[i * x_block..][..x_block],
                    grad: &grad[i * grad_block..][..grad_block],
                    frequencies: frequency..frequency + 1,
                    panels: panel..panel + 1,
                    sums,
                    overwrite: i == 0,
                };
                // SAFETY: each task writes its own columns of its frequency.
                unsafe { self.level.run(kernel) }
            }
        });
    }
}

/// Transforms a block of tiles of inputs and of gradients to the frequency domain, `[frequency][tile][padded]`.
struct Transform<'a> {
    of: &'a Correlation<'a>,
    tiles: &'a [Tile],
    x: &'a mut [f32],
    grad: &'a mut [f32],
}

impl Kernel for Transform<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let [inputs, grads] = self.of.padded;
        let (x, grad) = (self.x.as_mut_ptr(), self.grad.as_mut_ptr());
        for (t, &tile) in self.tiles.iter().enumerate() {
            // SAFETY: both spectra have a padded row for each frequency and tile.
            unsafe {
                let images = &self.of.x;
                images.spectrum::<V, IN>(
                    &images.window::<IN>(tile, 1),
                    inputs,
                    #[inline(always)]
                    |d| transform::input(d),
                    #[inline(always)]
                    |c, f, value| {
                        let at = f * frequency_stride(self.of.block_tiles, inputs) + t * inputs + c;
                        value.store(x.add(at));
                    },
                );
                let images = &self.of.grad;
                images.spectrum::<V, OUT>(
                    &images.window::<OUT>(tile, 0),
                    grads,
                    #[inline(always)]
                    |y| transform::output_adjoint(y),
                    #[inline(always)]
                    |c, f, value| {
                        let at = f * frequency_stride(self.of.block_tiles, grads) + t * grads + c;
                        value.store(grad.add(at));
                    },
                );
            }
        }
    }
}

/// Sums the products of inputs and gradients over the tiles of a block, for some frequencies and panels of outputs.
struct Products<'a> {
    of: &'a Correlation<'a>,
    tiles: usize,
    x: &'a [f32],
    grad: &'a [f32],
    frequencies: Range<usize>,
    panels: Range<usize>,
    /// `[frequency][channel][padded output]`
    sums: Shared<'a>,
    /// Whether the sums are overwritten instead of added to.
    overwrite: bool,
}

impl Kernel for Products<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        // SAFETY: as demanded from the caller.
        unsafe {
            if self.of.panel == V::LANES {
                self.sum::<V, 1>();
            } else {
                self.sum::<V, 2>();
            }
        }
    }
}

impl Products<'_> {
    /// Computes the sums with panels of `W` vectors.
    ///
    /// # Safety
    /// As for `Vector`; no other task has these frequencies and panels of the sums.
    #[inline(always)]
    unsafe fn sum<V: Vector, const W: usize>(self) {
        let channels = self.of.x.channels;
        let [inputs, grads] = self.of.padded;
        let [x_stride, grad_stride] =
            [inputs, grads].map(|row| frequency_stride(self.of.block_tiles, row));
        for f in self.frequencies.clone() {
            for first in self.panels.clone().map(|panel| panel * W * V::LANES) {
                // SAFETY: both spectra have a padded row for each frequency and tile.
                unsafe {
                    let rows = Rows {
                        pointer: self.x.as_ptr().add(f * x_stride),
                        row: 1,
                        step: inputs,
                    };
                    product::<V, W>(
                        rows,
                        channels,
                        self.tiles,
                        self.grad.as_ptr().add(f * grad_stride + first),
                        grads,
                        #[inline(always)]
                        |c, sums| {
                            let at = (f * channels + c) * grads + first;
                            let to = self.sums.at(at, W * V::LANES);
                            for (i, &sum) in sums.iter().enumerate() {
                                let to = to.add(i * V::LANES);
                                let sum = if self.overwrite {
                                    sum
                                } else {
                                    V::load(to).add(sum)
                                };
                                sum.store(to);
                            }
                        },
                    );
                }
            }
        }
    }
}

/// Transforms the gradient of the spectrum of one channel's filters back to their taps.
struct Inverse<'a> {
    /// `[part][frequency][channel][padded output]`
    sums: &'a [f32],
    parts: usize,
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
                            let first = self.sums.as_ptr().add(row * self.grads + o);
                            let sum = self.sums.len() / self.parts;
                            (1..self.parts).fold(
                                V::load(first),
                                #[inline(always)]
                                |total, part| total.add(V::load(first.add(part * sum))),
                            )
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
