use super::*;
use crate::bilinear::InterpolationWeights;
use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};
use lsdc_rng::Rng;

struct Example {
    size: [usize; 2],
    right: Vec<f64>,
    down: Vec<f64>,
    interpolation: Vec<InterpolationWeights>,
    weights: Vec<f64>,
    columns: Vec<f64>,
    diagonal_regularisation: f64,
}

const COLUMNS: usize = 4;

impl Example {
    /// With observations on the centres of pixels, no two on the same.
    fn new(height: usize, width: usize, points: usize) -> Self {
        let mut rng = Rng::stream(height as u64, &["field"]);
        let mut draw = |n: usize| (0..n).map(|_| f64::from(rng.unit())).collect::<Vec<_>>();
        // From 1e-4 to 1, as at edges of images.
        let strengths = |unit: Vec<f64>| unit.into_iter().map(|v| 10f64.powf(-4.0 * v)).collect();
        let right = strengths(draw(height * width));
        let down = strengths(draw(height * width));
        let weights = draw(points).into_iter().map(|v| 1.0 + 99.0 * v).collect();
        let columns = draw(points * COLUMNS);
        let mut pixels: Vec<u32> = (0..(height * width) as u32).collect();
        rng.choose(&mut pixels, points);
        pixels.truncate(points);
        Self {
            size: [height, width],
            right,
            down,
            interpolation: pixels
                .into_iter()
                .map(InterpolationWeights::pixel)
                .collect(),
            weights,
            columns,
            diagonal_regularisation: [0.0, 0.01][height % 2],
        }
    }

    /// With observations anywhere: between pixels, beyond the outermost centres, several in one place.
    fn between(self, seed: u64) -> Self {
        let mut rng = Rng::stream(seed, &["between"]);
        let size = (self.size[0], self.size[1]);
        let mut place = |length: usize| f64::from(rng.unit()) * length as f64 - 0.5;
        let mut interpolation = self.interpolation.clone();
        for (i, interpolation) in interpolation.iter_mut().enumerate() {
            if i % 4 > 0 {
                *interpolation =
                    InterpolationWeights::new([place(size.1), place(size.0)], size, size);
            }
        }
        if let [first, .., last] = &mut interpolation[..] {
            *last = *first;
        }
        Self {
            interpolation,
            ..self
        }
    }

    fn grid(&self, diagonal_regularisation: f64) -> Grid<'_> {
        Grid {
            height: self.size[0],
            width: self.size[1],
            right: &self.right,
            down: &self.down,
            diagonal_regularisation,
        }
    }

    fn observed(&self) -> PrecisionSolver {
        PrecisionSolver::new(
            &self.grid(self.diagonal_regularisation),
            &self.interpolation,
            &self.weights,
        )
        .unwrap()
    }

    fn covariance_solver(&self) -> CovarianceSolver {
        let prior = FieldPrior::new(&self.grid(self.diagonal_regularisation)).unwrap();
        CovarianceSolver::new(&prior, &self.interpolation, &self.weights, &self.columns).unwrap()
    }

    /// The targets `columns x`.
    fn targets(&self, x: &[f64]) -> Vec<f64> {
        let rows = self.columns.chunks_exact(COLUMNS);
        let target = |row: &[f64]| row.iter().zip(x).map(|(a, b)| a * b).sum();
        rows.map(target).collect()
    }

    /// The equations of y as a dense matrix.
    fn dense(&self) -> Mat<f64> {
        let [height, width] = self.size;
        let pixels = height * width;
        let mut matrix =
            Mat::<f64>::identity(pixels, pixels) * faer::Scale(self.diagonal_regularisation);
        let mut join = |i: usize, j: usize, strength: f64| {
            matrix[(i, i)] += strength;
            matrix[(j, j)] += strength;
            matrix[(i, j)] -= strength;
            matrix[(j, i)] -= strength;
        };
        for i in 0..height * width {
            if i % width + 1 < width {
                join(i, i + 1, self.right[i]);
            }
            if i + width < height * width {
                join(i, i + width, self.down[i]);
            }
        }
        for (interpolation, weight) in self.interpolation.iter().zip(&self.weights) {
            for (one, share) in interpolation.iter() {
                for (other, across) in interpolation.iter() {
                    matrix[(one as usize, other as usize)] += weight * share * across;
                }
            }
        }
        matrix
    }

    /// The right-hand side for targets `columns x`.
    fn right_side(&self, x: &[f64]) -> Mat<f64> {
        let mut right = Mat::zeros(self.size[0] * self.size[1], 1);
        for (i, interpolation) in self.interpolation.iter().enumerate() {
            let row = &self.columns[i * COLUMNS..][..COLUMNS];
            let target: f64 = row.iter().zip(x).map(|(a, b)| a * b).sum();
            for (pixel, share) in interpolation.iter() {
                right[(pixel as usize, 0)] += self.weights[i] * share * target;
            }
        }
        right
    }
}

