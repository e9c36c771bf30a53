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

    fn field(&self) -> Field {
        let grid = Grid {
            height: self.size[0],
            width: self.size[1],
            right: &self.right,
            down: &self.down,
            level: self.level,
        };
        let seen = Observations {
            taps: &self.taps,
            weights: &self.weights,
            columns: &self.columns,
            count: COLUMNS,
        };
        Field::new(&grid, &seen).unwrap()
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
        for (found, expected) in field.extend(&x).iter().zip(expected.col(0).iter()) {
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
        let y = field.extend(&x);
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
            .map(|j| field.extend(combinations.col_as_slice(j)))
            .collect();
        for reach in [Reach::Observations, Reach::Pixels] {
            let places: Vec<Taps> = match reach {
                Reach::Pixels => (0..size as u32).map(Taps::pixel).collect(),
                Reach::Observations => example.taps.clone(),
            };
            let mut seen = vec![0; places.len()];
            for spread in field.spreads(&example.columns, combinations.as_ref(), reach) {
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
