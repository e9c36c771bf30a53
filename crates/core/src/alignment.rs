//! Whether points lie where the image shows them: their leave-one-out errors where they are and at other places.

use crate::error::Result;
use crate::fit::{Changes, FitMethod};
use crate::observations::{Observation, Observations};
use crate::scene::Scene;
use crate::usable::Usable;
use lsdc_rng::Rng;
use rayon::prelude::*;
use std::fmt::{Display, Formatter};

/// Lengths of the shifts that are tried, in pixels of an image of `AREA` pixels.
const LENGTHS: [f64; 4] = [2.0, 4.0, 8.0, FARTHEST];
const FARTHEST: f64 = 16.0;
const AREA: f64 = 304.0 * 228.0;
const DIRECTIONS: [[f64; 2]; 8] = {
    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
    [
        [1.0, 0.0],
        [HALF, HALF],
        [0.0, 1.0],
        [-HALF, HALF],
        [-1.0, 0.0],
        [-HALF, -HALF],
        [0.0, -1.0],
        [HALF, -HALF],
    ]
};

/// Fewer points do not tell a shift from chance, and more are not needed.
const FEWEST: usize = 100;
const MOST: usize = 2000;

/// Columns and rows of tiles of the image. Points within a tile depend on each other, tiles do not.
const TILES: [usize; 2] = [8, 6];

/// Errors below this share of the depth are alike.
const EXACT: f64 = 1e-4;

/// A shift is clear if its gain is so many standard errors, and the mean error falls below `MATERIAL` of what it was.
/// `STANDARD_ERRORS` is for `FRAMES` or more. One image may show a single object over many tiles, which then depend on
/// each other: without a shift, single frames reached 8.1 and five frames 4.1 (`docs/evaluation.md`).
const STANDARD_ERRORS: f64 = 6.0;
const STANDARD_ERRORS_OF_FEW: f64 = 9.0;
const FRAMES: usize = 5;
const MATERIAL: f64 = 0.95;

/// The evidence of one or more frames for a shift between points and image, as wrong extrinsics or time stamps cause.
///
/// The points are predicted from each other (leave-one-out, basis functions alone) where they are and moved by 32 shifts of
/// up to a twentieth of the width of the image. The gain of a shift is the logarithm of the ratio of the likelihoods of
/// these errors, relative to the depths, under a Cauchy distribution. Its standard error is estimated from the sums over
/// tiles of the image, because neighbouring points are not independent.
///
/// Frames are pooled by [`Self::add`]: a shift of a whole sequence is found before it is clear in any one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// Frames with evidence.
    frames: usize,
    /// Points that were compared, the tiles they lie in, and the sum over tiles of the squared number of points.
    points: usize,
    tiles: usize,
    squares: f64,
    /// The sum of relative errors without a shift.
    error: f64,
    /// The unit of the shifts, in pixels of the image.
    pixel: f64,
    tried: Vec<Tried>,
}

/// Sums over points or tiles for one shift.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Tried {
    error: f64,
    gain: f64,
    /// Over tiles: the squared gain, and gain x points.
    squares: f64,
    products: f64,
}

/// The shift of the points at which they fit the image best.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Shift {
    /// To the right, in pixels of the image.
    pub u: f64,
    /// Down, in pixels of the image.
    pub v: f64,
    /// Mean leave-one-out error of the points where they are, over their depth.
    pub error: f64,
    /// The same of the moved points.
    pub error_moved: f64,
    /// The gain in log-likelihood over its standard error.
    pub standard_errors: f64,
    /// Frames that this is the evidence of.
    pub frames: usize,
}

impl Shift {
    /// Whether the moved points fit so much better that chance does not explain it: by 6 standard errors in five frames or
    /// more, by 9 in fewer, and by 5 % of the error.
    pub fn is_clear(&self) -> bool {
        let least = if self.frames < FRAMES {
            STANDARD_ERRORS_OF_FEW
        } else {
            STANDARD_ERRORS
        };
        self.standard_errors >= least && self.error_moved <= MATERIAL * self.error
    }
}

impl Display for Shift {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "the points fit the image better moved by ({:+.0}, {:+.0}) pixels: their leave-one-out error falls from \
             {:.1} to {:.1} % of the depth",
            self.u,
            self.v,
            100.0 * self.error,
            100.0 * self.error_moved
        )
    }
}