/// From few points, which all remain until the end, to more than any region keeps, and a grid of one row; on pixels and between
/// them.
fn examples() -> [Example; 10] {
    [
        Example::new(23, 31, 1).between(1),
        Example::new(30, 22, 60).between(2),
        Example::new(25, 40, 420).between(3),
        Example::new(21, 21, 441).between(4),
        Example::new(1, 90, 7).between(5),
        Example::new(23, 31, 1),
        Example::new(30, 22, 60),
        Example::new(25, 40, 420),
        Example::new(21, 21, 441),
        Example::new(1, 90, 7),
    ]
}

/// With lumping, every other observation is one observation of each of its pixels. If all are lumped, and there is no
/// regularisation, the field is nowhere outside the range of the targets.
#[test]
fn lumped_observations_are_those_of_their_pixels() {
    for example in examples() {
        let (interpolation, weights) = (&example.interpolation, &example.weights);
        let lumped = |i: usize| i.is_multiple_of(2);
        let grid = example.grid(example.diagonal_regularisation);
        let field = PrecisionSolver::with_lumped(&grid, interpolation, weights, lumped).unwrap();
        let x = [1.0, -0.5, 0.25, 3.0];
        let mut matrix = example.dense();
        for (i, (interpolation, weight)) in interpolation.iter().zip(weights).enumerate() {
            for (one, share) in interpolation.iter().filter(|_| lumped(i)) {
                for (other, across) in interpolation.iter() {
                    matrix[(one as usize, other as usize)] -= weight * share * across;
                }
                matrix[(one as usize, one as usize)] += weight * share;
            }
        }
        let expected = matrix.partial_piv_lu().solve(example.right_side(&x));
        let found = field.extend(&example.targets(&x));
        for (i, found) in found.iter().enumerate() {
            assert!((found - expected[(i, 0)]).abs() < 1e-9, "{i}");
        }
        if example.right.iter().chain(&example.down).any(|c| *c == 0.0) {
            continue;
        }
        let all =
            PrecisionSolver::with_lumped(&example.grid(0.0), interpolation, weights, |_| true)
                .unwrap();
        let targets = example.targets(&x);
        let low = targets.iter().copied().fold(f64::INFINITY, f64::min);
        let high = targets.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        for value in all.extend(&targets) {
            assert!((low - 1e-9..=high + 1e-9).contains(&value), "{value}");
        }
    }
}

#[test]
fn moments_are_the_sum_at_its_minimum() {
    for example in examples() {
        let field = example.observed();
        let x = [1.0, -0.5, 0.25, 3.0];
        // The sum at its minimum, by hand.
        let targets = example.targets(&x);
        let y = field.extend(&targets);
        let width = example.size[1];
        let mut sum = 0.0;
        for i in 0..y.len() {
            sum += example.diagonal_regularisation * y[i].powi(2);
            if i % width + 1 < width {
                sum += example.right[i] * (y[i] - y[i + 1]).powi(2);
            }
            if i + width < y.len() {
                sum += example.down[i] * (y[i] - y[i + width]).powi(2);
            }
        }
        for ((interpolation, weight), target) in example
            .interpolation
            .iter()
            .zip(&example.weights)
            .zip(&targets)
        {
            sum += weight * (interpolation.read(&y) - target).powi(2);
        }
        let pull = field.pull_from(&targets, &field.extend(&targets));
        let products = targets
            .iter()
            .zip(&pull)
            .map(|(target, pull)| target * pull);
        let least = products.sum::<f64>();
        assert!((least - sum).abs() < 1e-9 * sum.max(1.0), "{least} {sum}");
        let moments = field.moments(&example.columns, COLUMNS);
        let pairs = (0..COLUMNS).flat_map(|i| (0..COLUMNS).map(move |j| (i, j)));
        let terms = pairs.map(|(i, j)| moments[(i, j)] * x[i] * x[j]);
        let quadratic = terms.sum::<f64>();
        assert!((quadratic - sum).abs() < 1e-9 * sum.max(1.0));
    }
}

