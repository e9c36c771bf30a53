//! Affinities (how strongly neighbouring pixels are tied together), and the smooth field that they define.

use super::blocks::Blocks;
use crate::bilinear::{InterpolationWeights, containing, neighbours, rescaled};
use crate::error::FitError;
use crate::field::{FieldPrior, Grid};
use crate::lazy::get_or_compute;
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
    /// The last requested field of these affinities before any observation, with its regularisation.
    prior: Mutex<Option<(f64, Option<FieldPrior>)>>,
    /// Affinities of blocks of pixels.
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

    /// Returns the affinities multiplied by shares `[height, width, 2]`, ordered as in [`Self::new`].
    pub(crate) fn scaled_by(&self, shares: &[f64]) -> Self {
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
    pub fn grid(&self, regularisation: f64) -> Grid<'_> {
        Grid {
            height: self.0.height,
            width: self.0.width,
            right: &self.0.right,
            down: &self.0.down,
            diagonal_regularisation: regularisation,
        }
    }

    /// The field before any observation; `None` without regularisation. It is factorised on first use, and again if the
    /// regularisation changes.
    pub fn prior(&self, regularisation: f64) -> Option<FieldPrior> {
        let cached = self.cached_prior().clone();
        if let Some((_, prior)) = cached.filter(|(of, _)| *of == regularisation) {
            return prior;
        }
        // Computed without the lock: a thread that waits for it may steal a task that needs the same field.
        let found = FieldPrior::new(&self.grid(regularisation));
        *self.cached_prior() = Some((regularisation, found.clone()));
        found
    }

    /// Frees this field; it is factorised again on the next use.
    pub(super) fn drop_prior(&self) {
        *self.cached_prior() = None;
    }

    fn cached_prior(&self) -> MutexGuard<'_, Option<(f64, Option<FieldPrior>)>> {
        self.0.prior.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The blocks of pixels of a rough field.
    pub(crate) fn blocks(&self) -> Blocks {
        /// At 304x228, about one block per four pixels.
        const BLOCKS: usize = 20_000;
        Blocks::new(self.size(), BLOCKS)
    }

    /// The affinities of these blocks, found on first use.
    pub(crate) fn by_block(&self) -> &Self {
        get_or_compute(&self.0.blocks, || self.for_blocks(self.blocks()))
    }

    /// The affinities of some blocks.
    pub(super) fn for_blocks(&self, blocks: Blocks) -> Self {
        let (right, down) = blocks.affinities(&self.grid(0.0));
        Self::from_parts(blocks.counts(), right, down)
    }

    /// The mean logarithm of the affinities of each pixel with its right and its lower neighbour.
    pub(crate) fn logarithms(&self) -> Vec<f64> {
        /// Affinities of 0 separate neighbours.
        const LEAST: f64 = 1e-9;
        let pairs = self.0.right.par_iter().zip(&self.0.down);
        pairs
            .map(|(right, down)| 0.5 * ((right + LEAST) * (down + LEAST)).ln())
            .collect()
    }

    /// The pixel that contains a position (u, v) of an image of `size` (height, width).
    pub(super) fn pixel(&self, [u, v]: [f64; 2], size: (usize, usize)) -> u32 {
        let (column, row) = (
            containing(u, size.1, self.0.width),
            containing(v, size.0, self.0.height),
        );
        (row * self.0.width + column) as u32
    }
}

/// The affinities of the image of the points, and the height and width of the image in which their positions are given.
#[derive(Clone, Copy, Debug)]
pub struct FieldGeometry<'a> {
    /// Affinities of the image, at any resolution.
    pub affinities: &'a Affinities,
    /// Height and width of the image that the points lie in.
    pub size: (usize, usize),
    /// How positions are interpolated, if not bilinearly.
    pub upsampling: Option<&'a Upsampling>,
    /// Whether no other fit to the image follows, so that data for further fits may be freed.
    pub transient: bool,
}

impl FieldGeometry<'_> {
    /// A position (u, v) of the image, on the grid of the field.
    pub(super) fn on_grid(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let (height, width) = self.affinities.size();
        [
            rescaled(u, self.size.1, width),
            rescaled(v, self.size.0, height),
        ]
    }

    /// Returns the interpolation weights of a position (u, v) of the image in the field.
    pub(super) fn interpolation(&self, place: [f64; 2]) -> InterpolationWeights {
        match self.upsampling {
            Some(upsampling) => upsampling.interpolation(place, self.size),
            None => InterpolationWeights::new(place, self.size, self.affinities.size()),
        }
    }
}

/// A smooth field, which can be evaluated at any resolution.
#[derive(Clone, Debug, PartialEq)]
pub struct SmoothField {
    height: usize,
    width: usize,
    values: Vec<f32>,
}

impl SmoothField {
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

    /// The value of the field at the position given by `interpolation`.
    pub fn read(&self, interpolation: &InterpolationWeights) -> f64 {
        let value = |(pixel, share): (u32, f64)| share * f64::from(self.values[pixel as usize]);
        interpolation.iter().map(value).sum()
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
    fn the_field_of_the_last_regularisation_is_cached() {
        let affinities = Affinities::new((6, 8), &[1.0; 96]).unwrap();
        let cached = || {
            affinities
                .cached_prior()
                .as_ref()
                .map(|(regularisation, _)| *regularisation)
        };
        for regularisation in [1e-6, 1e-4, 1e-6] {
            assert!(affinities.prior(regularisation).is_some());
            assert_eq!(cached(), Some(regularisation));
        }
        affinities.drop_prior();
        assert_eq!(cached(), None);
    }
}
