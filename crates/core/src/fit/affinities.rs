//! Affinities (how strongly neighbouring pixels are tied together), and the smooth field that they define.

use super::blocks::Blocks;
use crate::bilinear::{InterpolationWeights, neighbours};
use crate::error::FitError;
use crate::field::{FieldPrior, Grid};
use crate::upsampling::Upsampling;
use lsdc_kernels::schedule::{InTasks, join};
use rayon::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// The affinities of the pixels of an image with their neighbours. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Affinities(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    height: usize,
    width: usize,
    right: Vec<f64>,
    down: Vec<f64>,
    /// The field of these affinities before any observation, and its level: the last that was asked for.
    prior: Mutex<Option<(f64, Option<FieldPrior>)>>,
    /// Those of blocks of pixels.
    blocks: OnceLock<Affinities>,
}

impl Affinities {
    /// Affinities from `[height, width, 2]`: of each pixel with its right neighbour, and with the one below.
    ///
    /// # Errors
    /// The wrong number of values, or a value that is negative or not finite.
    pub fn new((height, width): (usize, usize), values: &[f32]) -> Result<Self, FitError> {
        if values.len() != 2 * height * width {
            return Err(FitError::Shape(format!(
                "{} affinities do not make two for each of {width}x{height} pixels",
                values.len()
            )));
        }
        if !values.iter().all(|v| v.is_finite() && *v >= 0.0) {
            return Err(FitError::NotFinite);
        }
        let every = |first: usize| -> Vec<f64> {
            let some = values.iter().skip(first).step_by(2);
            some.map(|&v| f64::from(v)).collect()
        };
        let (right, down) = join(|| every(0), || every(1));
        Ok(Self::from_parts((height, width), right, down))
    }

    /// Affinities with the right neighbour, and with the one below: `[height * width]` each.
    pub(super) fn from_parts(
        (height, width): (usize, usize),
        right: Vec<f64>,
        down: Vec<f64>,
    ) -> Self {
        Self(Arc::new(Inner {
            height,
            width,
            right,
            down,
            prior: Mutex::default(),
            blocks: OnceLock::new(),
        }))
    }

    /// The same, each times a share `[height, width, 2]`, ordered as in [`Self::new`].
    pub(crate) fn shared(&self, shares: &[f64]) -> Self {
        let times = |values: &[f64], first: usize| {
            let some = shares.iter().skip(first).step_by(2);
            values.iter().zip(some).map(|(v, s)| v * s).collect()
        };
        Self::from_parts(self.size(), times(&self.0.right, 0), times(&self.0.down, 1))
    }

    /// Height and width.
    pub fn size(&self) -> (usize, usize) {
        (self.0.height, self.0.width)
    }

    /// The grid of a field with these affinities.
    pub fn grid(&self, level: f64) -> Grid<'_> {
        Grid {
            height: self.0.height,
            width: self.0.width,
            right: &self.0.right,
            down: &self.0.down,
            level,
        }
    }

    /// The field before any observation, factorised on first use and again for another level than the last; `None`
    /// without a level.
    pub fn prior(&self, level: f64) -> Option<FieldPrior> {
        let kept = self.kept().clone();
        if let Some((_, prior)) = kept.filter(|(of, _)| *of == level) {
            return prior;
        }
        // Not under the lock: a thread that waits for others there may take up work that asks for the same.
        let found = FieldPrior::new(&self.grid(level));
        *self.kept() = Some((level, found.clone()));
        found
    }

    /// Gives this field back, which is factorised again if it is asked for.
    pub(super) fn forget_prior(&self) {
        *self.kept() = None;
    }

    fn kept(&self) -> MutexGuard<'_, Option<(f64, Option<FieldPrior>)>> {
        self.0.prior.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The blocks that pixels make for what is asked of the field roughly.
    pub(crate) fn blocks(&self) -> Blocks {
        /// Of 304x228 pixels, one in four.
        const BLOCKS: usize = 20_000;
        Blocks::new(self.size(), BLOCKS)
    }

    /// The affinities of these blocks, found on first use.
    pub(crate) fn of_blocks(&self) -> &Self {
        if let Some(found) = self.0.blocks.get() {
            return found;
        }
        // Not within the initialiser, as above.
        let found = self.in_blocks(self.blocks());
        self.0.blocks.get_or_init(|| found)
    }

    /// The affinities of some blocks.
    pub(super) fn in_blocks(&self, blocks: Blocks) -> Self {
        let (right, down) = blocks.affinities(&self.grid(0.0));
        Self::from_parts(blocks.counts(), right, down)
    }

    /// The mean logarithm of the affinities of each pixel with its right and its lower neighbour.
    pub(crate) fn logarithms(&self) -> Vec<f64> {
        /// Affinities of 0 cut neighbours apart.
        const LEAST: f64 = 1e-9;
        let pairs = self.0.right.par_iter().zip(&self.0.down);
        pairs
            .map(|(right, down)| 0.5 * ((right + LEAST) * (down + LEAST)).ln())
            .collect()
    }

    /// The pixel that contains a position (u, v) of an image of `size` (height, width).
    pub(super) fn pixel(&self, [u, v]: [f64; 2], size: (usize, usize)) -> u32 {
        let within = |place: f64, from: usize, to: usize| {
            let scaled = (place + 0.5) * to as f64 / from.max(1) as f64;
            (scaled.max(0.0) as usize).min(to.saturating_sub(1))
        };
        let (column, row) = (
            within(u, size.1, self.0.width),
            within(v, size.0, self.0.height),
        );
        (row * self.0.width + column) as u32
    }
}