#[test]
fn what_cannot_be_solved_is_refused() {
    let mut example = Example::new(9, 9, 3);
    assert!(PrecisionSolver::new(&example.grid(0.0), &[], &[]).is_none());
    let weights = vec![f64::NAN; 3];
    assert!(PrecisionSolver::new(&example.grid(0.0), &example.interpolation, &weights).is_none());
    example.right[4] = f64::NAN;
    let grid = example.grid(0.1);
    assert!(PrecisionSolver::new(&grid, &example.interpolation, &example.weights).is_none());
    assert!(FieldPrior::new(&grid).is_none());
}

/// Larger grids than a few tiles, and smaller ones than one.
fn large_examples() -> [Example; 8] {
    [
        Example::new(23, 31, 1).between(1),
        Example::new(61, 70, 60).between(2),
        Example::new(25, 40, 420).between(3),
        Example::new(50, 37, 90),
        Example::new(9, 11, 20).between(4),
        Example::new(1, 90, 7).between(5),
        Example::new(90, 2, 30),
        Example::new(1, 1, 1),
    ]
    .map(|example| Example {
        diagonal_regularisation: 1e-4,
        ..example
    })
}

/// Returns the largest difference between lists, relative to the largest value if that is above 1.
fn difference(found: &[f64], expected: impl Iterator<Item = f64>) -> f64 {
    let pairs = found.iter().zip(expected);
    let worst = |(off, most): (f64, f64), (found, expected): (&f64, f64)| {
        (off.max((found - expected).abs()), most.max(expected.abs()))
    };
    let (off, most) = pairs.fold((0.0, 1.0), worst);
    off / most
}

#[test]
fn a_field_with_a_prior_is_that_of_the_dense_equations() {
    for example in large_examples() {
        let field = example.covariance_solver();
        let dense = example.dense().llt(Side::Lower).unwrap();
        let x = [0.5, -1.0, 2.0, 0.25];
        let expected = dense.solve(example.right_side(&x));
        let values = field.extend(&x);
        assert!(difference(&values, expected.col(0).iter().copied()) < 1e-9);
        let right: Vec<f64> = (0..values.len()).map(|i| (i as f64).sin()).collect();
        let expected = dense.solve(Mat::from_fn(right.len(), 1, |i, _| right[i]));
        assert!(difference(&field.solve(&right), expected.col(0).iter().copied()) < 1e-9);
        // Targets and right-hand sides add up.
        let other = [0.0, 0.0, 0.0, 1.0];
        let both = right.iter().map(|&value| [value, -2.0 * value]).collect();
        let found = field.extend_all([&x, &other], both);
        for (i, (x, factor)) in [(x, 1.0), (other, -2.0)].into_iter().enumerate() {
            let mut right_side = example.right_side(&x);
            (0..right.len()).for_each(|i| right_side[(i, 0)] += factor * right[i]);
            let expected = dense.solve(right_side);
            let found: Vec<f64> = found.iter().map(|value| value[i]).collect();
            assert!(difference(&found, expected.col(0).iter().copied()) < 1e-9);
        }
    }
}

/// A grid of so many tiles that they are eliminated in parallel, and observations of many strips.
#[test]
fn both_forms_of_a_field_agree() {
    let large = Example {
        diagonal_regularisation: 1e-6,
        ..Example::new(131, 150, 300).between(6)
    };
    for example in large_examples().into_iter().chain([large]) {
        let (one, other) = (example.covariance_solver(), example.observed());
        let (own, moments) = (one.moments(), other.moments(&example.columns, COLUMNS));
        for (i, j) in (0..COLUMNS).flat_map(|i| (0..=i).map(move |j| (i, j))) {
            let (a, b) = (own[(i, j)], moments[(i, j)]);
            assert!((a - b).abs() < 1e-8 * b.abs().max(1.0), "{a} {b}");
        }
        let x = [1.0, -0.5, 0.25, 3.0];
        let expected = other.extend(&example.targets(&x));
        let read = |field: &[f64]| -> Vec<f64> {
            example
                .interpolation
                .iter()
                .map(|interpolation| interpolation.read(field))
                .collect()
        };
        let combination = Mat::from_fn(COLUMNS, 1, |i, _| x[i]);
        let left = one.residuals(combination.as_ref());
        let targets = example.targets(&x).into_iter();
        let expected_residuals = targets
            .zip(read(&expected))
            .map(|(target, value)| target - value);
        assert!(difference(left.col_as_slice(0), expected_residuals) < 1e-8);
        let at = one.at(&example.interpolation, combination.as_ref());
        assert!(difference(at.col_as_slice(0), read(&expected).into_iter()) < 1e-8);
        assert!(difference(&one.extend(&x), expected.into_iter()) < 1e-8);
        let variances = one.variances();
        assert!(difference(&variances, other.variances().into_iter()) < 1e-8);
        let which = [7, 0, 11].map(|i| i % variances.len());
        let some = which.map(|i| variances[i]);
        assert!(difference(&one.variances_of(&which), some.into_iter()) < 1e-12);
    }
}

