//! Kernel regression (Takeda, Farsiu and Milanfar 2007) of scattered depths, differentiable in the kernels: at every pixel a
//! polynomial is fitted to the nearest points, each weighted by its own Gaussian kernel.

#[cfg(test)]
use burn::tensor::Device;
use burn::tensor::{Int, Tensor, TensorData};
use lsdc_core::nearest::NeighbourGrid;
use rayon::prelude::*;

/// Ridge on slopes and curvatures, as a share of the sum of weights, with coordinates in units of the mean distance between
/// points: it limits extrapolation from few points on one side.
const SHRINKAGE: f64 = 0.1;

/// The points of some images, and the nearest points of every pixel.
pub(super) struct Neighbourhood {
    /// Pixel of each point; lists have the same length and are padded with pixel 0.
    pub(super) pixels: Vec<Vec<u32>>,
    /// Indices of the nearest points of each pixel, `[n, pixels * nearest]`.
    nearest: Tensor<2, Int>,
    /// Offsets in rows and columns from the pixel to each nearest point, in pixels, `[n, pixels, nearest]`.
    offsets: [Tensor<3>; 2],
    /// Mean distance between points, `[n, 1, 1]`.
    spacing: Tensor<3>,
    /// Depths of the nearest points, `[n, pixels, nearest]`.
    depths: Tensor<3>,
    /// 1 if the point exists, 0 for padding.
    there: Tensor<3>,
}

impl Neighbourhood {
    /// Finds the points of sparse maps `[n, height, width]`; an image without points has a single point of depth 0.
    pub(super) fn new(sparse: &Tensor<3>, most: usize) -> Self {
        let [n, height, width] = sparse.dims();
        let (device, dtype) = (sparse.device(), sparse.dtype());
        let values: Vec<f32> = sparse.clone().into_data().iter().collect();
        let lists: Vec<Vec<u32>> = values.chunks_exact(height * width).map(points).collect();
        let longest = lists.iter().map(Vec::len).max().unwrap_or(1);
        let count = most.min(longest);
        let images = lists.iter().zip(values.chunks_exact(height * width));
        let found: Vec<NearestPoints> = images
            .map(|(list, map)| NearestPoints::new(list, map, width, count))
            .collect();
        let shape = [n, height * width, count];
        let all = |of: fn(&NearestPoints) -> &Vec<f32>| -> Tensor<3> {
            let values: Vec<f32> = found.iter().flat_map(|f| of(f).iter().copied()).collect();
            Tensor::from_data(TensorData::new(values, shape), (&device, dtype))
        };
        let nearest: Vec<i32> = found.iter().flat_map(|f| f.nearest.clone()).collect();
        let nearest = TensorData::new(nearest, [n, height * width * count]);
        let spacing = lists
            .iter()
            .map(|list| ((height * width) as f32 / list.len() as f32).sqrt());
        let spacing = TensorData::new(spacing.collect::<Vec<_>>(), [n, 1, 1]);
        let mut pixels = lists;
        for list in &mut pixels {
            list.resize(longest, 0);
        }
        Self {
            pixels,
            nearest: Tensor::from_data(nearest, &device),
            offsets: [all(|f| &f.rows), all(|f| &f.columns)],
            spacing: Tensor::from_data(spacing, (&device, dtype)),
            depths: all(|f| &f.depths),
            there: all(|f| &f.there),
        }
    }

    /// Reads values of the points `[n, points]` at the nearest points of each pixel.
    fn read(&self, values: Tensor<2>) -> Tensor<3> {
        values
            .gather(1, self.nearest.clone())
            .reshape(self.depths.dims())
    }

