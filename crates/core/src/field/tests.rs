use super::*;
use faer::Side;
use faer::linalg::solvers::Solve as _;
use lsdc_rng::Rng;

struct Example {
    size: [usize; 2],
    right: Vec<f64>,
    down: Vec<f64>,
    taps: Vec<Taps>,
    weights: Vec<f64>,
    columns: Vec<f64>,
    level: f64,
}

const COLUMNS: usize = 4;

impl Example {
    /// With observations on the centres of pixels, no two on the same.
    fn new(height: usize, width: usize, points: usize) -> Self {
        let mut rng = Rng::stream(height as u64, &["field"]);
        let mut draw = |n: usize| (0..n).map(|_| f64::from(rng.unit())).collect::<Vec<_>>();
        // From 1e-4 to 1, as edges of images are.
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
            taps: pixels.into_iter().map(Taps::pixel).collect(),
            weights,
            columns,
            level: [0.0, 0.01][height % 2],
        }
    }

    /// With observations anywhere: between pixels, beyond the outermost centres, several in one place.
    fn between(self, seed: u64) -> Self {
        let mut rng = Rng::stream(seed, &["between"]);
        let size = (self.size[0], self.size[1]);
        let mut place = |length: usize| f64::from(rng.unit()) * length as f64 - 0.5;
        let mut taps = self.taps.clone();
        for (i, taps) in taps.iter_mut().enumerate() {
            if i % 4 > 0 {
                *taps = Taps::new([place(size.1), place(size.0)], size, size);
            }
        }
        if let [first, .., last] = &mut taps[..] {
            *last = *first;
        }
        Self { taps, ..self }
    }

    fn grid(&self, level: f64) -> Grid<'_> {
        Grid {
            height: self.size[0],
            width: self.size[1],
            right: &self.right,
            down: &self.down,
            level,
        }
    }

    fn observations(&self) -> Observations<'_> {
        Observations {
            taps: &self.taps,
            weights: &self.weights,
            columns: &self.columns,
            count: COLUMNS,
        }
    }

    fn field(&self) -> Field {
        Field::new(&self.grid(self.level), &self.observations()).unwrap()
    }

    fn kriged(&self, ridges: &[f64]) -> Field {
        let prior = FieldPrior::new(&self.grid(self.level)).unwrap();
        Field::with_prior(&prior, &self.observations(), ridges).unwrap()
    }

    /// The equations of y as a dense matrix.
    fn dense(&self) -> Mat<f64> {
        let [height, width] = self.size;
        let pixels = height * width;
        let mut matrix = Mat::<f64>::identity(pixels, pixels) * faer::Scale(self.level);
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
        for (taps, weight) in self.taps.iter().zip(&self.weights) {
            for (one, share) in taps.iter() {
                for (other, across) in taps.iter() {
                    matrix[(one as usize, other as usize)] += weight * share * across;
                }
            }
        }
        matrix
    }

    /// The right-hand side for targets `columns x`.
    fn right_side(&self, x: &[f64]) -> Mat<f64> {
        let mut right = Mat::zeros(self.size[0] * self.size[1], 1);
        for (i, taps) in self.taps.iter().enumerate() {
            let row = &self.columns[i * COLUMNS..][..COLUMNS];
            let target: f64 = row.iter().zip(x).map(|(a, b)| a * b).sum();
            for (pixel, share) in taps.iter() {
                right[(pixel as usize, 0)] += self.weights[i] * share * target;
            }
        }
        right
    }
}

/// From few points, which all stay to the end, to more than any region keeps, and a grid of one row;
/// on pixels and between them.
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

#[test]
fn fields_are_those_of_the_dense_equations() {
    for example in examples() {
        let field = example.field();
        let dense = example.dense().llt(Side::Lower).unwrap();
        let x = [0.5, -1.0, 2.0, 0.25];
        let expected = dense.solve(example.right_side(&x));
        for (found, expected) in field.extend(&x).0.iter().zip(expected.col(0).iter()) {
            assert!((found - expected).abs() < 1e-9, "{found} {expected}");
        }
        let right: Vec<f64> = (0..expected.nrows()).map(|i| (i as f64).sin()).collect();
        let expected = dense.solve(Mat::from_fn(right.len(), 1, |i, _| right[i]));
        let largest = expected.norm_max();
        for (found, expected) in field.solve(&right).iter().zip(expected.col(0).iter()) {
            assert!((found - expected).abs() < 1e-9 * largest);
        }
    }
}

