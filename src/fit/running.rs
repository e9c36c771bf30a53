//! A fit that takes points as they come and gives them back.

use super::lstsq::dot;
use super::prior::Prior;
use crate::error::{Error, Result};
use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};

/// Updates after which the factor is made anew from the normal equations.
const RENEW: usize = 500;

/// Least squares with a prior over points that come and go, one at a time: each costs the square of
/// the number of base functions, where a solve from the start costs its cube and the number of
/// points.
///
/// Keeps the normal equations `A = F^T W F + P` and `b = F^T W d`, whose sums are exact to
/// rounding, and a Cholesky factor of `A` that follows by rank-one updates and downdates (Gill,
/// Golub, Murray and Saunders 1974, method C1). A step of refinement against `A` takes out what the
/// factor has drifted by; every so often it is made anew.
#[derive(Clone, Debug)]
pub struct RunningFit {
    /// Both halves, row by row.
    normal: Vec<f64>,
    right: Vec<f64>,
    /// The lower triangle of `A = L L^T`, column by column from the diagonal on.
    factor: Vec<f64>,
    columns: usize,
    count: usize,
    updates: usize,
}

impl RunningFit {
    /// A fit of `columns` weights without points, drawn towards zero by `strength` times their
    /// squares. Above 0: it is what makes the first points solvable.
    ///
    /// # Errors
    /// A strength that is not positive.
    pub fn new(columns: usize, strength: f64) -> Result<Self> {
        if !(strength > 0.0 && strength.is_finite()) {
            return Err(Error::config(
                "the strength of a running fit must be above 0",
            ));
        }
        let mut precision = Mat::zeros(columns, columns);
        for i in 0..columns {
            precision[(i, i)] = strength;
        }
        Self::begin(&precision)
    }

    /// A fit without points under a prior, whose scale is free but for `scale`, in metres: the
    /// standard deviation of how many metres its mean map stands for. `noise` is the standard
    /// deviation of points.
    ///
    /// # Errors
    /// Numbers that are not positive, or a prior without full rank.
    pub fn with_prior(prior: &Prior, scale: f64, noise: f64) -> Result<Self> {
        let positive = |v: f64| v > 0.0 && v.is_finite();
        if !(positive(scale) && positive(noise)) {
            return Err(Error::config(
                "scale and noise of a running fit must be above 0",
            ));
        }
        let k = prior.columns();
        let mean = Mat::from_fn(k, 1, |i, _| prior.mean[i]);
        let spread = &prior.factor * prior.factor.transpose() + &mean * mean.transpose();
        let covariance = spread * faer::Scale((scale / noise).powi(2));
        let factor = covariance.llt(Side::Lower).map_err(|_| {
            Error::fit("the prior over weights leaves a direction out")
                .hint("begin with `RunningFit::new`")
        })?;
        Self::begin(&factor.solve(Mat::<f64>::identity(k, k)))
    }

    fn begin(precision: &Mat<f64>) -> Result<Self> {
        let columns = precision.nrows();
        let mut fit = Self {
            normal: (0..columns * columns)
                .map(|i| precision[(i / columns, i % columns)])
                .collect(),
            right: vec![0.0; columns],
            factor: Vec::new(),
            columns,
            count: 0,
            updates: 0,
        };
        fit.renew()?;
        Ok(fit)
    }

    /// Points taken, less those given back.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Takes points: base functions `[n, k]`, row by row, their depths in metres, and a weight for
    /// all of them.
    ///
    /// # Errors
    /// Lengths that do not go together, or values that are not finite.
    pub fn add(&mut self, bases: &[f32], depths: &[f32], weight: f64) -> Result<()> {
        self.check(bases, depths, weight)?;
        for (row, &depth) in bases.chunks_exact(self.columns).zip(depths) {
            self.take(row, depth, weight, 1.0)?;
            self.count += 1;
        }
        Ok(())
    }

