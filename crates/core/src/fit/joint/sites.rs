//! Points in the form in which a field observes them.

use super::JointConfig;
use crate::bilinear::Taps;
use crate::error::FitError;
use crate::field::{self, Field, Observations};
use crate::fit::affinities::{Affinities, Scene};
use crate::fit::points::Rows;

pub(super) const UNSOLVABLE: &str = "the equations of the field are not positive definite";

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
}

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
            sites.taps.push(scene.affinities.taps(place, scene.size));
            sites.weights.push(joint.data * total);
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
        let seen = self.observations();
        let few = seen.taps.len() <= field::MOST;
        let prior = few.then(|| affinities.prior(level)).flatten();
        let found = prior.and_then(|prior| Field::with_prior(&prior, &seen, ridges));
        found.map_or_else(|| self.direct(affinities, level), Ok)
    }

    /// The same, of which every pixel can be asked.
    pub(super) fn direct(&self, affinities: &Affinities, level: f64) -> Result<Field, FitError> {
        let found = Field::new(&affinities.grid(level), &self.observations());
        found.ok_or(FitError::Unsolvable(UNSOLVABLE))
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