impl Scene {
    /// Tests whether the observations lie where the image shows them, by 33 fits to at most 2000 of them: for the first
    /// frames of a robot or a recording rather than for each.
    ///
    /// Observations nearer to the border than the longest shift are left out. Fewer than 100 others are no evidence.
    ///
    /// # Errors
    /// No usable observation, or a damaged network.
    ///
    /// ```
    /// # #[cfg(feature = "weights")]
    /// # fn main() -> lsdc_core::Result<()> {
    /// # use lsdc_core::{Channels, Completer, Image, Observations, Weights};
    /// # let completer = Completer::new(&Weights::builtin_small())?;
    /// # let rgb = vec![128_u8; 3 * 64 * 48];
    /// # let scene = completer.scene(&Image::new(64, 48, Channels::Rgb, &rgb)?)?;
    /// # let mut points = Observations::new();
    /// # (0..900).for_each(|i| points.add(f64::from(i % 60), f64::from(i / 20), 2.0 + i as f32 / 900.0));
    /// let mut alignment = scene.alignment(&points)?;
    /// // More frames are more evidence.
    /// alignment.add(&scene.alignment(&points)?);
    /// if let Some(shift) = alignment.shift().filter(|shift| shift.is_clear()) {
    ///     eprintln!("{shift}: check extrinsics and time stamps");
    /// }
    /// # Ok(())
    /// # }
    /// # #[cfg(not(feature = "weights"))]
    /// # fn main() {}
    /// ```
    pub fn alignment(&self, observations: &Observations) -> Result<Alignment> {
        let size = [self.width() as f64, self.height() as f64];
        let pixel = (size[0] * size[1] / AREA).sqrt();
        let points = chosen(observations, self.size(), FARTHEST * pixel)?;
        if points.len() < FEWEST {
            return Ok(Alignment::none(pixel));
        }
        let alone = self.completer().fit_config().changed(&Changes {
            method: Some(FitMethod::Lse),
            robust: Some(None),
            ..Changes::default()
        });
        let scene = self.with_fit(alone)?;
        let errors = |[u, v]: [f64; 2]| -> Result<Vec<f64>> {
            let moved = points.iter().map(|point| Observation {
                u: point.u + u * pixel,
                v: point.v + v * pixel,
                ..*point
            });
            let errors = scene.complete(&moved.collect())?.leave_one_out();
            let pairs = errors.iter().zip(&points);
            Ok(pairs
                .map(|(error, point)| (error / f64::from(point.depth)).abs())
                .collect())
        };
        let still = errors([0.0; 2])?;
        let all: Vec<_> = shifts().collect();
        let fits = || all.into_par_iter().map(errors).collect::<Result<Vec<_>>>();
        let moved = self.completer().run(fits)?;
        let tile = |point: &Observation| {
            let place = [point.u / size[0], point.v / size[1]];
            let [x, y] = [0, 1].map(|axis| (place[axis] * TILES[axis] as f64) as usize);
            y * TILES[0] + x
        };
        let tiles: Vec<usize> = points.iter().map(tile).collect();
        Ok(Alignment::new(pixel, &tiles, &still, &moved))
    }
}

impl Alignment {
    /// No evidence.
    fn none(pixel: f64) -> Self {
        Self {
            frames: 0,
            points: 0,
            tiles: 0,
            squares: 0.0,
            error: 0.0,
            pixel,
            tried: vec![Tried::default(); shifts().count()],
        }
    }

