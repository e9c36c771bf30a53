//! The convolution: inputs to the frequency domain, a product per frequency, and back.

use super::{Filter, IN, Images, OUT, SPECTRUM, Tile, frequency_stride, tiles, transform};
use crate::schedule::{InTasks, threads};
use crate::simd::{Kernel, Rows, Scratch, Shared, Tail, Unset, Vector, product};
use rayon::prelude::*;

/// Largest number of tiles per task: two register tiles of the longest vectors.
const TILES: usize = 28;
/// Largest number of floats of transformed inputs per task, which should fit second-level caches.
const CACHE: usize = 160 << 10;

impl Filter {
    /// Computes `output [batch, height, width, outputs]` from `x [batch, height, width, channels]`; sets every float.
    pub(in crate::conv) fn write(
        &self,
        x: &[f32],
        size: [usize; 3],
        tail: Tail<'_>,
        scratch: &Scratch,
        output: &mut Unset,
    ) {
        let pixels = size.iter().product::<usize>();
        assert_eq!(x.len(), pixels * self.channels, "input");
        assert_eq!(output.len(), pixels * self.outputs, "output");
        assert!(tail.skip.is_none_or(|skip| skip.len() == output.len()));
        let padded = self.channels.next_multiple_of(self.level.lanes());
        let tiles = tiles(size, self.dilation);
        // Equal tasks, as many as threads or a multiple.
        let most_tiles = (CACHE / (SPECTRUM * padded)).clamp(1, TILES);
        let tasks = tiles.len().div_ceil(most_tiles);
        let tasks = tasks.next_multiple_of(threads());
        let task_tiles = tiles.len().div_ceil(tasks.max(1)).max(1);
        let zeros = vec![0.0; padded];
        let images = Images {
            values: x,
            size,
            channels: self.channels,
            dilation: self.dilation,
            zeros: &zeros,
        };
        let output = Shared::unset(output);
        tiles.par_chunks(task_tiles).each(|tiles| {
            let inputs = SPECTRUM * frequency_stride(tiles.len(), padded);
            let products = SPECTRUM * tiles.len() * self.panel;
            scratch.with(inputs + products, |memory| {
                let (inputs, products) = memory.split_at_mut(inputs);
                let task = Forward {
                    filter: self,
                    images,
                    tiles,
                    tail,
                    padded,
                    inputs,
                    products,
                    output,
                };
                // SAFETY: lengths were asserted; each pixel belongs to one tile.
                unsafe {
                    if self.panel == self.level.lanes() {
                        self.level.run(Panels::<1>(task));
                    } else {
                        self.level.run(Panels::<2>(task));
                    }
                }
            });
        });
    }
}

struct Forward<'a> {
    filter: &'a Filter,
    images: Images<'a>,
    tiles: &'a [Tile],
    tail: Tail<'a>,
    /// Channels of the transformed inputs, in whole vectors.
    padded: usize,
    /// `[frequency][tile][padded]`
    inputs: &'a mut [f32],
    /// Products of one panel, `[frequency][tile][width]`.
    products: &'a mut [f32],
    output: Shared<'a>,
}

/// A convolution with panels of `W` vectors.
struct Panels<'a, const W: usize>(Forward<'a>);

impl<const W: usize> Kernel for Panels<'_, W> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let mut task = self.0;
        // SAFETY: as demanded from the caller.
        unsafe {
            task.transform_inputs::<V>();
            for first in (0..task.filter.outputs).step_by(W * V::LANES) {
                task.multiply::<V, W>(first);
                task.transform_outputs::<V, W>(first);
            }
        }
    }
}

