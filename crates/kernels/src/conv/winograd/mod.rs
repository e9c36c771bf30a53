//! 3x3 convolution at stride 1 by Winograd's minimal filtering F(4x4, 3x3) (Lavin and Gray 2016):
//! 36 products per 16 outputs and pair of channels instead of 144.
//!
//! Images are `[batch, height, width, channels]`. A dilated convolution is computed as several plain ones on interleaved grids.

mod filter;
mod forward;
mod gradient;
mod transform;

pub(super) use filter::Filter;
pub(super) use gradient::weight_gradient;

use crate::simd::Vector;

/// Frequencies of a tile: 6 x 6.
const SPECTRUM: usize = 36;
/// Outputs of a tile along an axis.
const OUT: usize = 4;
/// Inputs of a tile along an axis.
const IN: usize = 6;

/// Returns the distance in floats between frequencies in a spectrum with this many rows: their size plus a cache line, because
/// otherwise all frequencies of a tile would compete for the same cache lines.
const fn frequency_stride(rows: usize, row: usize) -> usize {
    rows * row + 16
}

/// The first output pixel of a tile: image, row, column.
type Tile = [usize; 3];

/// Returns all tiles of a batch of images `[batch, height, width]`. The pixels of a tile are `dilation` apart.
fn tiles([batch, height, width]: [usize; 3], dilation: usize) -> Vec<Tile> {
    let starts = |length: usize| {
        let phases = 0..dilation.min(length);
        phases
            .flat_map(|phase| (phase..length).step_by(OUT * dilation))
            .collect::<Vec<_>>()
    };
    let (rows, columns) = (starts(height), starts(width));
    let mut tiles = Vec::with_capacity(batch * rows.len() * columns.len());
    for image in 0..batch {
        for &y in &rows {
            tiles.extend(columns.iter().map(|&x| [image, y, x]));
        }
    }
    tiles
}

/// A batch of images, divided into tiles.
#[derive(Clone, Copy)]
struct Images<'a> {
    values: &'a [f32],
    size: [usize; 3],
    channels: usize,
    dilation: usize,
    /// At least `channels` zeros, for pixels outside the image.
    zeros: &'a [f32],
}

impl Images<'_> {
    /// Returns the channels of each pixel of a window that begins `before` steps to the left and above a tile.
    #[inline(always)]
    fn window<const N: usize>(&self, [image, y, x]: Tile, before: usize) -> [[*const f32; N]; N] {
        let [_, height, width] = self.size;
        let place = |start: usize, i: usize| {
            (start + i * self.dilation).wrapping_sub(before * self.dilation)
        };
        let inside =
            |start: usize, length: usize| place(start, 0) < length && place(start, N - 1) < length;
        if inside(y, height) && inside(x, width) {
            let right = self.dilation * self.channels;
            let down = right * width;
            let first = ((image * height + place(y, 0)) * width + place(x, 0)) * self.channels;
            let pixels = &self.values[first..][..(N - 1) * (right + down) + self.channels];
            return std::array::from_fn(
                #[inline(always)]
                |i| {
                    std::array::from_fn(
                        #[inline(always)]
                        |j| pixels.as_ptr().wrapping_add(i * down + j * right),
                    )
                },
            );
        }
        std::array::from_fn(
            #[inline(always)]
            |i| {
                let row = place(y, i);
                std::array::from_fn(
                    #[inline(always)]
                    |j| {
                        let column = place(x, j);
                        if row < height && column < width {
                            let pixel = (image * height + row) * width + column;
                            self.values[pixel * self.channels..].as_ptr()
                        } else {
                            self.zeros.as_ptr()
                        }
                    },
                )
            },
        )
    }

    /// Transforms windows of `N x N` pixels by `one` along both axes, and passes each frequency to
    /// `sink(channel, frequency, value)`, in whole vectors up to `padded` channels; channels beyond the last are 0.
    ///
    /// # Safety
    /// As for `Vector`.
    #[inline(always)]
    unsafe fn spectrum<V: Vector, const N: usize>(
        &self,
        pixels: &[[*const f32; N]; N],
        padded: usize,
        one: impl Fn([V; N]) -> [V; IN],
        mut sink: impl FnMut(usize, usize, V),
    ) {
        let whole = self.channels / V::LANES * V::LANES;
        for c in (0..padded).step_by(V::LANES) {
            // SAFETY: every pixel has `channels` floats; no floats beyond them are read.
            unsafe {
                if c < whole {
                    both_axes(
                        pixels,
                        #[inline(always)]
                        |pixel| V::load(pixel.add(c)),
                        &one,
                        #[inline(always)]
                        |f, value| sink(c, f, value),
                    );
                } else {
                    let left = self.channels.saturating_sub(c);
                    both_axes(
                        pixels,
                        #[inline(always)]
                        |pixel| V::load_some(pixel.wrapping_add(c), left),
                        &one,
                        #[inline(always)]
                        |f, value| sink(c, f, value),
                    );
                }
            }
        }
    }
}

/// Transforms a window of one vector per pixel along its rows, then along its columns.
///
/// # Safety
/// As for `Vector`.
#[inline(always)]
unsafe fn both_axes<V: Vector, const N: usize>(
    pixels: &[[*const f32; N]; N],
    load: impl Fn(*const f32) -> V,
    one: &impl Fn([V; N]) -> [V; IN],
    mut sink: impl FnMut(usize, V),
) {
    // SAFETY: as demanded from the caller.
    let mut rows = unsafe { [[V::splat(0.0); IN]; N] };
    for (row, pixels) in rows.iter_mut().zip(pixels) {
        let mut values = [row[0]; N];
        for (value, pixel) in values.iter_mut().zip(pixels) {
            *value = load(*pixel);
        }
        *row = one(values);
    }
    for j in 0..IN {
        let column = one(transform::column(&rows, j));
        for (i, value) in column.into_iter().enumerate() {
            sink(i * IN + j, value);
        }
    }
}