#[test]
fn covariances_before_any_observation_are_those_of_the_dense_inverse() {
    for example in large_examples() {
        let prior = FieldPrior::new(&example.grid(example.diagonal_regularisation)).unwrap();
        let found = prior.covariance(&example.interpolation);
        let alone = Example {
            diagonal_regularisation: example.diagonal_regularisation,
            ..Example::new(example.size[0], example.size[1], 0)
        };
        let dense = alone.dense().llt(Side::Lower).unwrap();
        let mut at = Mat::<f64>::zeros(
            example.size[0] * example.size[1],
            example.interpolation.len(),
        );
        for (i, interpolation) in example.interpolation.iter().enumerate() {
            for (pixel, share) in interpolation.iter() {
                at[(pixel as usize, i)] += share;
            }
        }
        let expected = at.transpose() * dense.solve(&at);
        for (i, column) in found.col_iter().enumerate() {
            for (j, value) in column.iter().enumerate() {
                let expected = expected[(i, j)];
                assert!((value - expected).abs() < 1e-9 * expected.abs().max(1.0));
            }
        }
    }
}

#[test]
fn a_field_that_is_free_has_no_prior() {
    let example = Example::new(20, 30, 5);
    for diagonal_regularisation in [0.0, 1e-30, f64::NAN] {
        assert!(FieldPrior::new(&example.grid(diagonal_regularisation)).is_none());
    }
    assert!(FieldPrior::new(&example.grid(1e-9)).is_some());
}

#[test]
fn an_observed_field_is_that_of_the_dense_equations() {
    for example in large_examples().into_iter().chain(examples()) {
        let field = example.observed();
        let dense = example.dense().llt(Side::Lower).unwrap();
        let x = [0.5, -1.0, 2.0, 0.25];
        let targets = example.targets(&x);
        let expected = dense.solve(example.right_side(&x));
        let found = field.extend(&targets);
        assert!(difference(&found, expected.col(0).iter().copied()) < 1e-9);
        let several: Vec<[f64; 3]> = targets.iter().map(|t| [*t, 0.0, -2.0 * t]).collect();
        let several = field.extend_with(&several, vec![[0.0; 3]; found.len()]);
        for (one, [first, nothing, twice]) in found.iter().zip(several) {
            assert!((one - first).abs() < 1e-12 && nothing == 0.0);
            assert!((-2.0 * one - twice).abs() < 1e-11);
        }

        let right: Vec<f64> = (0..found.len()).map(|i| (i as f64).sin()).collect();
        let expected = dense.solve(Mat::from_fn(right.len(), 1, |i, _| right[i]));
        assert!(difference(&field.solve(&right), expected.col(0).iter().copied()) < 1e-9);

        let inverse = dense.solve(Mat::<f64>::identity(found.len(), found.len()));
        let variance = |interpolation: &InterpolationWeights| {
            let pairs = interpolation
                .iter()
                .flat_map(|one| interpolation.iter().map(move |other| (one, other)));
            let pair =
                |((i, share), (j, across))| share * across * inverse[(i as usize, j as usize)];
            pairs.map(pair).sum::<f64>()
        };
        let expected = example.interpolation.iter().map(variance);
        assert!(difference(&field.variances(), expected) < 1e-9);
        let expected = (0..found.len()).map(|i| inverse[(i, i)]);
        assert!(difference(&field.pixel_variances(), expected) < 1e-9);
    }
}
