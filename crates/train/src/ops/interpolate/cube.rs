//! The operation on GPUs: one unit per value of the result, or of the gradient, sums its terms. Burn's own operations add the
//! rows of a gradient sequentially.

use super::{
    BatchCells, BilinearCell, InterpolateBackend, InterpolateGradients, PixelReads, reference,
    reference_backward,
};
use crate::ops::gpu::{cube, cubes, empty};
use burn::backend::TensorMetadata as _;
use burn::backend::ops::{FloatTensorOps, IntTensorOps};
use burn::backend::tensor::FloatTensor;
use burn::tensor::{DType, IntDType, Shape, TensorData};
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use burn_cubecl::{CubeBackend, CubeDevice};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// Number of rows of a cell.
const CORNERS: usize = 4;
/// Limit of the pixels of an image that read a value of a map: software drivers terminate longer loops early.
const MOST_READERS: usize = 16_384;

type Floats = FloatTensor<CubeBackend>;

impl InterpolateBackend for CubeBackend {
    fn read_between(table: Floats, cells: BatchCells) -> Floats {
        let shape = table.shape();
        let (rows, channels) = (shape[1], shape[2]);
        let count: usize = cells.iter().map(Vec::len).sum();
        if table.dtype() != DType::F32 || count * channels == 0 {
            return reference::<Self>(table, &cells);
        }
        let table = into_contiguous(table);
        let row = |image: usize, cell: &BilinearCell| {
            cell.rows.map(|row| (image * rows) as i32 + row as i32)
        };
        let index = each(&cells, |image, cell| row(image, cell));
        let shares = each(&cells, |_, cell| cell.shares);
        let sums = Sums {
            // All sums have the same length.
            starts: (0..=count).map(|cell| (cell * CORNERS) as i32).collect(),
            index,
            shares,
        };
        sums.of(&table, channels)
    }

    fn read_pixels(table: Floats, reads: Arc<PixelReads>) -> Floats {
        let shape = table.shape();
        let (images, rows, channels) = (shape[0], shape[1], shape[2]);
        let count = reads.per_image();
        if table.dtype() != DType::F32 || images * count * channels == 0 {
            return Self::read_between(table, reads.cells());
        }
        let table = into_contiguous(table);
        let device = &table.device;
        let result = empty(&table, [images * count, channels]);
        let pixels = reads.pixels.as_ref().map(|lists| {
            let pixels = lists.iter().flatten().map(|&pixel| pixel as i32);
            integers(pixels.collect(), device)
        });
        let axes = Axes::new(&reads, device);
        read_at_pixels::launch(
            &table.client,
            cubes(&table, images * count * channels),
            cube(),
            table.clone().into_buffer_arg(),
            axes.neighbours.clone().into_buffer_arg(),
            axes.shares.into_buffer_arg(),
            pixels.clone().unwrap_or(axes.neighbours).into_buffer_arg(),
            result.clone().into_buffer_arg(),
            rows as u32,
            reads.map[1] as u32,
            reads.rows.len() as u32,
            reads.columns.len() as u32,
            count as u32,
            channels as u32,
            pixels.is_some(),
        );
        result
    }
}

impl InterpolateGradients for CubeBackend {
    fn read_between_backward(grad: Floats, shape: [usize; 3], cells: BatchCells) -> Floats {
        let [images, rows, channels] = shape;
        if grad.dtype() != DType::F32 || grad.shape().num_elements() == 0 {
            return reference_backward::<Self>(grad, shape, &cells);
        }
        let sums = Sums::transposed(&cells, rows);
        let table = sums.of(&into_contiguous(grad), channels);
        Self::float_reshape(table, Shape::new([images, rows, channels]))
    }