    /// Returns the value at every pixel, `[n, pixels]`, of a polynomial of `order` (0, 1 or 2) fitted around it.
    pub(super) fn regress(&self, kernels: &SteeringKernels, order: usize) -> Tensor<2> {
        let weights = self.weights(kernels);
        let [rows, columns] = self
            .offsets
            .clone()
            .map(|offset| offset / self.spacing.clone());
        let one = Tensor::ones_like(&rows);
        let mut terms = vec![one];
        if order > 0 {
            terms.extend([rows.clone(), columns.clone()]);
        }
        if order > 1 {
            terms.extend([
                rows.clone() * rows.clone(),
                rows * columns.clone(),
                columns.clone() * columns,
            ]);
        }
        let sum = |values: Tensor<3>| values.sum_dim(2).squeeze_dim::<2>(2);
        let weighted: Vec<_> = terms.iter().map(|t| weights.clone() * t.clone()).collect();
        let mut right: Vec<_> = weighted
            .iter()
            .map(|w| sum(w.clone() * self.depths.clone()))
            .collect();
        // Lower triangle of the normal equations.
        let mut matrix: Vec<Vec<_>> = weighted
            .iter()
            .enumerate()
            .map(|(i, w)| {
                terms[..=i]
                    .iter()
                    .map(|t| sum(w.clone() * t.clone()))
                    .collect()
            })
            .collect();
        let shrinkage = matrix[0][0].clone() * SHRINKAGE;
        // Eliminates all coefficients but the constant, the last one first.
        for last in (1..terms.len()).rev() {
            let row: Vec<Tensor<2>> = matrix.pop().unwrap_or_default();
            let pivot = row[last].clone() + shrinkage.clone();
            let factors: Vec<_> = row[..last]
                .iter()
                .map(|t| t.clone() / pivot.clone())
                .collect();
            for i in 0..last {
                for (k, factor) in factors[..=i].iter().enumerate() {
                    matrix[i][k] = matrix[i][k].clone() - row[i].clone() * factor.clone();
                }
                right[i] = right[i].clone() - factors[i].clone() * right[last].clone();
            }
        }
        right[0].clone() / matrix[0][0].clone()
    }

    /// Returns the weight of each point at each pixel, `[n, pixels, nearest]`; the largest is 1.
    fn weights(&self, kernels: &SteeringKernels) -> Tensor<3> {
        /// Larger than the magnitude of the logarithm of any weight.
        const NEVER: f64 = 1e9;
        let [rows, columns] = self.offsets.clone();
        let [first, both, second] = kernels.precision.clone().map(|part| self.read(part));
        let apart = first * rows.clone().square()
            + both * rows * columns.clone() * 2.0
            + second * columns.square();
        let exponent = apart * (-0.5 / (WIDTH * WIDTH));
        let exponent = if kernels.bounded {
            exponent.tanh() * 2.0
        } else {
            exponent
        };
        let heights = self.read(kernels.height.clone());
        let logarithm = exponent + heights - (self.there.clone().neg() + 1.0) * NEVER;
        let most = logarithm.clone().detach().max_dim(2);
        (logarithm - most).exp()
    }
}

/// Kernels of the points of some images.
pub(super) struct SteeringKernels {
    /// Inverse covariances, in units of [`WIDTH`]: row-row, row-column and column-column entries, each `[n, points]`.
    pub(super) precision: [Tensor<2>; 3],
    /// Logarithms of the heights at the centres, `[n, points]`.
    pub(super) height: Tensor<2>,
    /// Whether weights have a lower bound: `exp(2 tanh(.))` instead of `exp(.)`.
    pub(super) bounded: bool,
}

/// Width of kernels in pixels, the unit of all precisions: the `h` of Liu et al.
pub(super) const WIDTH: f64 = 5.0;

impl SteeringKernels {
    /// Creates kernels from positive elongation and scale, and angle, each `[n, points]`: the precision is `scale U
    /// diag(elongation, 1 / elongation) U^T` with the rotation U, and the height is the scale.
    pub(super) fn new(
        elongation: Tensor<2>,
        angle: Tensor<2>,
        scale: Tensor<2>,
        bounded: bool,
    ) -> Self {
        let (sin, cos) = (angle.clone().sin(), angle.cos());
        let inverse = elongation.clone().recip();
        let along =
            |a: Tensor<2>, b: Tensor<2>| a * cos.clone().square() + b * sin.clone().square();
        let rows = along(elongation.clone(), inverse.clone());
        let columns = along(inverse.clone(), elongation.clone());
        let both = (inverse - elongation) * sin * cos;
        Self {
            precision: [rows, both, columns].map(|part| part * scale.clone()),
            height: scale.log(),
            bounded,
        }
    }
}

