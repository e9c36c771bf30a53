//! Tests whether points match the image better at other positions, by their leave-one-out errors at each.

use crate::error::{FitError, Result};
use crate::fit::{Changes, FitMethod};
use crate::observations::{Observation, Observations};
use crate::scene::Scene;
use crate::usable::UsableObservations;
use lsdc_rng::Rng;
use rayon::prelude::*;

/// Least number of points that are evidence, and largest number that is used.
pub(crate) const FEWEST: usize = 100;
const MOST: usize = 2000;

/// Columns and rows of tiles of the image. Points within a tile are dependent; tiles are assumed to be independent.
const TILES: [usize; 2] = [8, 6];

/// Errors below this share of the depth are treated as equal.
const EXACT: f64 = 1e-4;

/// An alternative is clear if its gain is at least this many standard errors, and the mean error falls below `MATERIAL` of the
/// original one. `STANDARD_ERRORS` applies to `FRAMES` or more. One image may show a single object over many tiles, which are
/// then dependent: without a shift, single frames reached 8.1 and five frames 4.1 (`docs/evaluation.md`).
const STANDARD_ERRORS: f64 = 6.0;
const STANDARD_ERRORS_OF_FEW: f64 = 9.0;
const FRAMES: usize = 5;
const MATERIAL: f64 = 0.95;

/// The evidence of one or more frames for alternative positions of the points, such as those at another time stamp.
///
/// The points are predicted from each other (leave-one-out, basis functions alone) at each set of positions. The gain of an
/// alternative is the log-likelihood ratio of these errors, relative to the depths, under a Cauchy distribution. Its standard
/// error is estimated from the sums over tiles of the image, because neighbouring points are not independent.
///
/// Frames are pooled by [`Self::add`].
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Frames with evidence.
    frames: usize,
    /// Number of compared points, number of tiles with points, and the sum over tiles of the squared number of points.
    points: usize,
    tiles: usize,
    squares: f64,
    /// The sum of relative errors at the given positions.
    error: f64,
    tried: Vec<AlternativeSums>,
}

/// Sums over points or tiles for one alternative.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct AlternativeSums {
    error: f64,
    gain: f64,
    /// Over tiles: the squared gain, and gain x points.
    squares: f64,
    products: f64,
}

/// The best of the alternatives.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Alternative {
    /// Its index.
    pub index: usize,
    /// Mean leave-one-out error of the points at the given positions, relative to their depth.
    pub error: f64,
    /// Mean leave-one-out error at the positions of the alternative, relative to the depth.
    pub error_there: f64,
    /// The gain in log-likelihood, divided by its standard error.
    pub standard_errors: f64,
    /// Number of frames with evidence.
    pub frames: usize,
}

impl Alternative {
    /// Whether the points match the image significantly better at the alternative positions: by 6 standard errors in five
    /// frames or more, by 9 in fewer, and by 5 % of the error.
    pub fn is_clear(&self) -> bool {
        is_clear(
            [self.error, self.error_there],
            self.standard_errors,
            self.frames,
        )
    }
}

/// Whether the mean error at other positions is clearly smaller than at the given ones.
pub(crate) fn is_clear(
    [error, error_there]: [f64; 2],
    standard_errors: f64,
    frames: usize,
) -> bool {
    let least = if frames < FRAMES {
        STANDARD_ERRORS_OF_FEW
    } else {
        STANDARD_ERRORS
    };
    standard_errors >= least && error_there <= MATERIAL * error
}

impl Scene {
    /// Compares how well observations predict each other at the given and at alternative positions, with one fit each to at
    /// most 2000 of them. Each list holds the same points in the same order.
    ///
    /// Points that are outside the image or not usable in one of the lists are skipped. Fewer than 100 remaining points are no
    /// evidence.
    ///
    /// # Errors
    /// Lists of different lengths, or a damaged network.
    ///
    /// ```
    /// # #[cfg(feature = "weights")]
    /// # fn main() -> lsdc_core::Result<()> {
    /// # use lsdc_core::{Channels, Completer, Image, Observations, Weights};
    /// # let completer = Completer::new(&Weights::builtin_small())?;
    /// # let rgb = vec![128_u8; 3 * 64 * 48];
    /// # let scene = completer.scene(&Image::new(64, 48, Channels::Rgb, &rgb)?)?;
    /// # let (mut given, mut at_another_stamp) = (Observations::new(), Observations::new());
    /// # for i in 0..900 {
    /// #     given.add(f64::from(i % 60), f64::from(i / 20), 2.0 + i as f32 / 900.0);
    /// #     at_another_stamp.add(f64::from(i % 60) + 2.0, f64::from(i / 20), 2.0 + i as f32 / 900.0);
    /// # }
    /// let comparison = scene.compare(&given, &[at_another_stamp])?;
    /// if let Some(best) = comparison.best().filter(|best| best.is_clear()) {
    ///     eprintln!("relative error {:.3} instead of {:.3}", best.error_there, best.error);
    /// }
    /// # Ok(())
    /// # }
    /// # #[cfg(not(feature = "weights"))]
    /// # fn main() {}
    /// ```
    pub fn compare(&self, given: &Observations, others: &[Observations]) -> Result<Comparison> {
        let mut lists = vec![0; given.len()];
        for list in [given].into_iter().chain(others) {
            if list.len() != given.len() {
                let what = format!(
                    "{} alternative places of {} points",
                    list.len(),
                    given.len()
                );
                return Err(FitError::Shape(what).into());
            }
            match UsableObservations::new(list, self.size()) {
                Ok(usable) => usable.indices.iter().for_each(|&i| lists[i] += 1),
                Err(FitError::NoObservations { .. }) => return Ok(Comparison::none(others.len())),
                Err(error) => return Err(error.into()),
            }
        }
        let in_all = (0..given.len()).filter(|&i| lists[i] == 1 + others.len());
        let indices = random_sample(in_all.collect());
        let of = |list: &Observations| -> Vec<Observation> {
            indices.iter().map(|&i| list.as_slice()[i]).collect()
        };
        self.compared(&of(given), others.len(), |i| of(&others[i]))
    }