    /// Gives points back that were taken with this weight.
    ///
    /// # Errors
    /// As `add`, or points that were never taken.
    pub fn remove(&mut self, bases: &[f32], depths: &[f32], weight: f64) -> Result<()> {
        self.check(bases, depths, weight)?;
        if depths.len() > self.count {
            return Err(Error::fit("more points are given back than were taken"));
        }
        for (row, &depth) in bases.chunks_exact(self.columns).zip(depths) {
            self.take(row, depth, weight, -1.0)?;
            self.count -= 1;
        }
        Ok(())
    }

    /// Multiplies the weights of all that is known so far, prior included, by `factor` in (0, 1]:
    /// exponential forgetting. The solution stays as it is.
    ///
    /// # Errors
    /// A factor out of range.
    pub fn forget(&mut self, factor: f64) -> Result<()> {
        if !(factor > 0.0 && factor <= 1.0) {
            return Err(Error::config("a forgetting factor must be in (0, 1]"));
        }
        self.normal.iter_mut().for_each(|v| *v *= factor);
        self.right.iter_mut().for_each(|v| *v *= factor);
        let root = factor.sqrt();
        self.factor.iter_mut().for_each(|v| *v *= root);
        Ok(())
    }

    /// The weights of the base functions that fit all points taken.
    pub fn weights(&self) -> Vec<f64> {
        let mut x = self.solve(&self.right);
        let fitted = self
            .normal
            .chunks_exact(self.columns)
            .map(|row| dot(row, &x));
        let rest: Vec<f64> = self.right.iter().zip(fitted).map(|(b, a)| b - a).collect();
        x.iter_mut()
            .zip(self.solve(&rest))
            .for_each(|(x, step)| *x += step);
        x
    }

    /// `f^T A^-1 f`: the variance of the fitted value for a row of base functions, for points of weight
    /// 1 whose noise has variance 1.
    pub fn spread(&self, row: &[f32]) -> f64 {
        let mut z: Vec<f64> = row.iter().map(|&v| f64::from(v)).collect();
        self.forward(&mut z);
        z.iter().map(|v| v * v).sum()
    }

    fn check(&self, bases: &[f32], depths: &[f32], weight: f64) -> Result<()> {
        let finite = bases.iter().chain(depths).all(|v| v.is_finite());
        let sound = weight > 0.0 && weight.is_finite() && finite;
        if sound && bases.len() == depths.len() * self.columns {
            return Ok(());
        }
        Err(Error::fit(
            "points of a running fit need finite values, a weight above 0, and a base \
                        function for each weight",
        ))
    }

    /// Adds `sign * weight * f f^T` to what is known.
    fn take(&mut self, row: &[f32], depth: f32, weight: f64, sign: f64) -> Result<()> {
        let root = weight.sqrt();
        let mut z: Vec<f64> = row.iter().map(|&v| root * f64::from(v)).collect();
        let depth = root * f64::from(depth);
        self.sum(&z, depth, sign);
        self.updates += 1;
        let row = z.clone();
        if self.updates.is_multiple_of(RENEW) || !self.rotate(&mut z, sign) {
            let renewed = self.renew();
            if renewed.is_err() {
                self.sum(&row, depth, -sign);
                self.renew()?;
            }
            return renewed;
        }
        Ok(())
    }

    fn sum(&mut self, z: &[f64], depth: f64, sign: f64) {
        for (sum, head) in self.normal.chunks_exact_mut(self.columns).zip(z) {
            let head = sign * head;
            sum.iter_mut().zip(z).for_each(|(s, v)| *s += head * v);
        }
        let right = self.right.iter_mut().zip(z);
        right.for_each(|(s, v)| *s += sign * depth * v);
    }

    /// Takes `z z^T` into the factor; false if it is not positive any more.
    fn rotate(&mut self, z: &mut [f64], sign: f64) -> bool {
        let mut at = 0;
        for j in 0..self.columns {
            let (column, below) = (&mut self.factor[at..at + self.columns - j], &mut z[j..]);
            let (diagonal, head) = (column[0], below[0]);
            let square = diagonal * diagonal + sign * head * head;
            // Where nearly all of the diagonal is taken away, what is left is rounding.
            if square <= 1e-10 * diagonal * diagonal {
                return false;
            }
            let root = square.sqrt();
            let (cosine, sine) = (root / diagonal, head / diagonal);
            column[0] = root;
            let over = 1.0 / cosine;
            for (l, z) in column[1..].iter_mut().zip(&mut below[1..]) {
                *l = (*l + sign * sine * *z) * over;
                *z = cosine * *z - sine * *l;
            }
            at += self.columns - j;
        }
        true
    }

