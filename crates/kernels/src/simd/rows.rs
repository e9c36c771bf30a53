//! Operations on single rows between products.

use super::{Kernel, Level, Unset, Vector, unset};

/// A weighted sum of `N` rows, plus `T` unweighted rows.
#[derive(Clone, Copy, Debug)]
pub struct Blend<'a, const N: usize, const T: usize> {
    /// Rows and their weights.
    pub parts: [(&'a [f32], f32); N],
    /// Rows that are added without weights.
    pub terms: [&'a [f32]; T],
}

/// Computes blends into the rows of `output [blends, columns]`, which may be longer, with an optional ReLU.
pub fn blend_rows<'a, const N: usize, const T: usize>(
    level: Level,
    blends: impl ExactSizeIterator<Item = Blend<'a, N, T>>,
    columns: usize,
    relu: bool,
    output: &mut [f32],
) {
    // SAFETY: `write_blends` writes floats.
    write_blends(level, blends, columns, relu, unsafe { unset(output) });
}

/// Like `blend_rows`; sets every float if rows are no longer than `columns`.
pub(crate) fn write_blends<'a, const N: usize, const T: usize>(
    level: Level,
    blends: impl ExactSizeIterator<Item = Blend<'a, N, T>>,
    columns: usize,
    relu: bool,
    output: &mut Unset,
) {
    let row = output.len() / blends.len().max(1);
    assert!(row >= columns && output.len() == blends.len() * row);
    let kernel = BlendRows {
        blends,
        row,
        columns,
        relu,
        output,
    };
    // SAFETY: the assertion checks the length; the kernel checks the rows itself.
    unsafe { level.run(kernel) }
}

struct BlendRows<'a, I> {
    blends: I,
    row: usize,
    columns: usize,
    relu: bool,
    output: &'a mut Unset,
}

impl<'a, I, const N: usize, const T: usize> Kernel for BlendRows<'_, I>
where
    I: ExactSizeIterator<Item = Blend<'a, N, T>>,
{
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let outputs = self.output.chunks_exact_mut(self.row.max(1));
        for (Blend { parts, terms }, output) in self.blends.zip(outputs) {
            let output = &mut output[..self.columns];
            let lengths = parts.iter().map(|(row, _)| row.len());
            let mut lengths = lengths.chain(terms.iter().map(|row| row.len()));
            assert!(lengths.all(|length| length == output.len()));
            for c in (0..output.len()).step_by(V::LANES) {
                let count = output.len() - c;
                // SAFETY: all rows have the same length.
                unsafe {
                    let mut sum = V::splat(0.0);
                    for row in terms {
                        sum = sum.add(V::load_some(row.as_ptr().add(c), count));
                    }
                    for (row, weight) in parts {
                        let row = V::load_some(row.as_ptr().add(c), count);
                        sum = row.mul_add(V::splat(weight), sum);
                    }
                    if self.relu {
                        sum = sum.max(V::splat(0.0));
                    }
                    sum.store_some(output.as_mut_ptr().add(c).cast(), count);
                }
            }
        }
    }
}

/// Computes `output = rows [output, factors] * factors + constant`; the rows may be longer.
pub fn dot_rows(level: Level, rows: &[f32], factors: &[f32], constant: f32, output: &mut [f32]) {
    let row = rows.len() / output.len().max(1);
    assert!(row >= factors.len() && rows.len() == output.len() * row);
    let kernel = DotRows {
        rows,
        row,
        factors,
        constant,
        output,
    };
    // SAFETY: the assertion above checks the lengths.
    unsafe { level.run(kernel) }
}

struct DotRows<'a> {
    rows: &'a [f32],
    row: usize,
    factors: &'a [f32],
    constant: f32,
    output: &'a mut [f32],
}

impl Kernel for DotRows<'_> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let width = self.factors.len();
        for (r, output) in self.output.iter_mut().enumerate() {
            // SAFETY: there are as many rows as outputs, `width` floats each.
            unsafe {
                let row = self.rows.as_ptr().add(r * self.row);
                let mut sum = V::splat(0.0);
                for c in (0..width).step_by(V::LANES) {
                    let factor = V::load_some(self.factors.as_ptr().add(c), width - c);
                    sum = V::load_some(row.add(c), width - c).mul_add(factor, sum);
                }
                *output = sum.total() + self.constant;
            }
        }
    }
}