    /// Returns the evidence of usable points for alternatives; each alternative lists the same points at other positions.
    pub(crate) fn compared(
        &self,
        points: &[Observation],
        alternatives: usize,
        moved: impl Fn(usize) -> Vec<Observation> + Sync,
    ) -> Result<Comparison> {
        if points.len() < FEWEST {
            return Ok(Comparison::none(alternatives));
        }
        let alone = self.completer().fit_config().changed(&Changes {
            method: Some(FitMethod::Lse),
            robust: Some(None),
            ..Changes::default()
        });
        // Thresholds were chosen for single fits.
        let scene = self.without_mirror().with_fit(alone)?;
        let errors = |points: &[Observation]| -> Result<Vec<f64>> {
            let fit = scene.complete(&points.iter().copied().collect())?;
            let errors = fit.leave_one_out();
            let pairs = errors.iter().zip(points);
            Ok(pairs
                .map(|(error, point)| (error / f64::from(point.depth)).abs())
                .collect())
        };
        let still = errors(points)?;
        let all: Vec<usize> = (0..alternatives).collect();
        let fits = || {
            let all = all.into_par_iter();
            all.map(|i| errors(&moved(i))).collect::<Result<Vec<_>>>()
        };
        let moved = self.completer().run(fits)?;
        Ok(Comparison::new(&tiles(points, self.size()), &still, &moved))
    }
}

/// Returns the tile of every point of an image of `size` (height, width).
pub(crate) fn tiles(points: &[Observation], (height, width): (usize, usize)) -> Vec<usize> {
    let size = [width as f64, height as f64];
    let tile = |point: &Observation| {
        let place = [point.u / size[0], point.v / size[1]];
        let [x, y] = [0, 1].map(|axis| {
            // The first pixel begins half a pixel before position 0.
            (place[axis].max(0.0) * TILES[axis] as f64) as usize
        });
        y.min(TILES[1] - 1) * TILES[0] + x.min(TILES[0] - 1)
    };
    points.iter().map(tile).collect()
}

/// Returns a random sample of at most `MOST` elements.
pub(crate) fn random_sample<T>(mut all: Vec<T>) -> Vec<T> {
    let most = all.len().min(MOST);
    Rng::stream(0, &["alignment"]).choose(&mut all, most);
    all.truncate(most);
    all
}

impl Comparison {
    /// No evidence.
    fn none(alternatives: usize) -> Self {
        Self {
            frames: 0,
            points: 0,
            tiles: 0,
            squares: 0.0,
            error: 0.0,
            tried: vec![AlternativeSums::default(); alternatives],
        }
    }

    /// Computes the evidence of one frame from the tile of every point, its error, and its errors at all alternatives.
    pub(crate) fn new(tiles: &[usize], still: &[f64], moved: &[Vec<f64>]) -> Self {
        let known =
            |i: &usize| still[*i].is_finite() && moved.iter().all(|all| all[*i].is_finite());
        let known: Vec<usize> = (0..still.len()).filter(known).collect();
        let mut sorted: Vec<f64> = known.iter().map(|&i| still[i]).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let Some(median) = sorted.get(sorted.len() / 2) else {
            return Self::none(moved.len());
        };
        let scale = median.max(EXACT);
        let cost = |error: f64| (error / scale).powi(2).ln_1p();
        let mut counts = [0.0; TILES[0] * TILES[1]];
        for &i in &known {
            counts[tiles[i]] += 1.0;
        }
        let tried = |errors: &Vec<f64>| {
            let mut gains = [0.0; TILES[0] * TILES[1]];
            for &i in &known {
                gains[tiles[i]] += cost(still[i]) - cost(errors[i]);
            }
            AlternativeSums {
                error: known.iter().map(|&i| errors[i]).sum(),
                gain: gains.iter().sum(),
                squares: gains.iter().map(|gain| gain * gain).sum(),
                products: gains.iter().zip(&counts).map(|(gain, n)| gain * n).sum(),
            }
        };
        Self {
            frames: 1,
            points: known.len(),
            tiles: counts.iter().filter(|&&count| count > 0.0).count(),
            squares: counts.iter().map(|count| count * count).sum(),
            error: sorted.iter().sum(),
            tried: moved.iter().map(tried).collect(),
        }
    }