    /// The evidence of one frame: the tile of every point, its error, and its errors at all shifts.
    fn new(pixel: f64, tiles: &[usize], still: &[f64], moved: &[Vec<f64>]) -> Self {
        let known =
            |i: &usize| still[*i].is_finite() && moved.iter().all(|all| all[*i].is_finite());
        let known: Vec<usize> = (0..still.len()).filter(known).collect();
        let mut sorted: Vec<f64> = known.iter().map(|&i| still[i]).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let Some(median) = sorted.get(sorted.len() / 2) else {
            return Self::none(pixel);
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
            Tried {
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
            pixel,
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

    /// The best of the shifts, clear or not; `None` without evidence.
    pub fn shift(&self) -> Option<Shift> {
        if self.tiles < 2 {
            return None;
        }
        let gain = |tried: &Tried| tried.gain;
        let pairs = shifts().zip(&self.tried);
        let (shift, best) = pairs.max_by(|(_, a), (_, b)| gain(a).total_cmp(&gain(b)))?;
        let (points, tiles) = (self.points as f64, self.tiles as f64);
        let mean = best.gain / points;
        // Of the gains of tiles about those that the mean gain of a point would give them.
        let deviations = best.squares - 2.0 * mean * best.products + mean * mean * self.squares;
        let error = (deviations * tiles / (tiles - 1.0))
            .max(f64::MIN_POSITIVE)
            .sqrt();
        let [u, v] = shift.map(|length| length * self.pixel);
        Some(Shift {
            u,
            v,
            error: self.error / points,
            error_moved: best.error / points,
            standard_errors: best.gain / error,
            frames: self.frames,
        })
    }
}

/// The shifts that are tried, to the right and down.
fn shifts() -> impl Iterator<Item = [f64; 2]> {
    LENGTHS.into_iter().flat_map(|length| {
        let directions = DIRECTIONS.into_iter();
        directions.map(move |direction| direction.map(|share| length * share))
    })
}

/// A choice of the usable observations that lie `margin` or more within an image of `size` (height, width).
fn chosen(
    observations: &Observations,
    size: (usize, usize),
    margin: f64,
) -> Result<Vec<Observation>> {
    let usable = Usable::new(observations, size)?;
    let inside = |place: f64, length: usize| {
        let end = length as f64 - 1.0 - margin;
        (margin..=end).contains(&place)
    };
    let points = usable.which.iter().map(|&i| observations.as_slice()[i]);
    let points = points.filter(|point| inside(point.u, size.1) && inside(point.v, size.0));
    let mut points: Vec<Observation> = points.collect();
    let most = points.len().min(MOST);
    Rng::stream(0, &["alignment"]).choose(&mut points, most);
    points.truncate(most);
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gain_of_a_shift_is_that_of_cauchy_likelihoods_over_its_standard_error_by_tiles() {
        // Two points of one tile lose their errors, which are those of the scale: 2 ln 2. The mean gain of a point
        // is ln 2 / 2, from which the sums of the tiles deviate by ln 2.
        let mut moved = vec![vec![0.1; 4]; shifts().count()];
        moved[3] = vec![0.0, 0.0, 0.1, 0.1];
        let found = Alignment::new(2.0, &[0, 0, 7, 7], &[0.1; 4], &moved);
        let shift = found.shift().unwrap();
        let diagonal = 2.0 * 2.0 / 2_f64.sqrt();
        assert!((shift.u + diagonal).abs() < 1e-12 && (shift.v - diagonal).abs() < 1e-12);
        assert!((shift.standard_errors - 1.0).abs() < 1e-12);
        assert!((shift.error - 0.1).abs() < 1e-12 && (shift.error_moved - 0.05).abs() < 1e-12);
        assert!(!shift.is_clear());
        assert_eq!(found.points(), 4);
    }

    #[cfg(feature = "weights")]
    mod of_a_scene {
        use super::*;
        use crate::{Channels, Completer, Image, Weights};

        const SIZE: (usize, usize) = (320, 240);

        /// Boxes before a wall, each of a colour and a depth of its own: the last that covers a pixel.
        fn boxes() -> (Vec<u8>, Vec<f32>) {
            let mut rng = Rng::stream(1, &["boxes"]);
            let (mut colours, mut depths) =
                (vec![90; 3 * SIZE.0 * SIZE.1], vec![4.0; SIZE.0 * SIZE.1]);
            for _ in 0..25 {
                let [left, top] = [rng.below(280) as usize, rng.below(200) as usize];
                let [width, height] = [20 + rng.below(40) as usize, 20 + rng.below(40) as usize];
                let colour = [(); 3].map(|()| rng.below(256) as u8);
                let depth = rng.range(1.0, 3.5);
                for y in top..(top + height).min(SIZE.1) {
                    for x in left..(left + width).min(SIZE.0) {
                        let pixel = y * SIZE.0 + x;
                        colours[3 * pixel..][..3].copy_from_slice(&colour);
                        depths[pixel] = depth;
                    }
                }
            }
            (colours, depths)
        }

        /// The evidence from a draw of points that lie `shift` pixels to the right of where they belong.
        fn alignment(draw: u64, count: usize, shift: f64, scale: f32) -> Alignment {
            let (colours, depths) = boxes();
            let completer = Completer::new(&Weights::builtin_small()).unwrap();
            let image = Image::new(SIZE.0, SIZE.1, Channels::Rgb, &colours).unwrap();
            let mut rng = Rng::stream(draw, &["points"]);
            let mut points = Observations::new();
            for _ in 0..count {
                // Nearer to the middle than the longest shift is to the border, moved or not.
                let (x, y) = (40 + rng.below(240) as usize, 20 + rng.below(200) as usize);
                points.add(x as f64 + shift, y as f64, scale * depths[y * SIZE.0 + x]);
            }
            completer.scene(&image).unwrap().alignment(&points).unwrap()
        }

        #[test]
        fn a_shift_is_found_and_none_is_not() {
            let pooled = |shift| {
                let mut all = alignment(0, 1000, shift, 1.0);
                (1..5).for_each(|draw| all.add(&alignment(draw, 1000, shift, 1.0)));
                all.shift().unwrap()
            };
            let shift = pooled(8.0);
            assert!(shift.is_clear(), "{shift:?}");
            assert!(
                (shift.u + 8.0).abs() < 3.0 && shift.v.abs() < 3.0,
                "{shift:?}"
            );
            let none = pooled(0.0);
            assert!(!none.is_clear(), "{none:?}");
        }

        #[test]
        fn evidence_adds_up() {
            let once = alignment(0, 400, 8.0, 1.0);
            let mut twice = once.clone();
            twice.add(&once);
            assert_eq!(twice.points(), 2 * once.points());
            let (once, twice) = (once.shift().unwrap(), twice.shift().unwrap());
            assert_eq!((once.u, once.v), (twice.u, twice.v));
            let ratio = twice.standard_errors / once.standard_errors;
            assert!((ratio - 2_f64.sqrt()).abs() < 0.03, "{ratio}");
        }

        #[test]
        fn the_unit_of_depths_does_not_matter() {
            assert_eq!(alignment(0, 300, 4.0, 1.0), alignment(0, 300, 4.0, 32.0));
        }

        #[test]
        fn few_points_are_no_evidence() {
            let few = alignment(0, FEWEST - 1, 8.0, 1.0);
            assert_eq!((few.points(), few.shift()), (0, None));
        }
    }
}
