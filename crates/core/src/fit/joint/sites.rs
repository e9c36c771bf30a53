//! Points in the form in which a field observes them.

use super::JointConfig;
use crate::bilinear::Taps;
use crate::error::FitError;
use crate::field::{self, Field, FieldPrior, Grid, Observations};
use crate::fit::affinities::{Affinities, Scene};
use crate::fit::points::Rows;

const UNSOLVABLE: &str = "the equations of the field are not positive definite";

/// Observations of a field: each point at its exact position, but all points within one pixel of the field
/// merged into one, with their mean position, basis functions and depth.
#[derive(Debug)]
pub(super) struct Sites {
    pub(super) taps: Vec<Taps>,
    /// The site of each point, unless the point has no weight.
    pub(super) of_points: Vec<Option<usize>>,
    pub(super) weights: Vec<f64>,
    /// Basis functions and depth.
    pub(super) rows: Vec<f64>,
    ties: Vec<Tie>,
}

/// A penalty on the square of the step of the field between two neighbouring pixels that a site is read from. A
/// point that lies between two pixels belongs to one of them in truth, so that the sum of both squared errors,
/// each by its share, says more than the squared error of the mean: it is larger by the product of the shares
/// and the squared step. Without any of it, two points in one cell of the grid, one on each side of an edge that
/// the colours do not show, would pull its pixels far apart.
#[derive(Clone, Copy, Debug)]
struct Tie {
    one: u32,
    /// The pixel on the right, or below.
    other: u32,
    down: bool,
    weight: f64,
}

/// Weight of the product of shares and squared step, relative to that of the site. Of 0.001, 0.003, 0.01, 0.03
/// and 0.1 on frames of training and of other cameras: with more, edges are less sharp.
const TIE: f64 = 0.01;
/// Ties that are weaker than the affinity of the pixels times this are left out: they change next to nothing.
const TELLING: f64 = 4.0;

impl Sites {
    pub(super) fn new(
        rows: &Rows<'_>,
        weights: &[f64],
        scene: Scene<'_>,
        joint: &JointConfig,
    ) -> Result<Self, FitError> {
        let places = rows.places.ok_or_else(|| {
            FitError::Shape("a field cannot be fitted to points whose places are unknown".into())
        })?;
        let columns = rows.columns();
        let width = columns + 1;
        let mut order: Vec<(u32, usize)> = (0..places.len())
            .filter(|&i| weights[i] > 0.0)
            .map(|i| (scene.affinities.pixel(places[i], scene.size), i))
            .collect();
        // Within a pixel by place and depth, so that the order of the points does not matter.
        let key = |i: usize| [places[i][1], places[i][0], rows.values[i]];
        order.sort_unstable_by(|a, b| {
            let keys = key(a.1).into_iter().zip(key(b.1));
            let unlike = keys
                .map(|(a, b)| a.total_cmp(&b))
                .find(|order| order.is_ne());
            a.0.cmp(&b.0).then(unlike.unwrap_or(a.1.cmp(&b.1)))
        });
        let mut sites = Self {
            taps: Vec::new(),
            of_points: vec![None; places.len()],
            weights: Vec::new(),
            rows: Vec::with_capacity(order.len() * width),
            ties: Vec::new(),
        };
        for points in order.chunk_by(|a, b| a.0 == b.0) {
            let total: f64 = points.iter().map(|&(_, i)| weights[i]).sum();
            let start = sites.rows.len();
            sites.rows.resize(start + width, 0.0);
            // Off the first place: the mean of equal places is that place.
            let (first, mut off) = (places[points[0].1], [0.0; 2]);
            for &(_, i) in points {
                sites.of_points[i] = Some(sites.taps.len());
                let share = weights[i] / total;
                let row = &rows.bases[i * columns..][..columns];
                let sums = &mut sites.rows[start..];
                for (sum, &value) in sums.iter_mut().zip(row) {
                    *sum += share * f64::from(value);
                }
                sums[columns] += share * rows.values[i];
                for axis in 0..2 {
                    off[axis] += share * (places[i][axis] - first[axis]);
                }
            }
            let place = [first[0] + off[0], first[1] + off[1]];
            sites.taps.push(scene.taps(place));
            sites.weights.push(joint.data * total);
        }
        if scene.guide.is_some() {
            sites.tie(&scene.affinities.grid(joint.level));
        }
        Ok(sites)
    }

    /// The field with these observations; the last columns before the depth have ridges.
    pub(super) fn field(
        &self,
        affinities: &Affinities,
        level: f64,
        ridges: &[f64],
    ) -> Result<Field, FitError> {
        let few = self.taps.len() + self.ties.len() <= field::MOST;
        let prior = few.then(|| affinities.prior(level)).flatten();
        let found = prior.and_then(|prior| self.beside(&prior, ridges));
        found.map_or_else(|| self.direct(affinities, level), Ok)
    }

    /// Ties are further observations, of a step of 0 without basis functions; they follow the sites.
    fn beside(&self, prior: &FieldPrior, ridges: &[f64]) -> Option<Field> {
        if self.ties.is_empty() {
            return Field::with_prior(prior, &self.observations(), ridges);
        }
        let steps = self
            .ties
            .iter()
            .map(|tie| Taps::difference(tie.one, tie.other));
        let weights = self.ties.iter().map(|tie| tie.weight);
        let count = self.observations().count;
        let nothing = vec![0.0; self.ties.len() * count];
        let seen = Observations {
            taps: &[&self.taps[..], &steps.collect::<Vec<_>>()].concat(),
            weights: &[&self.weights[..], &weights.collect::<Vec<_>>()].concat(),
            columns: &[&self.rows[..], &nothing].concat(),
            count,
        };
        Field::with_prior(prior, &seen, ridges)
    }

    /// The same, of which every pixel can be asked. Ties add to the affinities.
    pub(super) fn direct(&self, affinities: &Affinities, level: f64) -> Result<Field, FitError> {
        let grid = affinities.grid(level);
        let (mut right, mut down) = (Vec::new(), Vec::new());
        let tied = if self.ties.is_empty() {
            grid
        } else {
            right.extend_from_slice(grid.right);
            down.extend_from_slice(grid.down);
            for tie in &self.ties {
                let along = if tie.down { &mut down } else { &mut right };
                along[tie.one as usize] += tie.weight;
            }
            Grid {
                right: &right,
                down: &down,
                ..grid
            }
        };
        let found = Field::new(&tied, &self.observations());
        found.ok_or(FitError::Unsolvable(UNSOLVABLE))
    }

    /// Ties the pixels of each site.
    fn tie(&mut self, grid: &Grid<'_>) {
        for (taps, weight) in self.taps.iter().zip(&self.weights) {
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
                        self.ties.push(Tie {
                            one,
                            other,
                            down,
                            weight,
                        });
                    }
                }
            }
        }
    }

    fn observations(&self) -> Observations<'_> {
        Observations {
            taps: &self.taps,
            weights: &self.weights,
            columns: &self.rows,
            count: self.rows.len() / self.taps.len().max(1),
        }
    }

    /// Observations, less the one that a level that is free takes.
    pub(super) fn freedom(&self, level: f64) -> usize {
        self.taps.len() - usize::from(level == 0.0 && !self.taps.is_empty())
    }
}