#[test]
fn moments_are_the_sum_at_its_minimum() {
    for example in examples() {
        let field = example.field();
        let x = [1.0, -0.5, 0.25, 3.0];
        // The sum at its minimum, by hand.
        let (y, _) = field.extend(&x);
        let width = example.size[1];
        let mut sum = 0.0;
        for i in 0..y.len() {
            sum += example.level * y[i].powi(2);
            if i % width + 1 < width {
                sum += example.right[i] * (y[i] - y[i + 1]).powi(2);
            }
            if i + width < y.len() {
                sum += example.down[i] * (y[i] - y[i + width]).powi(2);
            }
        }
        for (i, taps) in example.taps.iter().enumerate() {
            let row = &example.columns[i * COLUMNS..][..COLUMNS];
            let target: f64 = row.iter().zip(x).map(|(a, b)| a * b).sum();
            sum += example.weights[i] * (taps.read(&y) - target).powi(2);
        }
        let moments = field.moments();
        let mut quadratic = 0.0;
        for i in 0..COLUMNS {
            for j in 0..COLUMNS {
                quadratic += moments[(i.max(j), i.min(j))] * x[i] * x[j];
            }
        }
        assert!(
            (quadratic - sum).abs() < 1e-9 * sum.max(1.0),
            "{quadratic} {sum}"
        );
    }
}

#[test]
fn what_cannot_be_solved_is_refused() {
    let mut example = Example::new(9, 9, 3);
    example.right[4] = f64::NAN;
    let grid = Grid {
        height: 9,
        width: 9,
        right: &example.right,
        down: &example.down,
        level: 0.0,
    };
    let seen = Observations {
        taps: &example.taps,
        weights: &example.weights,
        columns: &example.columns,
        count: COLUMNS,
    };
    assert!(Field::new(&grid, &seen).is_none());
    let nothing = Observations {
        taps: &[],
        weights: &[],
        columns: &[],
        count: COLUMNS,
    };
    let grid = Grid {
        right: &example.down,
        ..grid
    };
    assert!(Field::new(&grid, &nothing).is_none());
}

#[test]
fn variances_and_responses_are_those_of_the_dense_inverse() {
    for example in examples() {
        let field = example.field();
        let size = example.size[0] * example.size[1];
        let dense = example.dense().llt(Side::Lower).unwrap();
        let inverse = dense.solve(Mat::<f64>::identity(size, size));
        let combinations = Mat::from_fn(COLUMNS, 2, |i, j| (1 + i) as f64 - 3.0 * j as f64);
        let expected: Vec<Vec<f64>> = (0..2)
            .map(|j| field.extend(combinations.col_as_slice(j)).0)
            .collect();
        for reach in [Reach::Observations, Reach::Pixels] {
            let places: Vec<Taps> = match reach {
                Reach::Pixels => (0..size as u32).map(Taps::pixel).collect(),
                Reach::Observations => example.taps.clone(),
            };
            let mut seen = vec![0; places.len()];
            for spread in field
                .spreads(&example.columns, combinations.as_ref(), reach)
                .unwrap()
            {
                for (i, &place) in spread.places.iter().enumerate() {
                    seen[place as usize] += 1;
                    let taps = &places[place as usize];
                    let mut variance = 0.0;
                    for (one, share) in taps.iter() {
                        for (other, across) in taps.iter() {
                            variance += share * across * inverse[(one as usize, other as usize)];
                        }
                    }
                    assert!((spread.variances[i] - variance).abs() < 1e-9 * variance.max(1.0));
                    for (j, expected) in expected.iter().enumerate() {
                        assert!((spread.responses[(i, j)] - taps.read(expected)).abs() < 1e-9);
                    }
                }
            }
            assert!(seen.iter().all(|&count| count == 1));
        }
    }
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
        level: 1e-4,
        ..example
    })
}

/// How far lists are apart, relative to the largest value if that is above 1.
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
        let field = example.kriged(&[]);
        let dense = example.dense().llt(Side::Lower).unwrap();
        let x = [0.5, -1.0, 2.0, 0.25];
        let expected = dense.solve(example.right_side(&x));
        let (values, weights) = field.extend(&x);
        assert!(weights.is_empty());
        assert!(difference(&values, expected.col(0).iter().copied()) < 1e-9);
        let right: Vec<f64> = (0..values.len()).map(|i| (i as f64).sin()).collect();
        let expected = dense.solve(Mat::from_fn(right.len(), 1, |i, _| right[i]));
        assert!(difference(&field.solve(&right), expected.col(0).iter().copied()) < 1e-9);
    }
}

