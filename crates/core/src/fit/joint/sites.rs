//! Points in the form in which a field observes them.

use super::JointConfig;
use crate::bilinear::Taps;
use crate::error::FitError;
use crate::fit::affinities::Scene;
use crate::fit::points::Rows;
use lsdc_rng::Rng;
use rayon::prelude::*;

/// Observations of a field: each point at its exact position, but all points within one pixel of the field
/// merged into one, with their mean position and depth.
#[derive(Debug)]
pub(super) struct Sites {
    pub(super) taps: Vec<Taps>,
    pub(super) weights: Vec<f64>,
    pub(super) depths: Vec<f64>,
    /// The site of each point, unless the point has no weight.
    pub(super) of_points: Vec<Option<usize>>,
    /// The points of all sites, one site after the other, with their shares of it.
    members: Vec<(usize, f64)>,
    /// Where the points of each site begin, and the end.
    starts: Vec<usize>,
}

/// Some sites, with their basis functions.
#[derive(Debug)]
pub(super) struct Sample {
    pub(super) taps: Vec<Taps>,
    pub(super) weights: Vec<f64>,
    /// Basis functions, each the mean of the points, and depth.
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
        let mut order: Vec<(u32, usize)> = (0..places.len())
            .filter(|&i| weights[i] > 0.0)
            .map(|i| (scene.affinities.pixel(places[i], scene.size), i))
            .collect();
        // Within a pixel by place and depth, so that the order of the points does not matter.
        let key = |i: usize| [places[i][1], places[i][0], rows.values[i]];
        order.par_sort_unstable_by(|a, b| {
            let keys = key(a.1).into_iter().zip(key(b.1));
            let unlike = keys
                .map(|(a, b)| a.total_cmp(&b))
                .find(|order| order.is_ne());
            a.0.cmp(&b.0).then(unlike.unwrap_or(a.1.cmp(&b.1)))
        });
        let mut sites = Self {
            taps: Vec::new(),
            weights: Vec::new(),
            depths: Vec::new(),
            of_points: vec![None; places.len()],
            members: Vec::with_capacity(order.len()),
            starts: vec![0],
        };
        for points in order.chunk_by(|a, b| a.0 == b.0) {
            let total: f64 = points.iter().map(|&(_, i)| weights[i]).sum();
            // Off the first place: the mean of equal places is that place.
            let (first, mut off, mut depth) = (places[points[0].1], [0.0; 2], 0.0);
            for &(_, i) in points {
                sites.of_points[i] = Some(sites.taps.len());
                let share = weights[i] / total;
                depth += share * rows.values[i];
                for axis in 0..2 {
                    off[axis] += share * (places[i][axis] - first[axis]);
                }
                sites.members.push((i, share));
            }
            let place = [first[0] + off[0], first[1] + off[1]];
            sites.taps.push(scene.taps(place));
            sites.weights.push(joint.data * total);
            sites.depths.push(depth);
            sites.starts.push(sites.members.len());
        }
        Ok(sites)
    }

    /// The number of sites.
    pub(super) fn len(&self) -> usize {
        self.taps.len()
    }

    /// The mean at each site of values at the points.
    pub(super) fn means(&self, values: &[f64]) -> Vec<f64> {
        let mean =
            |members: &[(usize, f64)]| members.iter().map(|&(i, share)| share * values[i]).sum();
        (0..self.len())
            .map(|site| mean(self.members(site)))
            .collect()
    }

    fn members(&self, site: usize) -> &[(usize, f64)] {
        &self.members[self.starts[site]..self.starts[site + 1]]
    }

    /// At most so many sites with their basis functions: a random choice, which is the same for the same sites.
    ///
    /// # Errors
    /// Basis functions that are not finite.
    pub(super) fn sample(&self, most: usize, rows: &Rows<'_>) -> Result<Sample, FitError> {
        /// Sites whose points are evaluated at once.
        const TOGETHER: usize = 128;
        let chosen = choice(self.len(), most);
        let columns = rows.columns();
        let mut values = vec![0.0; chosen.len() * (columns + 1)];
        let parts = values.par_chunks_mut(TOGETHER * (columns + 1));
        let gather = |(values, sites): (&mut [f64], &[usize])| {
            let members = || sites.iter().map(|&site| self.members(site));
            let points: Vec<usize> = members().flatten().map(|&(i, _)| i).collect();
            let bases = rows.bases_of(&points)?;
            let mut own = bases.chunks_exact(columns.max(1));
            let targets = values.chunks_exact_mut(columns + 1).zip(sites);
            for ((row, &site), members) in targets.zip(members()) {
                for ((_, share), base) in members.iter().zip(&mut own) {
                    let pairs = row.iter_mut().zip(base);
                    pairs.for_each(|(sum, value)| *sum += share * f64::from(*value));
                }
                row[columns] = self.depths[site];
            }
            Ok(())
        };
        parts
            .zip(chosen.par_chunks(TOGETHER))
            .try_for_each(gather)?;
        Ok(Sample {
            taps: chosen.iter().map(|&site| self.taps[site]).collect(),
            weights: chosen.iter().map(|&site| self.weights[site]).collect(),
            rows: values,
        })
    }
}

/// At most so many of the first numbers, in ascending order.
fn choice(count: usize, most: usize) -> Vec<usize> {
    let mut all: Vec<usize> = (0..count).collect();
    if count > most {
        Rng::stream(0, &["sites"]).choose(&mut all, most);
        all.truncate(most);
        all.sort_unstable();
    }
    all
}

impl Sample {
    /// The number of sites.
    pub(super) fn len(&self) -> usize {
        self.taps.len()
    }

    /// The number of basis functions, including the cosines.
    pub(super) fn columns(&self) -> usize {
        (self.rows.len() / self.len().max(1)).saturating_sub(1)
    }

    /// At most so many of them.
    pub(super) fn some(&self, most: usize) -> Self {
        let chosen = choice(self.len(), most);
        let stride = self.columns() + 1;
        let rows = chosen
            .iter()
            .flat_map(|&i| &self.rows[i * stride..][..stride]);
        Self {
            taps: chosen.iter().map(|&i| self.taps[i]).collect(),
            weights: chosen.iter().map(|&i| self.weights[i]).collect(),
            rows: rows.copied().collect(),
        }
    }
}
