//! Convolution as matrix products over strips of unfolded pixels (im2col), in NCHW.
//!
//! Work is cut into the same pieces whatever the number of threads, and every sum runs in a fixed
//! order, so results do not depend on the number of threads.

use super::ConvSpec;
use rayon::prelude::*;

/// The sizes of one convolution with a square kernel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shape {
    batch: usize,
    channels: usize,
    height: usize,
    width: usize,
    outputs: usize,
    taps: usize,
    spec: ConvSpec,
    out_height: usize,
    out_width: usize,
}

/// Floats in one strip of unfolded pixels: about half of a second-level cache.
const STRIP: usize = 1 << 17;

impl Shape {
    pub(super) fn new(x: &[usize; 4], weight: &[usize; 4], spec: ConvSpec) -> Self {
        let [batch, channels, height, width] = *x;
        let [outputs, _, taps, _] = *weight;
        Self {
            batch,
            channels,
            height,
            width,
            outputs,
            taps,
            spec,
            out_height: spec.output(height, taps),
            out_width: spec.output(width, taps),
        }
    }

    pub(super) fn input(&self) -> [usize; 4] {
        [self.batch, self.channels, self.height, self.width]
    }

    pub(super) fn output(&self) -> [usize; 4] {
        [self.batch, self.outputs, self.out_height, self.out_width]
    }

    pub(super) fn weight(&self) -> [usize; 4] {
        [self.outputs, self.channels, self.taps, self.taps]
    }

    /// Rows of the unfolded matrix.
    fn depth(&self) -> usize {
        self.channels * self.taps * self.taps
    }

    fn in_plane(&self) -> usize {
        self.height * self.width
    }

    fn out_plane(&self) -> usize {
        self.out_height * self.out_width
    }

    /// The ranges of output rows that make up one image.
    fn strips(&self) -> impl IndexedParallelIterator<Item = (usize, usize)> + Clone {
        let rows =
            (STRIP / (self.depth() * self.out_width).max(1)).clamp(1, self.out_height.max(1));
        let height = self.out_height;
        (0..height.div_ceil(rows))
            .into_par_iter()
            .map(move |i| (i * rows, ((i + 1) * rows).min(height)))
    }

    /// The convolution that carries gradients of a stride-1 convolution back to its input.
    fn transposed(&self) -> Self {
        let padding = self.spec.dilation * (self.taps - 1) - self.spec.padding;
        let spec = ConvSpec {
            padding,
            ..self.spec
        };
        let x = [self.batch, self.outputs, self.out_height, self.out_width];
        let weight = [self.channels, self.outputs, self.taps, self.taps];
        Self::new(&x, &weight, spec)
    }

    /// Whether the unfolded matrix is the image itself.
    fn is_pointwise(&self) -> bool {
        self.taps == 1 && self.spec.stride == 1 && self.spec.padding == 0
    }

    /// Calls `visit(run, start)` for every output row of every row of the unfolded matrix, where
    /// `start` is the position in the matrix of its first column.
    fn runs(&self, rows: (usize, usize), mut visit: impl FnMut(Run, usize)) {
        let ConvSpec {
            stride,
            padding,
            dilation,
        } = self.spec;
        let area = self.taps * self.taps;
        for row in 0..self.depth() {
            let (channel, tap) = (row / area, row % area);
            let (dy, dx) = (tap / self.taps * dilation, tap % self.taps * dilation);
            // Columns whose source x * stride + dx - padding lies inside the image.
            let first = padding
                .saturating_sub(dx)
                .div_ceil(stride)
                .min(self.out_width);
            let inside = (self.width + padding).saturating_sub(dx).div_ceil(stride);
            let last = inside.min(self.out_width).max(first);
            for y in rows.0..rows.1 {
                let start = (row * (rows.1 - rows.0) + y - rows.0) * self.out_width;
                let run = match (y * stride + dy).checked_sub(padding) {
                    Some(source) if source < self.height && first < last => Run {
                        first,
                        last,
                        source: (channel * self.height + source) * self.width + first * stride + dx
                            - padding,
                    },
                    _ => Run {
                        first: 0,
                        last: 0,
                        source: 0,
                    },
                };
                visit(run, start);
            }
        }
    }