/// A grid of so many tiles that they are eliminated in parallel, and observations of many strips.
#[test]
fn both_forms_of_a_field_agree() {
    let large = Example {
        level: 1e-6,
        ..Example::new(131, 150, 300).between(6)
    };
    for example in large_examples().into_iter().chain([large]) {
        let (one, other) = (example.kriged(&[]), example.field());
        let moments = |field: &Field, i, j| field.moments()[(i, j)];
        for (i, j) in (0..COLUMNS).flat_map(|i| (0..=i).map(move |j| (i, j))) {
            let (a, b) = (moments(&one, i, j), moments(&other, i, j));
            assert!((a - b).abs() < 1e-8 * b.abs().max(1.0), "{a} {b}");
        }
        let x = [1.0, -0.5, 0.25, 3.0];
        let expected = other.extend(&x).0;
        assert!(difference(&one.extend(&x).0, expected.into_iter()) < 1e-8);

        let combinations = Mat::from_fn(COLUMNS, 2, |i, j| (1 + i) as f64 - 3.0 * j as f64);
        let spreads = |field: &Field| {
            let parts = field.spreads(&example.columns, combinations.as_ref(), Reach::Observations);
            let mut rows = Vec::new();
            for part in parts.unwrap() {
                for (i, &place) in part.places.iter().enumerate() {
                    let responses = [0, 1].map(|j| part.responses[(i, j)]);
                    rows.push((place, part.variances[i], responses));
                }
            }
            rows.sort_by_key(|row| row.0);
            rows
        };
        let (one, other) = (spreads(&one), spreads(&other));
        assert_eq!(one.len(), other.len());
        for (a, b) in one.into_iter().zip(other) {
            assert_eq!(a.0, b.0);
            assert!((a.1 - b.1).abs() < 1e-8 * b.1.max(1.0), "{} {}", a.1, b.1);
            for (a, b) in a.2.into_iter().zip(b.2) {
                assert!((a - b).abs() < 1e-8, "{a} {b}");
            }
        }
    }
}

/// Field y and weights w of functions G at the observations minimise
/// `y'Ky + w'Rw + (Sy + Gw - t)' A (Sy + Gw - t)` together.
#[test]
fn functions_that_are_part_of_a_field_have_the_weights_of_the_dense_equations() {
    let ridges = [0.3, 20.0];
    for example in large_examples() {
        let field = example.kriged(&ridges);
        let pixels = example.size[0] * example.size[1];
        let mut all = Mat::<f64>::zeros(pixels + 2, pixels + 2);
        all.submatrix_mut(0, 0, pixels, pixels)
            .copy_from(example.dense());
        let mut right = Mat::<f64>::zeros(pixels + 2, 1);
        let x = [0.5, 2.0];
        for (i, taps) in example.taps.iter().enumerate() {
            let row = &example.columns[i * COLUMNS..][..COLUMNS];
            let target = row[0] * x[0] + row[3] * x[1];
            let functions = &row[1..3];
            let weight = example.weights[i];
            for (pixel, share) in taps.iter() {
                let pixel = pixel as usize;
                right[(pixel, 0)] += weight * share * target;
                for (k, value) in functions.iter().enumerate() {
                    all[(pixels + k, pixel)] += weight * share * value;
                    all[(pixel, pixels + k)] += weight * share * value;
                }
            }
            for (k, value) in functions.iter().enumerate() {
                right[(pixels + k, 0)] += weight * value * target;
                for (l, other) in functions.iter().enumerate() {
                    all[(pixels + k, pixels + l)] += weight * value * other;
                }
            }
        }
        for (k, ridge) in ridges.iter().enumerate() {
            all[(pixels + k, pixels + k)] += ridge;
        }
        let expected = all.llt(Side::Lower).unwrap().solve(right);
        let (values, weights) = field.extend(&x);
        assert_eq!((weights.len(), field.functions()), (2, 2));
        let found = [values, weights].concat();
        assert!(difference(&found, expected.col(0).iter().copied()) < 1e-9);
    }
}

#[test]
fn covariances_before_any_observation_are_those_of_the_dense_inverse() {
    let ridges = [0.3, 20.0];
    for example in large_examples() {
        let prior = FieldPrior::new(&example.grid(example.level)).unwrap();
        let found = prior.covariance(&example.observations(), &ridges);
        let pixels = example.size[0] * example.size[1];
        let alone = Example {
            level: example.level,
            ..Example::new(example.size[0], example.size[1], 0)
        };
        let dense = alone.dense().llt(Side::Lower).unwrap();
        let mut at = Mat::<f64>::zeros(pixels, example.taps.len());
        for (i, taps) in example.taps.iter().enumerate() {
            for (pixel, share) in taps.iter() {
                at[(pixel as usize, i)] += share;
            }
        }
        let expected = at.transpose() * dense.solve(&at);
        for i in 0..example.taps.len() {
            for j in 0..example.taps.len() {
                let function = |k: usize| {
                    let value = |i: usize| example.columns[i * COLUMNS + 1 + k];
                    value(i) * value(j) / ridges[k]
                };
                let expected = expected[(i, j)] + function(0) + function(1);
                assert!((found[(i, j)] - expected).abs() < 1e-9 * expected.abs().max(1.0));
            }
        }
    }
}

#[test]
fn a_field_that_is_free_has_no_prior() {
    let example = Example::new(20, 30, 5);
    for level in [0.0, 1e-30, f64::NAN] {
        assert!(FieldPrior::new(&example.grid(level)).is_none());
    }
    assert!(FieldPrior::new(&example.grid(1e-9)).is_some());
}
