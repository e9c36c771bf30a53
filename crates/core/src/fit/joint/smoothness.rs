//! How smooth the field of an image is, and how sites join it.

use super::crowded::Crowded;
use super::merged_observations::{MergedObservations, Sample};
use crate::bilinear::InterpolationWeights;
use crate::error::FitError;
use crate::field::{CovarianceSolver, Grid, Observations, PrecisionSolver};
use crate::fit::affinities::Affinities;

/// The field of an image before any site.
#[derive(Clone, Debug)]
pub(super) struct Smoothness {
    pub(super) affinities: Affinities,
    pub(super) level: f64,
    /// Whether the pixels that a site is read from are tied: in an image that is larger than the field.
    pub(super) tied: bool,
    /// Whether sites are lumped where they are crowded: not where the field is only asked for roughly.
    pub(super) lumped: bool,
}

/// A penalty on the square of the step of the field between two neighbouring pixels that a site is read from. A
/// point that lies between two pixels belongs to one of them in truth, so that the sum of both squared errors,
/// each by its share, says more than the squared error of the mean: it is larger by the product of the shares
/// and the squared step. Without any of it, two points in one cell of the grid, one on each side of an edge that
/// the colours do not show, would pull its pixels far apart.
#[derive(Clone, Copy, Debug)]
struct SmoothnessTerm {
    one: u32,
    /// The pixel on the right, or below.
    other: u32,
    down: bool,
    weight: f64,
}

impl Smoothness {
    /// The field with a few sites and their columns.
    ///
    /// # Errors
    /// Equations that are not positive definite.
    pub(super) fn covariance_solver(&self, sample: &Sample) -> Result<CovarianceSolver, FitError> {
        let prior = self.affinities.prior(self.level).ok_or_else(unsolvable)?;
        let ties = self.ties(&sample.taps, &sample.weights, &Crowded::nowhere());
        let count = sample.columns() + 1;
        let seen = Observations {
            taps: &sample.taps,
            weights: &sample.weights,
            columns: &sample.rows,
            count,
        };
        let field = if ties.is_empty() {
            CovarianceSolver::new(&prior, &seen)
        } else {
            // Ties are further observations, of a step of 0 without basis functions.
            let steps = ties
                .iter()
                .map(|tie| InterpolationWeights::difference(tie.one, tie.other));
            let weights = ties.iter().map(|tie| tie.weight);
            let nothing = vec![0.0; ties.len() * count];
            let tied = Observations {
                taps: &[seen.taps, &steps.collect::<Vec<_>>()].concat(),
                weights: &[seen.weights, &weights.collect::<Vec<_>>()].concat(),
                columns: &[seen.columns, &nothing].concat(),
                count,
            };
            CovarianceSolver::new(&prior, &tied)
        };
        field.ok_or_else(unsolvable)
    }

    /// The field of blocks of pixels.
    pub(super) fn of_blocks(&self) -> Self {
        Self {
            affinities: self.affinities.of_blocks().clone(),
            level: self.level * self.affinities.blocks().area() as f64,
            tied: self.tied,
            lumped: false,
        }
    }

    /// The same without ties, which matter next to sites that a map is read at, not for the weights.
    pub(super) fn untied(&self) -> Self {
        Self {
            tied: false,
            ..self.clone()
        }
    }

    /// The number of observations that sites are, with their ties, where no site is lumped.
    pub(super) fn observations(&self, sites: &MergedObservations) -> Option<usize> {
        let crowded = self.crowded(&sites.taps);
        let ties = || self.ties(&sites.taps, &sites.weights, &crowded).len();
        (!crowded.any()).then(|| sites.len() + ties())
    }

    /// The field with any number of sites.
    ///
    /// # Errors
    /// Equations that are not positive definite.
    pub(super) fn observed(
        &self,
        taps: &[InterpolationWeights],
        weights: &[f64],
    ) -> Result<PrecisionSolver, FitError> {
        let grid = self.affinities.grid(self.level);
        let crowded = self.crowded(taps);
        let ties = self.ties(taps, weights, &crowded);
        let lumped = |site: usize| crowded.is(site);
        let field = if ties.is_empty() {
            PrecisionSolver::with_lumped(&grid, taps, weights, lumped)
        } else {
            let (mut right, mut down) = (grid.right.to_vec(), grid.down.to_vec());
            for tie in ties {
                let along = if tie.down { &mut down } else { &mut right };
                along[tie.one as usize] += tie.weight;
            }
            let tied = Grid {
                right: &right,
                down: &down,
                ..grid
            };
            PrecisionSolver::with_lumped(&tied, taps, weights, lumped)
        };
        field.ok_or_else(unsolvable)
    }

    /// The sites that are lumped.
    fn crowded(&self, taps: &[InterpolationWeights]) -> Crowded {
        if self.lumped {
            Crowded::among(taps, self.affinities.size())
        } else {
            Crowded::nowhere()
        }
    }

    /// The ties of the sites that are not lumped.
    fn ties(
        &self,
        taps: &[InterpolationWeights],
        weights: &[f64],
        crowded: &Crowded,
    ) -> Vec<SmoothnessTerm> {
        /// Weight of the product of shares and squared step, relative to that of the site. Of 0.001, 0.003, 0.01,
        /// 0.03 and 0.1 on frames of training and of other cameras: with more, edges are less sharp.
        const TIE: f64 = 0.01;
        /// Ties that are weaker than the affinity of the pixels times this are left out: they change next to
        /// nothing.
        const TELLING: f64 = 4.0;
        let mut ties = Vec::new();
        if !self.tied {
            return ties;
        }
        let grid = self.affinities.grid(self.level);
        let alone = taps.iter().zip(weights).enumerate();
        for (_, (taps, weight)) in alone.filter(|(site, _)| !crowded.is(*site)) {
            for (i, (one, share)) in taps.iter().enumerate() {
                // In the order of the pixels.
                for (other, across) in taps.iter().skip(i + 1) {
                    let down = other as usize == one as usize + grid.width;
                    let beside = other == one + 1 && !(other as usize).is_multiple_of(grid.width);
                    if !down && !beside {
                        continue;
                    }
                    let along = if down { grid.down } else { grid.right };
                    let weight = TIE * weight * share * across;
                    if weight > TELLING * along[one as usize] {
                        ties.push(SmoothnessTerm {
                            one,
                            other,
                            down,
                            weight,
                        });
                    }
                }
            }
        }
        ties
    }
}

pub(super) fn unsolvable() -> FitError {
    FitError::Unsolvable("the equations of the field are not positive definite")
}