    /// Makes the factor anew.
    fn renew(&mut self) -> Result<()> {
        let k = self.columns;
        let normal = Mat::from_fn(k, k, |i, j| self.normal[i * k + j]);
        let factor = normal.llt(Side::Lower).map_err(|_| {
            Error::fit("what is left of the points does not determine the weights")
                .hint("give back only points that were taken, with their weights")
        })?;
        self.factor.clear();
        for j in 0..k {
            self.factor.extend((j..k).map(|i| factor.L()[(i, j)]));
        }
        Ok(())
    }

    fn solve(&self, b: &[f64]) -> Vec<f64> {
        let mut x = b.to_vec();
        self.forward(&mut x);
        let mut end = self.factor.len();
        for j in (0..self.columns).rev() {
            let length = self.columns - j;
            let column = &self.factor[end - length..end];
            x[j] = (x[j] - dot(&column[1..], &x[j + 1..])) / column[0];
            end -= length;
        }
        x
    }

    /// `L^-1 z`.
    fn forward(&self, z: &mut [f64]) {
        let mut at = 0;
        for j in 0..self.columns {
            let column = &self.factor[at..at + self.columns - j];
            let value = z[j] / column[0];
            z[j] = value;
            z[j + 1..]
                .iter_mut()
                .zip(&column[1..])
                .for_each(|(z, l)| *z -= value * l);
            at += self.columns - j;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::NoisePrior;
    use crate::rng::Rng;

    const K: usize = 40;

    fn points(count: usize, seed: u64) -> (Vec<f32>, Vec<f32>) {
        let mut rng = Rng::stream(seed, &["running"]);
        let bases = (0..count * K).map(|i| if i % K == 0 { 1.0 } else { rng.normal() });
        let bases = bases.collect();
        (bases, (0..count).map(|_| 1.0 + 5.0 * rng.unit()).collect())
    }

    /// All points at once, by a factorisation of what they add up to.
    fn whole(bases: &[f32], depths: &[f32], weights: &[f64], strength: f64) -> Vec<f64> {
        let f = Mat::from_fn(depths.len(), K, |i, j| {
            f64::from(bases[i * K + j]) * weights[i].sqrt()
        });
        let d = Mat::from_fn(depths.len(), 1, |i, _| {
            f64::from(depths[i]) * weights[i].sqrt()
        });
        let normal = f.transpose() * &f + Mat::<f64>::identity(K, K) * faer::Scale(strength);
        let x = normal.llt(Side::Lower).unwrap().solve(f.transpose() * d);
        (0..K).map(|i| x[(i, 0)]).collect()
    }

    fn close(found: &[f64], expected: &[f64], tolerance: f64) {
        let scale = expected.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        for (a, b) in found.iter().zip(expected) {
            assert!((a - b).abs() <= tolerance * scale, "{a} instead of {b}");
        }
    }

    #[test]
    fn ten_thousand_updates_are_the_full_solve() {
        // A window of 200 points slides over 5200: 5200 taken, 5000 given back.
        let (bases, depths) = points(5200, 1);
        let row = |i: usize| (&bases[i * K..(i + 1) * K], &depths[i..=i]);
        let mut fit = RunningFit::new(K, 1e-3).unwrap();
        for i in 0..5200 {
            let (f, d) = row(i);
            fit.add(f, d, 1.0).unwrap();
            if i >= 200 {
                let (f, d) = row(i - 200);
                fit.remove(f, d, 1.0).unwrap();
            }
        }
        assert_eq!((fit.count(), fit.updates), (200, 10_200));
        let expected = whole(&bases[5000 * K..], &depths[5000..], &[1.0; 200], 1e-3);
        close(&fit.weights(), &expected, 1e-9);
    }

    #[test]
    fn few_points_and_weights_are_the_full_solve() {
        let (bases, depths) = points(7, 2);
        let mut fit = RunningFit::new(K, 0.1).unwrap();
        fit.add(&bases[..3 * K], &depths[..3], 2.0).unwrap();
        fit.add(&bases[3 * K..], &depths[3..], 0.5).unwrap();
        let weights = [2.0, 2.0, 2.0, 0.5, 0.5, 0.5, 0.5];
        close(
            &fit.weights(),
            &whole(&bases, &depths, &weights, 0.1),
            1e-10,
        );
    }

    #[test]
    fn what_is_forgotten_counts_less() {
        let (bases, depths) = points(90, 3);
        let mut fit = RunningFit::new(K, 0.1).unwrap();
        fit.add(&bases[..60 * K], &depths[..60], 1.0).unwrap();
        let before = fit.weights();
        fit.forget(0.5).unwrap();
        close(&fit.weights(), &before, 1e-10);
        fit.add(&bases[60 * K..], &depths[60..], 1.0).unwrap();
        let mut weights = vec![0.5; 60];
        weights.extend([1.0; 30]);
        close(
            &fit.weights(),
            &whole(&bases, &depths, &weights, 0.05),
            1e-10,
        );
    }

    #[test]
    fn the_spread_shrinks_where_points_are() {
        let (bases, depths) = points(30, 4);
        let mut fit = RunningFit::new(K, 0.5).unwrap();
        let row = &bases[..K];
        let square: f64 = row.iter().map(|&v| f64::from(v).powi(2)).sum();
        // Without points it is that of the prior.
        assert!((fit.spread(row) - square / 0.5).abs() < 1e-9 * square);
        fit.add(row, &depths[..1], 1.0).unwrap();
        // s / (1 + s) after one point there (Sherman and Morrison).
        let before = square / 0.5;
        assert!((fit.spread(row) - before / (1.0 + before)).abs() < 1e-9);
    }

    #[test]
    fn a_prior_is_the_mean_until_points_say_otherwise() {
        let noise = NoisePrior {
            mean: 0.0,
            deviation: None,
            trust: 0.0,
        };
        let mean: Vec<f32> = (0..K).map(|i| 1.0 / (1.0 + i as f32)).collect();
        let factor: Vec<f32> = (0..K * K)
            .map(|i| if i / K == i % K { 0.01 } else { 0.0 })
            .collect();
        let prior = Prior::new(&mean, &factor, noise).unwrap();
        let mut fit = RunningFit::with_prior(&prior, 10.0, 0.1).unwrap();
        let (bases, _) = points(1, 5);
        let at: f64 = bases.iter().zip(&mean).map(|(f, m)| f64::from(f * m)).sum();
        fit.add(&bases, &[2.0 * at as f32], 1.0).unwrap();
        // The point says 2 x the mean map; the scale was all but free.
        for (weight, m) in fit.weights().iter().zip(&mean) {
            assert!((weight - 2.0 * f64::from(*m)).abs() < 0.02, "{weight} {m}");
        }
    }

    #[test]
    fn misuse_is_refused() {
        assert!(RunningFit::new(K, 0.0).is_err());
        let mut fit = RunningFit::new(K, 1.0).unwrap();
        let (bases, depths) = points(2, 6);
        assert!(fit.add(&bases, &depths[..1], 1.0).is_err());
        assert!(fit.add(&bases, &[f32::NAN, 1.0], 1.0).is_err());
        assert!(fit.add(&bases, &depths, 0.0).is_err());
        assert!(fit.remove(&bases[..K], &depths[..1], 1.0).is_err());
        assert!(fit.forget(0.0).is_err());
        assert_eq!(fit.weights(), vec![0.0; K]);
        // A point that was never taken: what is left is not positive, and nothing has changed.
        fit.add(&bases[..K], &depths[..1], 1.0).unwrap();
        let before = fit.weights();
        assert!(fit.remove(&bases[K..], &depths[1..], 1.0).is_err());
        close(&fit.weights(), &before, 1e-12);
        assert_eq!(fit.count(), 1);
    }
}