impl Forward<'_> {
    #[inline(always)]
    unsafe fn transform_inputs<V: Vector>(&mut self) {
        let padded = self.padded;
        let stride = frequency_stride(self.tiles.len(), padded);
        let inputs = self.inputs.as_mut_ptr();
        for (t, &tile) in self.tiles.iter().enumerate() {
            let window = self.images.window::<IN>(tile, 1);
            // SAFETY: the memory has a padded row for each frequency and tile.
            unsafe {
                self.images.spectrum::<V, IN>(
                    &window,
                    padded,
                    #[inline(always)]
                    |d| transform::input(d),
                    #[inline(always)]
                    |c, f, value| value.store(inputs.add(f * stride + t * padded + c)),
                );
            }
        }
    }

    /// Computes the products of one panel of outputs.
    #[inline(always)]
    unsafe fn multiply<V: Vector, const W: usize>(&mut self, first: usize) {
        let channels = self.filter.channels;
        let (tiles, width) = (self.tiles.len(), W * V::LANES);
        let stride = frequency_stride(tiles, self.padded);
        for f in 0..SPECTRUM {
            // SAFETY: panels have `channels` rows per frequency; the memory has as many rows as there are tiles.
            unsafe {
                let panel = self
                    .filter
                    .spectrum
                    .as_ptr()
                    .add(first * SPECTRUM * channels);
                let rows = Rows {
                    pointer: self.inputs.as_ptr().add(f * stride),
                    row: self.padded,
                    step: 1,
                };
                let products = self.products.as_mut_ptr().add(f * tiles * width);
                let panel = panel.add(f * channels * width);
                product::<V, W>(
                    rows,
                    tiles,
                    channels,
                    panel,
                    width,
                    #[inline(always)]
                    |t, sums| {
                        for (i, sum) in sums.iter().enumerate() {
                            sum.store(products.add(t * width + i * V::LANES));
                        }
                    },
                );
            }
        }
    }

    #[inline(always)]
    unsafe fn transform_outputs<V: Vector, const W: usize>(&mut self, first: usize) {
        let [_, height, width] = self.images.size;
        let Filter {
            outputs, dilation, ..
        } = *self.filter;
        let step = self.tiles.len() * W * V::LANES;
        for (t, &[image, y, x]) in self.tiles.iter().enumerate() {
            let reach = (OUT - 1) * dilation;
            let inside = y + reach < height && x + reach < width;
            let first_pixel = (image * height + y) * width + x;
            for part in 0..W {
                let channel = first + part * V::LANES;
                if channel >= outputs {
                    break;
                }
                // SAFETY: the products have a row for each frequency and tile; only pixels inside
                // the image and channels below `outputs` are written.
                unsafe {
                    let products = self.products.as_ptr().add((W * t + part) * V::LANES);
                    let bias = V::load(self.filter.bias.as_ptr().add(channel));
                    let mut rows = [[V::splat(0.0); OUT]; IN];
                    for (i, row) in rows.iter_mut().enumerate() {
                        *row = transform::output(std::array::from_fn(
                            #[inline(always)]
                            |j| V::load(products.add((i * IN + j) * step)),
                        ));
                    }
                    if inside && channel + V::LANES <= outputs {
                        for j in 0..OUT {
                            let values = transform::output(transform::column(&rows, j));
                            for (i, value) in values.into_iter().enumerate() {
                                let pixel = first_pixel + (i * width + j) * dilation;
                                let at = pixel * outputs + channel;
                                let value = self.tail.finish(value.add(bias), at, V::LANES);
                                value.store(self.output.at(at, V::LANES));
                            }
                        }
                        continue;
                    }
                    for j in 0..OUT {
                        let column = x + j * dilation;
                        if column >= width {
                            break;
                        }
                        let values = transform::output(transform::column(&rows, j));
                        for (i, value) in values.into_iter().enumerate() {
                            let row = y + i * dilation;
                            if row >= height {
                                break;
                            }
                            let pixel = (image * height + row) * width + column;
                            let (at, count) = (pixel * outputs + channel, outputs - channel);
                            let value = self.tail.finish(value.add(bias), at, count);
                            value.store_some(self.output.at(at, count.min(V::LANES)), count);
                        }
                    }
                }
            }
        }
    }
}
