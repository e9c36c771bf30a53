//! Spatial propagation (Cheng et al. 2018): in each step, a pixel becomes a weighted sum of its eight neighbours and
//! of its initial value, and known pixels keep their values.

use rayon::prelude::*;

/// Number of neighbours of a pixel, and of its weights.
pub const NEIGHBOURS: usize = 8;

/// Row and column offsets of the neighbours of a pixel.
pub const OFFSETS: [(isize, isize); NEIGHBOURS] = [
    (1, 1),
    (1, 0),
    (1, -1),
    (0, 1),
    (0, -1),
    (-1, 1),
    (-1, 0),
    (-1, -1),
];

/// A map with a border of zeros.
struct Padded {
    values: Vec<f32>,
    width: usize,
}

impl Padded {
    fn new(map: &[f32], height: usize, width: usize) -> Self {
        let mut padded = Self {
            values: vec![0.0; (height + 2) * (width + 2)],
            width,
        };
        for (row, values) in map.chunks_exact(width).enumerate() {
            let start = padded.index(row, 0);
            padded.values[start..start + width].copy_from_slice(values);
        }
        padded
    }

    fn index(&self, row: usize, column: usize) -> usize {
        (row + 1) * (self.width + 2) + column + 1
    }

    /// Returns the offsets of the neighbours in memory.
    fn strides(&self) -> [isize; NEIGHBOURS] {
        OFFSETS.map(|(rows, columns)| rows * (self.width as isize + 2) + columns)
    }

    /// Returns the neighbours of a pixel that is not in the border.
    fn neighbours(&self, index: usize, strides: &[isize; NEIGHBOURS]) -> [f32; NEIGHBOURS] {
        strides.map(|stride| self.values[index.wrapping_add_signed(stride)])
    }
}

fn check(weights: &[f32], maps: &[&[f32]], height: usize, width: usize) {
    assert!(width > 0 && height > 0, "a map without pixels");
    let pixels = height * width;
    assert_eq!(weights.len(), NEIGHBOURS * pixels, "weights of all pixels");
    for map in maps {
        assert_eq!(map.len(), pixels, "maps of one size");
    }
}

/// Returns the inputs of all steps, and the output of the last one.
fn run_steps(
    weights: &[f32],
    start: &[f32],
    known: &[f32],
    (height, width): (usize, usize),
    steps: usize,
) -> (Vec<Padded>, Vec<f32>) {
    let mut states = Vec::with_capacity(steps);
    let mut map = start.to_vec();
    for _ in 0..steps {
        let state = Padded::new(&map, height, width);
        let strides = state.strides();
        map.par_chunks_mut(width)
            .enumerate()
            .for_each(|(row, line)| {
                for (column, value) in line.iter_mut().enumerate() {
                    let pixel = row * width + column;
                    if known[pixel] > 0.0 {
                        *value = known[pixel];
                        continue;
                    }
                    let neighbours = state.neighbours(state.index(row, column), &strides);
                    let weights = &weights[NEIGHBOURS * pixel..][..NEIGHBOURS];
                    let (mut sum, mut weight_sum) = (0.0, 0.0);
                    for (weight, neighbour) in weights.iter().zip(neighbours) {
                        sum += weight * neighbour;
                        weight_sum += weight;
                    }
                    *value = sum + (1.0 - weight_sum) * start[pixel];
                }
            });
        states.push(state);
    }
    (states, map)
}

/// Propagates `start [height, width]` with `weights [height, width, 8]` for some steps; pixels of `known` above 0 are set to
/// these values after each step. The weight of a pixel's start value is 1 minus the sum of its weights.
///
/// # Panics
/// If a slice does not match a map of this size.
pub fn propagate(
    weights: &[f32],
    start: &[f32],
    known: &[f32],
    (height, width): (usize, usize),
    steps: usize,
) -> Vec<f32> {
    check(weights, &[start, known], height, width);
    run_steps(weights, start, known, (height, width), steps).1
}

/// Returns the gradients of weights and start from that of the result.
///
/// # Panics
/// As for [`propagate`].
pub fn propagate_gradients(
    weights: &[f32],
    start: &[f32],
    known: &[f32],
    gradient: &[f32],
    (height, width): (usize, usize),
    steps: usize,
) -> (Vec<f32>, Vec<f32>) {
    check(weights, &[start, known, gradient], height, width);
    let (states, _) = run_steps(weights, start, known, (height, width), steps);
    let mut of_weights = vec![0.0; weights.len()];
    let mut of_start = vec![0.0; start.len()];
    let mut gradient = gradient.to_vec();
    for state in states.iter().rev() {
        for (gradient, known) in gradient.iter_mut().zip(known) {
            // Known pixels block the gradient.
            if *known > 0.0 {
                *gradient = 0.0;
            }
        }
        let later = Padded::new(&gradient, height, width);
        let strides = state.strides();
        of_weights
            .par_chunks_mut(NEIGHBOURS * width)
            .zip(of_start.par_chunks_mut(width))
            .zip(gradient.par_chunks_mut(width))
            .enumerate()
            .for_each(|(row, ((of_weights, of_start), earlier))| {
                for column in 0..width {
                    let (pixel, index) = (row * width + column, state.index(row, column));
                    let own = later.values[index];
                    let mine = &weights[NEIGHBOURS * pixel..][..NEIGHBOURS];
                    of_start[column] += own * (1.0 - mine.iter().sum::<f32>());
                    let neighbours = state.neighbours(index, &strides);
                    let gradients = &mut of_weights[NEIGHBOURS * column..][..NEIGHBOURS];
                    for (gradient, neighbour) in gradients.iter_mut().zip(neighbours) {
                        *gradient += own * (neighbour - start[pixel]);
                    }
                    // The pixels that have this pixel as a neighbour.
                    let mut sum = 0.0;
                    for (k, (rows, columns)) in OFFSETS.into_iter().enumerate() {
                        let (y, x) = (
                            row.checked_add_signed(-rows).filter(|y| *y < height),
                            column.checked_add_signed(-columns).filter(|x| *x < width),
                        );
                        if let (Some(y), Some(x)) = (y, x) {
                            let weight = weights[NEIGHBOURS * (y * width + x) + k];
                            sum += weight * later.values[later.index(y, x)];
                        }
                    }
                    earlier[column] = sum;
                }
            });
    }
    for (sum, gradient) in of_start.iter_mut().zip(gradient) {
        *sum += gradient;
    }
    (of_weights, of_start)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_reads_the_neighbours_and_the_start() {
        // One pixel of a map of 2x2 reads its right neighbour with weight 0.5.
        let mut weights = vec![0.0; 4 * NEIGHBOURS];
        weights[3] = 0.5;
        let start = [1.0, 5.0, 7.0, 9.0];
        let known = [0.0, 0.0, 2.0, 0.0];
        let run = |steps| propagate(&weights, &start, &known, (2, 2), steps);
        assert_eq!(run(0), start);
        assert_eq!(run(1), [0.5 * 1.0 + 0.5 * 5.0, 5.0, 2.0, 9.0]);
        assert_eq!(run(2), [3.0, 5.0, 2.0, 9.0]);
        let gradients = propagate_gradients(&weights, &start, &known, &[1.0; 4], (2, 2), 1);
        assert_eq!(gradients.1, [0.5, 1.5, 0.0, 1.0]);
        assert_eq!(gradients.0[3], 4.0);
        // Values outside the map are 0.
        assert_eq!(gradients.0[6], -1.0);
    }
}