    fn read_pixels_backward(grad: Floats, shape: [usize; 3], reads: Arc<PixelReads>) -> Floats {
        let [images, _, channels] = shape;
        let readers = reads.readers();
        let (of_rows, of_columns) = readers.split_at(reads.map[0]);
        let most = |readers: &[Range<usize>]| readers.iter().map(Range::len).max().unwrap_or(0);
        if grad.dtype() != DType::F32
            || grad.shape().num_elements() == 0
            || most(of_rows) * most(of_columns) > MOST_READERS
        {
            return Self::read_between_backward(grad, shape, reads.cells());
        }
        let grad = into_contiguous(grad);
        let device = &grad.device;
        let result = empty(&grad, shape);
        let bounds = readers.iter().flat_map(|r| [r.start as i32, r.end as i32]);
        let bounds = integers(bounds.collect(), device);
        let places = reads.pixels.as_ref().map(|lists| {
            let [starts, index] = places(lists, reads.rows.len() * reads.columns.len());
            [integers(starts, device), integers(index, device)]
        });
        let listed = places.is_some();
        let [starts, index] = places.unwrap_or_else(|| [bounds.clone(), bounds.clone()]);
        let axes = Axes::new(&reads, device);
        sum_of_readers::launch(
            &grad.client,
            cubes(&grad, images * reads.map[0] * reads.map[1] * channels),
            cube(),
            grad.clone().into_buffer_arg(),
            axes.neighbours.into_buffer_arg(),
            axes.shares.into_buffer_arg(),
            bounds.into_buffer_arg(),
            starts.into_buffer_arg(),
            index.into_buffer_arg(),
            result.clone().into_buffer_arg(),
            reads.map[0] as u32,
            reads.map[1] as u32,
            reads.rows.len() as u32,
            reads.columns.len() as u32,
            channels as u32,
            listed,
        );
        result
    }
}

/// Returns the entries of a list of pixels by their pixel: where those of each pixel of each image start, and the end; and the
/// entries, counted over all images.
fn places(lists: &[Vec<u32>], pixels: usize) -> [Vec<i32>; 2] {
    let parts: Vec<[Vec<i32>; 2]> = lists
        .par_iter()
        .enumerate()
        .map(|(image, list)| {
            let first = image * list.len();
            let mut starts = vec![0_i32; pixels];
            for &pixel in list {
                starts[pixel as usize] += 1;
            }
            let mut sum = first as i32;
            for start in &mut starts {
                sum += std::mem::replace(start, sum);
            }
            let mut next = starts.clone();
            let mut index = vec![0; list.len()];
            for (entry, &pixel) in list.iter().enumerate() {
                let place = &mut next[pixel as usize];
                index[*place as usize - first] = (first + entry) as i32;
                *place += 1;
            }
            [starts, index]
        })
        .collect();
    let mut all = [Vec::new(), Vec::new()];
    for part in parts {
        for (all, part) in all.iter_mut().zip(part) {
            all.extend(part);
        }
    }
    let [starts, index] = &mut all;
    starts.push(index.len() as i32);
    all
}

/// The positions of the rows of images, then of their columns, on a device.
struct Axes {
    /// Two neighbours of each.
    neighbours: CubeTensor,
    /// Weight of the second neighbour.
    shares: CubeTensor,
}

impl Axes {
    fn new(reads: &PixelReads, device: &CubeDevice) -> Self {
        let all = || reads.rows.iter().chain(&reads.columns);
        let neighbours = all().flat_map(|&(low, high, _)| [low as i32, high as i32]);
        let shares: Vec<f32> = all().map(|&(_, _, share)| share).collect();
        let length = shares.len();
        Self {
            neighbours: integers(neighbours.collect(), device),
            shares: CubeBackend::float_from_data(TensorData::new(shares, [length]), device),
        }
    }
}

fn integers(values: Vec<i32>, device: &CubeDevice) -> CubeTensor {
    let length = values.len();
    let tensor = CubeBackend::int_from_data(TensorData::new(values, [length]), device);
    CubeBackend::int_cast(tensor, IntDType::I32)
}

/// Returns a value for every row of every cell.
fn each<T: Send>(
    cells: &BatchCells,
    of: impl Fn(usize, &BilinearCell) -> [T; CORNERS] + Sync,
) -> Vec<T> {
    let images = cells.par_iter().enumerate();
    let of = &of;
    let parts = images.flat_map_iter(|(image, cells)| cells.iter().flat_map(move |c| of(image, c)));
    parts.collect()
}