    /// Unfolds output rows of one image into `depth() x pixels`.
    fn unfold(&self, image: &[f32], rows: (usize, usize), columns: &mut Vec<f32>) {
        columns.resize(self.depth() * (rows.1 - rows.0) * self.out_width, 0.0);
        let stride = self.spec.stride;
        self.runs(rows, |run, start| {
            let target = &mut columns[start..start + self.out_width];
            target[..run.first].fill(0.0);
            target[run.last..].fill(0.0);
            let target = &mut target[run.first..run.last];
            if stride == 1 {
                target.copy_from_slice(&image[run.source..run.source + target.len()]);
            } else {
                let values = image[run.source..].iter().step_by(stride);
                target.iter_mut().zip(values).for_each(|(t, v)| *t = *v);
            }
        });
    }

    /// Adds `depth() x pixels` back onto one image: the adjoint of `unfold`.
    fn fold(&self, columns: &[f32], rows: (usize, usize), image: &mut [f32]) {
        let stride = self.spec.stride;
        self.runs(rows, |run, start| {
            let from = &columns[start + run.first..start + run.last];
            let targets = image[run.source..].iter_mut().step_by(stride);
            targets.zip(from).for_each(|(t, v)| *t += v);
        });
    }
}

/// Columns `first..last` of an output row read the image from `source` on; the others read zeros.
#[derive(Clone, Copy)]
struct Run {
    first: usize,
    last: usize,
    source: usize,
}

/// A matrix inside a slice: its first element, and the steps between rows and between columns.
#[derive(Clone, Copy)]
struct Matrix<'a> {
    values: &'a [f32],
    row: usize,
    column: usize,
}

/// `out (m x n, rows `row` apart) = [out +] a (m x k) * b (k x n)`.
fn multiply(
    out: &mut Target<'_>,
    (m, n, k): (usize, usize, usize),
    a: Matrix<'_>,
    b: Matrix<'_>,
    accumulate: bool,
) {
    let last = |rows: usize, columns: usize, step: (usize, usize)| {
        (rows.max(1) - 1) * step.0 + (columns.max(1) - 1) * step.1
    };
    assert!(last(m, k, (a.row, a.column)) < a.values.len() || m * k == 0);
    assert!(last(k, n, (b.row, b.column)) < b.values.len() || n * k == 0);
    assert!(out.start + last(m, n, (out.row, 1)) < out.length || m * n == 0);
    // SAFETY: the three assertions keep every access inside its slice, and each target is written
    // by one task only (see `Target`).
    unsafe {
        ::gemm::gemm(
            m,
            n,
            k,
            out.pointer.add(out.start),
            1,
            out.row as isize,
            accumulate,
            a.values.as_ptr(),
            a.column as isize,
            a.row as isize,
            b.values.as_ptr(),
            b.column as isize,
            b.row as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            ::gemm::Parallelism::None,
        );
    }
}

/// A block of rows of an output that several tasks share without overlap.
struct Target<'a> {
    pointer: *mut f32,
    length: usize,
    start: usize,
    row: usize,
    _borrow: std::marker::PhantomData<&'a mut [f32]>,
}

/// A slice handed to tasks that each write a different block of it.
#[derive(Clone, Copy)]
struct Shared<'a> {
    pointer: *mut f32,
    length: usize,
    _borrow: std::marker::PhantomData<&'a mut [f32]>,
}

// SAFETY: the tasks of one call write disjoint blocks: different images or different output rows.
unsafe impl Send for Shared<'_> {}
// SAFETY: as above; nothing reads the slice before all tasks have ended.
unsafe impl Sync for Shared<'_> {}

impl<'a> Shared<'a> {
    fn new(values: &'a mut [f32]) -> Self {
        Self {
            pointer: values.as_mut_ptr(),
            length: values.len(),
            _borrow: std::marker::PhantomData,
        }
    }

    fn block(self, start: usize, row: usize) -> Target<'a> {
        Target {
            pointer: self.pointer,
            length: self.length,
            start,
            row,
            _borrow: std::marker::PhantomData,
        }
    }
}

/// The convolution.
pub(super) fn forward(x: &[f32], weight: &[f32], shape: Shape) -> Vec<f32> {
    let (depth, in_image) = (shape.depth(), shape.channels * shape.in_plane());
    let out_image = shape.outputs * shape.out_plane();
    let mut output = vec![0.0; shape.batch * out_image];
    let shared = Shared::new(&mut output);
    let weights = Matrix {
        values: weight,
        row: depth,
        column: 1,
    };
    let strips: Vec<_> = shape.strips().collect();
    let tasks = shape.batch * strips.len();
    (0..tasks)
        .into_par_iter()
        .for_each_init(Vec::new, |columns, task| {
            let (b, rows) = (task / strips.len(), strips[task % strips.len()]);
            let image = &x[b * in_image..][..in_image];
            let pixels = (rows.1 - rows.0) * shape.out_width;
            let first = rows.0 * shape.out_width;
            let unfolded = if shape.is_pointwise() {
                Matrix {
                    values: &image[first..],
                    row: shape.in_plane(),
                    column: 1,
                }
            } else {
                shape.unfold(image, rows, columns);
                Matrix {
                    values: columns,
                    row: pixels,
                    column: 1,
                }
            };
            let mut target = shared.block(b * out_image + first, shape.out_plane());
            multiply(
                &mut target,
                (shape.outputs, pixels, depth),
                weights,
                unfolded,
                false,
            );
        });
    output
}

