//! Conversion of points to observations of a field.

use super::JointConfig;
use crate::bilinear::InterpolationWeights;
use crate::error::FitError;
use crate::fit::affinities::FieldGeometry;
use crate::fit::points::{FitRows, lexicographic};
use lsdc_kernels::schedule::InTasks;
use lsdc_rng::Rng;
use rayon::prelude::*;

/// Observations of a field: each point at its exact position, but all points within one pixel of the field
/// merged into one, with their mean position and depth.
#[derive(Debug)]
pub(super) struct MergedObservations {
    pub(super) interpolation: Vec<InterpolationWeights>,
    pub(super) weights: Vec<f64>,
    pub(super) depths: Vec<f64>,
    /// Mean positions (u, v) on the grid of the field.
    pub(super) places: Vec<[f64; 2]>,
    /// Mean weight of the points of each observation.
    means: Vec<f64>,
    /// The factors of [`Self::scale`].
    scales: Vec<f64>,
    /// The observation of each point, [`NONE`] if the point has no weight.
    of_points: Vec<u32>,
    /// The points of all observations, one observation after the other.
    members: Vec<u32>,
    /// Share of each of these points in its observation.
    shares: Vec<f64>,
    /// Start of the points of each observation, followed by the end.
    starts: Vec<usize>,
}

/// Observations per task.
const TOGETHER: usize = 128;

/// No observation.
const NONE: u32 = u32::MAX;

/// A sample of observations, with their basis functions.
#[derive(Debug)]
pub(super) struct SampledObservations {
    pub(super) interpolation: Vec<InterpolationWeights>,
    pub(super) weights: Vec<f64>,
    /// Basis functions and depth, each the mean over the points.
    pub(super) rows: Vec<f64>,
}

impl MergedObservations {
    pub(super) fn new(
        rows: &FitRows<'_>,
        weights: &[f64],
        geometry: FieldGeometry<'_>,
        joint: &JointConfig,
    ) -> Result<Self, FitError> {
        let places = rows.places.ok_or_else(|| {
            FitError::Shape("a field cannot be fitted to points whose places are unknown".into())
        })?;
        let (mut members, starts) = by_pixel(places, weights, geometry);
        // Sorted within a pixel by position and depth, so that the order of the points does not matter.
        let key = |i: u32| {
            let i = i as usize;
            [places[i][1], places[i][0], rows.values[i]]
        };
        let mut rest = &mut members[..];
        let mut groups = Vec::with_capacity(starts.len() - 1);
        for range in starts.array_windows().map(|[start, end]| end - start) {
            let (own, others) = rest.split_at_mut(range);
            groups.push(own);
            rest = others;
        }
        let observation = |points: &mut [u32]| {
            points.sort_unstable_by(|&a, &b| lexicographic(key(a), key(b)).then(a.cmp(&b)));
            let total: f64 = points.iter().map(|&i| weights[i as usize]).sum();
            // Relative to the first position, so that the mean of equal positions is exact.
            let (first, mut off, mut depth) = (places[points[0] as usize], [0.0; 2], 0.0);
            for &i in &*points {
                let i = i as usize;
                let share = weights[i] / total;
                depth += share * rows.values[i];
                for axis in 0..2 {
                    off[axis] += share * (places[i][axis] - first[axis]);
                }
            }
            let place = [first[0] + off[0], first[1] + off[1]];
            (
                geometry.interpolation(place),
                total,
                depth,
                geometry.on_grid(place),
            )
        };
        let parts = groups.par_chunks_mut(TOGETHER);
        let found: Vec<Vec<_>> = parts.gather(|groups| {
            let groups = groups.iter_mut();
            groups.map(|points| observation(points)).collect()
        });
        let count = groups.len();
        let mut merged = Self {
            interpolation: Vec::with_capacity(count),
            weights: Vec::with_capacity(count),
            depths: Vec::with_capacity(count),
            places: Vec::with_capacity(count),
            means: Vec::with_capacity(count),
            scales: vec![1.0; count],
            of_points: vec![NONE; places.len()],
            shares: Vec::with_capacity(members.len()),
            members,
            starts,
        };
        for (observation, (interpolation, total, depth, place)) in
            found.into_iter().flatten().enumerate()
        {
            let range = merged.starts[observation]..merged.starts[observation + 1];
            merged.means.push(total / range.len() as f64);
            for &i in &merged.members[range] {
                merged.of_points[i as usize] = observation as u32;
                merged.shares.push(weights[i as usize] / total);
            }
            merged.interpolation.push(interpolation);
            merged.weights.push(joint.observation_precision * total);
            merged.depths.push(depth);
            merged.places.push(place);
        }
        Ok(merged)
    }

    /// The number of observations.
    pub(super) fn len(&self) -> usize {
        self.interpolation.len()
    }

    /// The mean weight of the points of each observation, at most 1.
    pub(super) fn firmness(&self) -> Vec<f64> {
        self.means.iter().map(|mean| mean.min(1.0)).collect()
    }