/// Weighted sums of rows of a table: a sparse matrix in CSR format.
struct Sums {
    /// Start of the entries of each sum, and the end of the last one.
    starts: Vec<i32>,
    /// Row of the table of each entry.
    index: Vec<i32>,
    /// Weight of each entry.
    shares: Vec<f32>,
}

impl Sums {
    /// Returns, for each of the `rows` of each image, the sum of the cells that read it, in the order of cells.
    fn transposed(cells: &BatchCells, rows: usize) -> Self {
        let firsts: Vec<usize> = cells
            .iter()
            .scan(0, |sum, cells| {
                *sum += cells.len();
                Some(*sum - cells.len())
            })
            .collect();
        let parts: Vec<Self> = cells
            .par_iter()
            .zip(firsts)
            .map(|(cells, first)| Self::of_image(cells, first, rows))
            .collect();
        let mut all = Self {
            starts: vec![0],
            index: Vec::new(),
            shares: Vec::new(),
        };
        for part in parts {
            let before = all.index.len() as i32;
            all.starts
                .extend(part.starts[1..].iter().map(|at| before + at));
            all.index.extend(part.index);
            all.shares.extend(part.shares);
        }
        all
    }

    /// Returns the sums of one image, whose cells are counted from `first`.
    fn of_image(cells: &[BilinearCell], first: usize, rows: usize) -> Self {
        let mut starts = vec![0_i32; rows + 1];
        for row in cells.iter().flat_map(|cell| cell.rows) {
            starts[row as usize + 1] += 1;
        }
        for row in 0..rows {
            starts[row + 1] += starts[row];
        }
        let mut next = starts.clone();
        let mut index = vec![0; cells.len() * CORNERS];
        let mut shares = vec![0.0; cells.len() * CORNERS];
        for (number, cell) in cells.iter().enumerate() {
            for (row, share) in cell.rows.into_iter().zip(cell.shares) {
                let place = &mut next[row as usize];
                index[*place as usize] = (first + number) as i32;
                shares[*place as usize] = share;
                *place += 1;
            }
        }
        Self {
            starts,
            index,
            shares,
        }
    }

    /// Returns the sums `[sums, channels]` of a table with contiguous rows.
    fn of(self, table: &CubeTensor, channels: usize) -> CubeTensor {
        let count = self.starts.len() - 1;
        let device = &table.device;
        let result = empty(table, [count, channels]);
        let length = self.shares.len();
        let shares = CubeBackend::float_from_data(TensorData::new(self.shares, [length]), device);
        sum_rows::launch(
            &table.client,
            cubes(table, count * channels),
            cube(),
            table.clone().into_buffer_arg(),
            integers(self.starts, device).into_buffer_arg(),
            integers(self.index, device).into_buffer_arg(),
            shares.into_buffer_arg(),
            result.clone().into_buffer_arg(),
            channels as u32,
        );
        result
    }
}

/// Computes `result [sums, channels]` from `table [rows, channels]`: sum `i` has the entries from `starts[i]` to `starts[i +
/// 1]`, each a row `index` times its `shares`.
#[cube(launch)]
fn sum_rows(
    table: &[f32],
    starts: &[i32],
    index: &[i32],
    shares: &[f32],
    result: &mut [f32],
    channels: u32,
) {
    if ABSOLUTE_POS < result.len() {
        let channels = channels as usize;
        let sum_of = ABSOLUTE_POS / channels;
        let channel = ABSOLUTE_POS % channels;
        let first = starts[sum_of] as usize;
        let last = starts[sum_of + 1] as usize;
        let mut sum = 0.0f32;
        for entry in first..last {
            sum += shares[entry] * table[index[entry] as usize * channels + channel];
        }
        result[ABSOLUTE_POS] = sum;
    }
}