    /// Adds the evidence of another frame of the same camera and scanner.
    pub fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.points += other.points;
        self.tiles += other.tiles;
        self.squares += other.squares;
        self.error += other.error;
        for (sum, other) in self.tried.iter_mut().zip(&other.tried) {
            sum.error += other.error;
            sum.gain += other.gain;
            sum.squares += other.squares;
            sum.products += other.products;
        }
    }

    /// The number of points that were compared, over all frames.
    pub fn points(&self) -> usize {
        self.points
    }

    /// The best of the alternatives, clear or not; `None` without evidence.
    pub fn best(&self) -> Option<Alternative> {
        if self.tiles < 2 {
            return None;
        }
        let pairs = self.tried.iter().enumerate();
        let (index, best) = pairs.max_by(|(_, a), (_, b)| a.gain.total_cmp(&b.gain))?;
        let (points, tiles) = (self.points as f64, self.tiles as f64);
        let mean = best.gain / points;
        // Deviations of the gains of tiles from their number of points times the mean gain per point.
        let deviations = best.squares - 2.0 * mean * best.products + mean * mean * self.squares;
        let error = (deviations * tiles / (tiles - 1.0))
            .max(f64::MIN_POSITIVE)
            .sqrt();
        Some(Alternative {
            index,
            error: self.error / points,
            error_there: best.error / points,
            standard_errors: best.gain / error,
            frames: self.frames,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gain_is_that_of_cauchy_likelihoods_over_its_standard_error_by_tiles() {
        // Two points of one tile lose their errors, which equal the scale: 2 ln 2. The mean gain per point is ln 2 / 2; the
        // sums of the tiles deviate by ln 2 from it.
        let mut moved = vec![vec![0.1; 4]; 5];
        moved[3] = vec![0.0, 0.0, 0.1, 0.1];
        let found = Comparison::new(&[0, 0, 7, 7], &[0.1; 4], &moved);
        let best = found.best().unwrap();
        assert_eq!((best.index, found.points()), (3, 4));
        assert!((best.standard_errors - 1.0).abs() < 1e-12);
        assert!((best.error - 0.1).abs() < 1e-12 && (best.error_there - 0.05).abs() < 1e-12);
        assert!(!best.is_clear());
    }

    #[cfg(feature = "weights")]
    mod of_a_scene {
        use super::*;
        use crate::{Channels, Completer, Error, Image, Weights};

        fn scene() -> Scene {
            let completer = Completer::new(&Weights::builtin_small()).unwrap();
            let image = Image::new(64, 48, Channels::Rgb, &[128; 3 * 64 * 48]).unwrap();
            completer.scene(&image).unwrap()
        }

        fn points(count: usize, away: f64) -> Observations {
            let mut points = Observations::new();
            for i in 0..count {
                let (u, v) = (i % 60, i / 60 * 2);
                points.add(u as f64 + away, v as f64, 2.0 + (i % 7) as f32 * 0.1);
            }
            points
        }

        #[test]
        fn points_that_any_list_lacks_are_left_out() {
            let given = points(240, 0.0);
            let all = scene().compare(&given, &[points(240, 1.0)]).unwrap();
            assert_eq!(all.points(), 240);
            // The last three of every row of 60 leave the image of 64 columns.
            let less = scene()
                .compare(&given, &[points(240, 1.0), points(240, 7.0)])
                .unwrap();
            assert_eq!(less.points(), 240 - 4 * 3);
            let none = scene().compare(&given, &[points(240, 90.0)]).unwrap();
            assert_eq!((none.points(), none.best()), (0, None));
            // Equal positions have equal errors.
            let same = scene()
                .compare(&given, std::slice::from_ref(&given))
                .unwrap();
            assert_eq!(
                same.best().map(|best| (best.standard_errors, best.index)),
                Some((0.0, 0))
            );
        }

        #[test]
        fn lists_of_other_lengths_are_refused() {
            let refused = scene().compare(&points(240, 0.0), &[points(239, 0.0)]);
            assert!(
                matches!(refused, Err(Error::Fit(FitError::Shape(what))) if what.contains("239"))
            );
        }
    }
}