/// The affinities of the image that the points lie in, and the height and width in whose pixels their
/// positions are given.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// Affinities of the image, at any resolution.
    pub affinities: &'a Affinities,
    /// Height and width of the image that the points lie in.
    pub size: (usize, usize),
    /// How positions are read, if not bilinearly.
    pub upsampling: Option<&'a Upsampling>,
    /// Whether no other fit to the image follows, so that nothing need be kept for it.
    pub once: bool,
}

impl Scene<'_> {
    /// A position (u, v) of the image, on the grid of the field.
    pub(super) fn on_grid(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let (height, width) = self.affinities.size();
        let scaled = |place: f64, from: usize, to: usize| {
            (place + 0.5) * to as f64 / from.max(1) as f64 - 0.5
        };
        [
            scaled(u, self.size.1, width),
            scaled(v, self.size.0, height),
        ]
    }

    /// The pixels of the field that a position (u, v) of the image is read from.
    pub(super) fn taps(&self, place: [f64; 2]) -> InterpolationWeights {
        match self.upsampling {
            Some(upsampling) => upsampling.taps(place, self.size),
            None => InterpolationWeights::new(place, self.size, self.affinities.size()),
        }
    }
}

/// A smooth field, which can be evaluated at any resolution.
#[derive(Clone, Debug, PartialEq)]
pub struct Smooth {
    height: usize,
    width: usize,
    values: Vec<f32>,
}

impl Smooth {
    pub(crate) fn new((height, width): (usize, usize), values: &[f64]) -> Self {
        let values = values.iter().map(|&v| v as f32).collect();
        Self::from_values((height, width), values)
    }

    pub(crate) fn from_values((height, width): (usize, usize), values: Vec<f32>) -> Self {
        Self {
            height,
            width,
            values,
        }
    }

    /// Height and width.
    pub fn size(&self) -> (usize, usize) {
        (self.height, self.width)
    }

    /// The value of the field where it is read from these pixels.
    pub fn read(&self, taps: &InterpolationWeights) -> f64 {
        let value = |(pixel, share): (u32, f64)| share * f64::from(self.values[pixel as usize]);
        taps.iter().map(value).sum()
    }

    /// Adds the field to a map of `size` (height, width), by bilinear interpolation between pixel centres.
    pub fn add_to(&self, size: (usize, usize), map: &mut [f32]) {
        let axis = |i: usize, from: usize, to: usize| {
            let (low, high, share) = neighbours(i as f64, from, to);
            (low, high, share as f32)
        };
        let columns: Vec<_> = (0..size.1).map(|x| axis(x, size.1, self.width)).collect();
        let rows = map.par_chunks_exact_mut(size.1.max(1)).enumerate();
        rows.each(|(y, row)| {
            let (top, bottom, v) = axis(y, size.0, self.height);
            let [upper, lower] = [top, bottom].map(|y| &self.values[y * self.width..]);
            for (value, &(left, right, u)) in row.iter_mut().zip(&columns) {
                let along = |row: &[f32]| row[left] * (1.0 - u) + row[right] * u;
                *value += along(upper) * (1.0 - v) + along(lower) * v;
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_of_the_last_level_is_kept() {
        let affinities = Affinities::new((6, 8), &[1.0; 96]).unwrap();
        let kept = || affinities.kept().as_ref().map(|(level, _)| *level);
        for level in [1e-6, 1e-4, 1e-6] {
            assert!(affinities.prior(level).is_some());
            assert_eq!(kept(), Some(level));
        }
        affinities.forget_prior();
        assert_eq!(kept(), None);
    }
}
