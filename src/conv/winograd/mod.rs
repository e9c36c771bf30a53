//! 3x3 convolution at stride 1 by Winograd's minimal filtering F(4x4, 3x3) (Lavin and Gray 2016):
//! 36 products per 16 outputs and pair of channels instead of 144.
//!
//! Images are `[batch, height, width, channels]`. A dilated convolution is as many plain ones on
//! interleaved grids.

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

/// The first output pixel of a tile: image, row, column.
type Tile = [usize; 3];

/// All tiles of a batch of images `[batch, height, width]`. The pixels of a tile are `dilation`
/// apart.
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

/// A batch of images that tiles are read from.
#[derive(Clone, Copy)]
struct Images<'a> {
    values: &'a [f32],
    size: [usize; 3],
    channels: usize,
    dilation: usize,
    /// At least `channels` zeros: what lies outside.
    zeros: &'a [f32],
}

impl Images<'_> {
    /// The channels of each pixel of a window whose first pixel lies `before` steps left and up
    /// of a tile's.
    #[inline(always)]
    fn window<const N: usize>(&self, [image, y, x]: Tile, before: usize) -> [[*const f32; N]; N] {
        let [_, height, width] = self.size;
        let place = |start: usize, i: usize| {
            (start + i * self.dilation).wrapping_sub(before * self.dilation)
        };
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

    /// Transforms windows of `N x N` pixels by `one` along both axes and hands each frequency to
    /// `sink(channel, frequency, value)`, in whole vectors up to `padded` channels; those beyond
    /// the last are 0.
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
        for c in (0..padded).step_by(V::LANES) {
            // SAFETY: every pixel has `channels` floats; of those beyond none is read.
            unsafe {
                let mut rows = [[V::splat(0.0); IN]; N];
                for (row, pixels) in rows.iter_mut().zip(pixels) {
                    let mut values = [V::splat(0.0); N];
                    for (value, pixel) in values.iter_mut().zip(pixels) {
                        *value = V::load_some(pixel.add(c), self.channels.saturating_sub(c));
                    }
                    *row = one(values);
                }
                for j in 0..IN {
                    let column = one(transform::column(&rows, j));
                    for (i, value) in column.into_iter().enumerate() {
                        sink(c, i * IN + j, value);
                    }
                }
            }
        }
    }
}