/// Returns the pixels of a map that have a depth; the first pixel if there is none.
fn points(map: &[f32]) -> Vec<u32> {
    let all = (0..map.len() as u32).filter(|&i| map[i as usize] > 0.0);
    let mut list: Vec<u32> = all.collect();
    if list.is_empty() {
        list.push(0);
    }
    list
}

/// Nearest points of the pixels of an image.
#[derive(Default)]
struct NearestPoints {
    nearest: Vec<i32>,
    rows: Vec<f32>,
    columns: Vec<f32>,
    depths: Vec<f32>,
    there: Vec<f32>,
}

impl NearestPoints {
    fn new(list: &[u32], map: &[f32], width: usize, count: usize) -> Self {
        let place = |pixel: u32| {
            [
                (pixel as usize % width) as f64,
                (pixel as usize / width) as f64,
            ]
        };
        let places: Vec<[f64; 2]> = list.iter().map(|&pixel| place(pixel)).collect();
        let cells = NeighbourGrid::new(&places);
        let nearest: Vec<Vec<(f64, usize)>> = (0..map.len() as u32)
            .into_par_iter()
            .map(|pixel| cells.nearest(place(pixel), count))
            .collect();
        let mut found = Self::default();
        for (pixel, near) in nearest.iter().enumerate() {
            let [column, row] = place(pixel as u32);
            for rank in 0..count {
                let point = near.get(rank).map(|(_, point)| *point);
                let at = point.unwrap_or(0);
                found.nearest.push(at as i32);
                found.rows.push((places[at][1] - row) as f32);
                found.columns.push((places[at][0] - column) as f32);
                found.depths.push(map[list[at] as usize]);
                found.there.push(if point.is_some() { 1.0 } else { 0.0 });
            }
        }
        found
    }
}

