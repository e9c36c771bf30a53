//! The operation on GPUs: one unit per value of the result, or of the gradient, sums its terms. Burn's own operations add the
//! rows of a gradient sequentially.

use super::{
    BatchCells, BilinearCell, InterpolateBackend, InterpolateGradients, reference,
    reference_backward,
};
use crate::ops::gpu::{cube, cubes, empty};
use burn::backend::TensorMetadata as _;
use burn::backend::ops::{FloatTensorOps, IntTensorOps};
use burn::backend::tensor::FloatTensor;
use burn::tensor::{DType, IntDType, Shape, TensorData};
use burn_cubecl::CubeBackend;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::tensor::CubeTensor;
use rayon::prelude::*;

/// Number of rows of a cell.
const CORNERS: usize = 4;

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
        let integers = |values: Vec<i32>| {
            let length = values.len();
            let tensor = CubeBackend::int_from_data(TensorData::new(values, [length]), device);
            CubeBackend::int_cast(tensor, IntDType::I32)
        };
        let length = self.shares.len();
        let shares = CubeBackend::float_from_data(TensorData::new(self.shares, [length]), device);
        sum_rows::launch(
            &table.client,
            cubes(table, count * channels),
            cube(),
            table.clone().into_buffer_arg(),
            integers(self.starts).into_buffer_arg(),
            integers(self.index).into_buffer_arg(),
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