    /// Multiplies the weight of each observation by a factor that depends on its depth.
    pub(super) fn scale(&mut self, factor: impl Fn(f64) -> f64) {
        let pairs = self.weights.iter_mut().zip(&mut self.scales);
        for ((weight, scale), &depth) in pairs.zip(&self.depths) {
            let factor = factor(depth);
            *weight *= factor;
            *scale *= factor;
        }
    }

    /// The factor of the weight of an observation.
    pub(super) fn scale_of(&self, observation: usize) -> f64 {
        self.scales[observation]
    }

    /// The mean at each observation of values at the points.
    pub(super) fn means(&self, values: &[f64]) -> Vec<f64> {
        let mean = |observation| {
            let members = self.members(observation);
            members.map(|(i, share)| share * values[i]).sum()
        };
        (0..self.len()).map(mean).collect()
    }

    /// The points of an observation and their shares.
    fn members(&self, observation: usize) -> impl Iterator<Item = (usize, f64)> {
        let range = self.starts[observation]..self.starts[observation + 1];
        let pairs = self.members[range.clone()].iter().zip(&self.shares[range]);
        pairs.map(|(&i, &share)| (i as usize, share))
    }

    /// The observation of each point, unless it has no weight.
    pub(super) fn of_points(&self) -> impl Iterator<Item = Option<usize>> {
        let observation =
            |&observation: &u32| (observation != NONE).then_some(observation as usize);
        self.of_points.iter().map(observation)
    }

    /// A random sample of at most `most` observations with their basis functions, the same for the same observations.
    ///
    /// # Errors
    /// Basis functions that are not finite.
    pub(super) fn sample(
        &self,
        most: usize,
        rows: &FitRows<'_>,
    ) -> Result<SampledObservations, FitError> {
        let chosen = choice(self.len(), most);
        let columns = rows.columns();
        let mut values = vec![0.0; chosen.len() * (columns + 1)];
        let parts = values.par_chunks_mut(TOGETHER * (columns + 1));
        let gather = |(values, indices): (&mut [f64], &[usize])| {
            let members = || indices.iter().map(|&observation| self.members(observation));
            let points: Vec<usize> = members().flatten().map(|(i, _)| i).collect();
            let bases = rows.bases_of(&points)?;
            let mut own = bases.chunks_exact(columns.max(1));
            let targets = values.chunks_exact_mut(columns + 1).zip(indices);
            for ((row, &observation), members) in targets.zip(members()) {
                for ((_, share), base) in members.zip(&mut own) {
                    let pairs = row.iter_mut().zip(base);
                    pairs.for_each(|(sum, value)| *sum += share * f64::from(*value));
                }
                row[columns] = self.depths[observation];
            }
            Ok(())
        };
        parts
            .zip(chosen.par_chunks(TOGETHER))
            .gather::<Result<(), FitError>, _>(gather)?;
        Ok(SampledObservations {
            interpolation: chosen
                .iter()
                .map(|&observation| self.interpolation[observation])
                .collect(),
            weights: chosen
                .iter()
                .map(|&observation| self.weights[observation])
                .collect(),
            rows: values,
        })
    }
}

/// Returns the points with a weight, sorted by the pixels of the field that contain them, and the start of the points of each
/// non-empty pixel, followed by the end.
fn by_pixel(
    places: &[[f64; 2]],
    weights: &[f64],
    geometry: FieldGeometry<'_>,
) -> (Vec<u32>, Vec<usize>) {
    let (height, width) = geometry.affinities.size();
    let pairs = places.par_iter().zip(weights);
    let pixels: Vec<u32> = pairs
        .map(|(&place, weight)| {
            let counts = *weight > 0.0;
            counts.then(|| geometry.affinities.pixel(place, geometry.size))
        })
        .map(|pixel| pixel.unwrap_or(NONE))
        .collect();
    let mut ends = vec![0_u32; height * width];
    let weighted = || pixels.iter().filter(|pixel| **pixel != NONE);
    weighted().for_each(|&pixel| ends[pixel as usize] += 1);
    let mut starts = vec![0];
    let mut total = 0;
    for end in ends.iter_mut().filter(|count| **count > 0) {
        total += *end;
        starts.push(total as usize);
        // Index of the next point.
        *end = total - *end;
    }
    let mut members = vec![0; total as usize];
    for (i, &pixel) in pixels.iter().enumerate() {
        if pixel != NONE {
            let place = &mut ends[pixel as usize];
            members[*place as usize] = i as u32;
            *place += 1;
        }
    }
    (members, starts)
}

/// Returns at most `most` of the first `count` numbers, in ascending order.
fn choice(count: usize, most: usize) -> Vec<usize> {
    let mut all: Vec<usize> = (0..count).collect();
    if count > most {
        Rng::stream(0, &["sites"]).choose(&mut all, most);
        all.truncate(most);
        all.sort_unstable();
    }
    all
}

impl SampledObservations {
    /// The number of observations.
    pub(super) fn len(&self) -> usize {
        self.interpolation.len()
    }

    /// The number of basis functions, including the cosines.
    pub(super) fn columns(&self) -> usize {
        (self.rows.len() / self.len().max(1)).saturating_sub(1)
    }
}