/// Returns a constant tensor of values of points.
#[cfg(test)]
fn constant(value: f32, count: usize, device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(vec![value; count], [1, count]), device)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;

    const SIZE: (usize, usize) = (12, 15);

    /// Returns a sparse map of a function of row and column at random points.
    fn sparse(of: impl Fn(f32, f32) -> f32, points: usize, device: &Device) -> Tensor<3> {
        let mut rng = Rng::stream(3, &["points"]);
        let mut map = vec![0.0; SIZE.0 * SIZE.1];
        for _ in 0..points {
            let (row, column) = (rng.below(SIZE.0 as u32), rng.below(SIZE.1 as u32));
            map[row as usize * SIZE.1 + column as usize] = of(row as f32, column as f32);
        }
        Tensor::from_data(TensorData::new(map, [1, SIZE.0, SIZE.1]), device)
    }

    fn round(points: &Neighbourhood, scale: f32, device: &Device) -> SteeringKernels {
        let count = points.pixels[0].len();
        let of = |value| constant(value, count, device);
        SteeringKernels::new(of(1.0), of(0.0), of(scale), false)
    }

    #[test]
    fn kernels_are_turned_and_stretched() {
        let device = Device::flex();
        let of = |value| constant(value, 1, &device);
        let turn = std::f32::consts::FRAC_PI_3;
        let kernels = SteeringKernels::new(of(4.0), of(turn), of(2.0), false);
        let [a, b, c] = kernels.precision.map(|part| part.into_scalar::<f32>());
        // Trace and determinant of 2 diag(4, 1/4).
        assert!((a + c - 8.5).abs() < 1e-5 && (a * c - b * b - 4.0).abs() < 1e-4);
        // The eigenvector of the larger eigenvalue, 8: (cos, -sin).
        let (cos, sin) = (turn.cos(), -turn.sin());
        assert!((a * cos + b * sin - 8.0 * cos).abs() < 1e-5);
        assert!((b * cos + c * sin - 8.0 * sin).abs() < 1e-5);
    }

    #[test]
    fn weighted_means_agree_with_a_plain_sum() {
        let device = Device::flex();
        let map = sparse(|row, column| 1.0 + row + 0.1 * column * column, 20, &device);
        let points = Neighbourhood::new(&map, 100);
        let found = points.regress(&round(&points, 0.7, &device), 0);
        let found: Vec<f32> = found.into_data().iter().collect();
        let map: Vec<f32> = map.into_data().iter().collect();
        for (pixel, found) in found.iter().enumerate() {
            let (mut sum, mut weights) = (0.0_f64, 0.0_f64);
            for (other, &depth) in map.iter().enumerate().filter(|(_, depth)| **depth > 0.0) {
                let rows = (other / SIZE.1) as f64 - (pixel / SIZE.1) as f64;
                let columns = (other % SIZE.1) as f64 - (pixel % SIZE.1) as f64;
                let weight = (-0.7 * (rows * rows + columns * columns) / 50.0).exp();
                sum += weight * f64::from(depth);
                weights += weight;
            }
            assert!((f64::from(*found) - sum / weights).abs() < 1e-4);
        }
    }

    #[test]
    fn depths_are_met_by_polynomials_of_their_order_but_for_what_is_held() {
        let device = Device::flex();
        let plane = sparse(|row, column| 3.0 + 0.05 * row - 0.02 * column, 60, &device);
        let points = Neighbourhood::new(&plane, 40);
        let error = |order| {
            let found = points.regress(&round(&points, 2.0, &device), order);
            let found: Vec<f32> = found.into_data().iter().collect();
            let errors = found.iter().enumerate().map(|(pixel, found)| {
                let (row, column) = ((pixel / SIZE.1) as f32, (pixel % SIZE.1) as f32);
                (found - (3.0 + 0.05 * row - 0.02 * column)).powi(2)
            });
            (errors.sum::<f32>() / (SIZE.0 * SIZE.1) as f32).sqrt()
        };
        let errors = [0, 1, 2].map(error);
        assert!(
            errors[1] < 0.35 * errors[0] && errors[2] < 0.35 * errors[0],
            "{errors:?}"
        );
        assert!(errors[1] < 0.02, "{errors:?}");
    }

    #[test]
    fn far_points_count_where_there_are_no_others() {
        let device = Device::flex();
        let map = sparse(|_, _| 2.5, 1, &device);
        let points = Neighbourhood::new(&map, 8);
        let found = points.regress(&round(&points, 6.0, &device), 2);
        for value in found.into_data().iter::<f32>() {
            assert!((value - 2.5).abs() < 1e-5, "{value}");
        }
    }

    #[test]
    fn gradients_of_kernels_agree_with_central_differences() {
        let device = Device::flex().autodiff();
        let map = sparse(
            |row, column| 1.0 + (row * 0.4).sin() + 0.2 * column,
            14,
            &device,
        );
        let points = Neighbourhood::new(&map, 6);
        let count = points.pixels[0].len();
        let mut rng = Rng::stream(4, &["kernels"]);
        let mut draw = |low: f32, high: f32| -> Vec<f32> {
            (0..count).map(|_| rng.range(low, high)).collect()
        };
        let start = [draw(0.5, 2.0), draw(-1.0, 1.0), draw(0.3, 1.5)];
        let tensors = |values: &[Vec<f32>; 3]| {
            values
                .clone()
                .map(|values| Tensor::<2>::from_data(TensorData::new(values, [1, count]), &device))
        };
        for (order, bounded) in [(0, false), (1, true), (2, false)] {
            let value = |[elongation, angle, scale]: [Tensor<2>; 3]| {
                let kernels = SteeringKernels::new(elongation, angle, scale, bounded);
                points.regress(&kernels, order).square().mean()
            };
            let inputs = tensors(&start).map(Tensor::require_grad);
            let gradients = value(inputs.clone()).backward();
            for (which, input) in inputs.iter().enumerate() {
                let gradient: Vec<f32> =
                    input.grad(&gradients).unwrap().into_data().iter().collect();
                for i in 0..count {
                    let moved = |by: f32| {
                        let mut moved = start.clone();
                        moved[which][i] += by;
                        f64::from(value(tensors(&moved)).into_scalar::<f32>())
                    };
                    let difference = (moved(1e-2) - moved(-1e-2)) / 2e-2;
                    let apart = (difference - f64::from(gradient[i])).abs();
                    assert!(
                        apart < 2e-3 * (1.0 + difference.abs()),
                        "{order} {which}: {apart}"
                    );
                }
            }
        }
    }
}