/// The gradient of the input.
pub(super) fn backward_input(weight: &[f32], grad: &[f32], shape: Shape) -> Vec<f32> {
    if shape.spec.stride == 1 && shape.spec.dilation * (shape.taps - 1) >= shape.spec.padding {
        return forward(grad, &flipped(weight, &shape), shape.transposed());
    }
    let (depth, in_image) = (shape.depth(), shape.channels * shape.in_plane());
    let out_image = shape.outputs * shape.out_plane();
    let mut input = vec![0.0; shape.batch * in_image];
    let strips: Vec<_> = shape.strips().collect();
    let weights = Matrix {
        values: weight,
        row: 1,
        column: depth,
    };
    input
        .par_chunks_mut(in_image.max(1))
        .enumerate()
        .for_each_init(Vec::new, |columns, (b, image)| {
            for &rows in &strips {
                let pixels = (rows.1 - rows.0) * shape.out_width;
                let values = &grad[b * out_image + rows.0 * shape.out_width..(b + 1) * out_image];
                let grads = Matrix {
                    values,
                    row: shape.out_plane(),
                    column: 1,
                };
                columns.resize(depth * pixels, 0.0);
                let mut target = Shared::new(columns).block(0, pixels);
                multiply(
                    &mut target,
                    (depth, pixels, shape.outputs),
                    weights,
                    grads,
                    false,
                );
                shape.fold(columns, rows, image);
            }
        });
    input
}

/// The gradient of the weights.
pub(super) fn backward_weight(x: &[f32], grad: &[f32], shape: Shape) -> Vec<f32> {
    let (depth, in_image) = (shape.depth(), shape.channels * shape.in_plane());
    let out_image = shape.outputs * shape.out_plane();
    let strips: Vec<_> = shape.strips().collect();
    let halves: Vec<_> = strips.chunks(strips.len().div_ceil(2).max(1)).collect();
    let tasks = shape.batch * halves.len();
    let parts: Vec<Vec<f32>> = (0..tasks)
        .into_par_iter()
        .map_init(Vec::new, |columns, task| {
            let b = task / halves.len();
            let image = &x[b * in_image..][..in_image];
            let mut part = vec![0.0; shape.outputs * depth];
            for &rows in halves[task % halves.len()] {
                let pixels = (rows.1 - rows.0) * shape.out_width;
                let first = rows.0 * shape.out_width;
                let values = &grad[b * out_image + first..(b + 1) * out_image];
                let grads = Matrix {
                    values,
                    row: shape.out_plane(),
                    column: 1,
                };
                let unfolded = if shape.is_pointwise() {
                    Matrix {
                        values: &image[first..],
                        row: 1,
                        column: shape.in_plane(),
                    }
                } else {
                    shape.unfold(image, rows, columns);
                    Matrix {
                        values: columns,
                        row: 1,
                        column: pixels,
                    }
                };
                let mut target = Shared::new(&mut part).block(0, depth);
                multiply(
                    &mut target,
                    (shape.outputs, depth, pixels),
                    grads,
                    unfolded,
                    true,
                );
            }
            part
        })
        .collect();
    let mut total = vec![0.0; shape.outputs * depth];
    for part in parts {
        total.iter_mut().zip(part).for_each(|(t, p)| *t += p);
    }
    total
}

/// Weights `[out, in, taps, taps]` turned by half a turn and transposed to `[in, out, taps, taps]`.
fn flipped(weight: &[f32], shape: &Shape) -> Vec<f32> {
    let area = shape.taps * shape.taps;
    let mut turned = vec![0.0; weight.len()];
    for o in 0..shape.outputs {
        for c in 0..shape.channels {
            for t in 0..area {
                turned[(c * shape.outputs + o) * area + area - 1 - t] =
                    weight[(o * shape.channels + c) * area + t];
            }
        }
    }
    turned
}