/// Computes `result [images * count, channels]` from `table [images, rows, channels]`. `neighbours` and `shares` are the
/// positions of the `height` rows and `width` columns of images in maps of width `map_width`; `pixels` are used if `listed`.
#[cube(launch)]
fn read_at_pixels(
    table: &[f32],
    neighbours: &[i32],
    shares: &[f32],
    pixels: &[i32],
    result: &mut [f32],
    rows: u32,
    map_width: u32,
    height: u32,
    width: u32,
    count: u32,
    channels: u32,
    #[comptime] listed: bool,
) {
    if ABSOLUTE_POS < result.len() {
        let (rows, channels) = (rows as usize, channels as usize);
        let (map_width, height, width) = (map_width as usize, height as usize, width as usize);
        let entry = ABSOLUTE_POS / channels;
        let channel = ABSOLUTE_POS % channels;
        let image = entry / count as usize;
        let mut pixel = entry % count as usize;
        if comptime!(listed) {
            pixel = pixels[entry] as usize;
        }
        let y = pixel / width;
        let x = height + pixel % width;
        let (v, u) = (shares[y], shares[x]);
        let top = image * rows + neighbours[2 * y] as usize * map_width;
        let bottom = image * rows + neighbours[2 * y + 1] as usize * map_width;
        let left = neighbours[2 * x] as usize;
        let right = neighbours[2 * x + 1] as usize;
        result[ABSOLUTE_POS] =
            (1.0f32 - v) * (1.0f32 - u) * table[(top + left) * channels + channel]
                + (1.0f32 - v) * u * table[(top + right) * channels + channel]
                + v * (1.0f32 - u) * table[(bottom + left) * channels + channel]
                + v * u * table[(bottom + right) * channels + channel];
    }
}

/// Returns the weight of value `at` of an axis of a map for a position of an image on that axis.
#[cube]
fn weight_of(neighbours: &[i32], shares: &[f32], position: usize, at: usize) -> f32 {
    let share = shares[position];
    let mut weight = 0.0f32;
    if neighbours[2 * position] as usize == at {
        weight += 1.0f32 - share;
    }
    if neighbours[2 * position + 1] as usize == at {
        weight += share;
    }
    weight
}

/// Computes the gradient `result [images, map_height, map_width, channels]` of maps from that of the pixels that read them:
/// those between the `bounds` of each row and column of the maps. If `listed`, the entries of a pixel are `index` from its
/// start to that of the next one.
#[cube(launch)]
fn sum_of_readers(
    grad: &[f32],
    neighbours: &[i32],
    shares: &[f32],
    bounds: &[i32],
    starts: &[i32],
    index: &[i32],
    result: &mut [f32],
    map_height: u32,
    map_width: u32,
    height: u32,
    width: u32,
    channels: u32,
    #[comptime] listed: bool,
) {
    if ABSOLUTE_POS < result.len() {
        let (map_height, map_width) = (map_height as usize, map_width as usize);
        let (height, width, channels) = (height as usize, width as usize, channels as usize);
        let channel = ABSOLUTE_POS % channels;
        let column = ABSOLUTE_POS / channels % map_width;
        let row = ABSOLUTE_POS / channels / map_width % map_height;
        let image = ABSOLUTE_POS / channels / map_width / map_height;
        let of_column = map_height + column;
        let mut sum = 0.0f32;
        for y in bounds[2 * row] as usize..bounds[2 * row + 1] as usize {
            let down = weight_of(neighbours, shares, y, row);
            for x in bounds[2 * of_column] as usize..bounds[2 * of_column + 1] as usize {
                let weight = down * weight_of(neighbours, shares, height + x, column);
                let pixel = (image * height + y) * width + x;
                if comptime!(listed) {
                    for entry in starts[pixel] as usize..starts[pixel + 1] as usize {
                        sum += weight * grad[index[entry] as usize * channels + channel];
                    }
                } else {
                    sum += weight * grad[pixel * channels + channel];
                }
            }
        }
        result[ABSOLUTE_POS] = sum;
    }
}
