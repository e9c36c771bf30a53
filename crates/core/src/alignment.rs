//! Tests whether points are shifted relative to the image, by their leave-one-out errors at shifted positions.

use crate::comparison::{Comparison, is_clear, random_sample};
use crate::error::Result;
use crate::observations::{Observation, Observations};
use crate::scene::Scene;
use crate::usable::UsableObservations;
use std::fmt::{Display, Formatter};

/// Lengths of the tested shifts, in pixels of an image of `AREA` pixels.
const LENGTHS: [f64; 5] = [2.0, 4.0, 8.0, 12.0, FARTHEST];
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

/// The evidence of one or more frames for a shift between points and image, as caused by wrong extrinsics or time stamps.
///
/// The points are predicted from each other (leave-one-out, basis functions alone) at their positions and moved by 40 shifts of
/// up to a twentieth of the width of the image ([`Comparison`]).
///
/// Frames are pooled by [`Self::add`]: a shift of a whole sequence is detectable before it is clear in any single frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    comparison: Comparison,
    /// The unit of the shifts, in pixels of the image.
    pixel: f64,
}

/// The shift of the points that matches the image best.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Shift {
    /// To the right, in pixels of the image.
    pub u: f64,
    /// Down, in pixels of the image.
    pub v: f64,
    /// Mean leave-one-out error of the points at their positions, relative to their depth.
    pub error: f64,
    /// Mean leave-one-out error of the moved points, relative to their depth.
    pub error_moved: f64,
    /// The gain in log-likelihood, divided by its standard error.
    pub standard_errors: f64,
    /// Number of frames with evidence.
    pub frames: usize,
}

impl Shift {
    /// Whether the moved points match the image significantly better: by 6 standard errors in five frames or more, by 9 in
    /// fewer, and by 5 % of the error.
    pub fn is_clear(&self) -> bool {
        is_clear(
            [self.error, self.error_moved],
            self.standard_errors,
            self.frames,
        )
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
    /// Tests whether the observations are shifted relative to the image, by 41 fits to at most 2000 of them: use it for the
    /// first frames of a robot or a recording rather than for each.
    ///
    /// Observations nearer to the border than the longest shift are skipped. Fewer than 100 remaining observations are no
    /// evidence.
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
        let all: Vec<[f64; 2]> = shifts().collect();
        let moved = |i: usize| {
            let [u, v] = all[i];
            let moved = points.iter().map(|point| Observation {
                u: point.u + u * pixel,
                v: point.v + v * pixel,
                ..*point
            });
            moved.collect()
        };
        let comparison = self.compared(&points, all.len(), moved)?;
        Ok(Alignment { comparison, pixel })
    }
}

impl Alignment {
    /// Adds the evidence of another frame of the same camera and scanner.
    pub fn add(&mut self, other: &Self) {
        self.comparison.add(&other.comparison);
    }

    /// The number of points that were compared, over all frames.
    pub fn points(&self) -> usize {
        self.comparison.points()
    }

    /// The best of the shifts, clear or not; `None` without evidence.
    pub fn shift(&self) -> Option<Shift> {
        let best = self.comparison.best()?;
        let [u, v] = shifts().nth(best.index)?.map(|length| length * self.pixel);
        Some(Shift {
            u,
            v,
            error: best.error,
            error_moved: best.error_there,
            standard_errors: best.standard_errors,
            frames: best.frames,
        })
    }
}

/// Returns the tested shifts, to the right and down.
fn shifts() -> impl Iterator<Item = [f64; 2]> {
    LENGTHS.into_iter().flat_map(|length| {
        let directions = DIRECTIONS.into_iter();
        directions.map(move |direction| direction.map(|share| length * share))
    })
}

/// Returns a sample of the usable observations that are at least `margin` inside an image of `size` (height, width).
fn chosen(
    observations: &Observations,
    size: (usize, usize),
    margin: f64,
) -> Result<Vec<Observation>> {
    let usable = UsableObservations::new(observations, size)?;
    let inside = |place: f64, length: usize| {
        let end = length as f64 - 1.0 - margin;
        (margin..=end).contains(&place)
    };
    let points = usable.indices.iter().map(|&i| observations.as_slice()[i]);
    let points = points.filter(|point| inside(point.u, size.1) && inside(point.v, size.0));
    Ok(random_sample(points.collect()))
}

#[cfg(test)]
mod tests {
    #[cfg(feature = "weights")]
    mod of_a_scene {
        use super::super::*;
        use crate::comparison::FEWEST;
        use crate::{Channels, Completer, Image, Weights};
        use lsdc_rng::Rng;

        const SIZE: (usize, usize) = (320, 240);

        /// Draws boxes in front of a wall, each with its own colour and depth; later boxes cover earlier ones.
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

        /// Computes the evidence from a sample of points that are shifted by `shift` pixels to the right.
        fn alignment(draw: u64, count: usize, shift: f64, scale: f32) -> Alignment {
            let (colours, depths) = boxes();
            let completer = Completer::new(&Weights::builtin_small()).unwrap();
            let image = Image::new(SIZE.0, SIZE.1, Channels::Rgb, &colours).unwrap();
            let mut rng = Rng::stream(draw, &["points"]);
            let mut points = Observations::new();
            for _ in 0..count {
                // Farther from the border than the longest shift, also after the points are moved.
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
