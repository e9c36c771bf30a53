//! Points in the form in which a field observes them.

use super::JointConfig;
use crate::bilinear::InterpolationWeights;
use crate::error::FitError;
use crate::fit::affinities::Scene;
use crate::fit::points::Rows;
use lsdc_kernels::schedule::InTasks;
use lsdc_rng::Rng;
use rayon::prelude::*;

/// Observations of a field: each point at its exact position, but all points within one pixel of the field
/// merged into one, with their mean position and depth.
#[derive(Debug)]
pub(super) struct MergedObservations {
    pub(super) taps: Vec<InterpolationWeights>,
    pub(super) weights: Vec<f64>,
    pub(super) depths: Vec<f64>,
    /// Mean positions (u, v) on the grid of the field.
    pub(super) places: Vec<[f64; 2]>,
    /// The mean weight of the points of each.
    means: Vec<f64>,
    /// By what [`Self::scale`] multiplied the weights.
    scales: Vec<f64>,
    /// The site of each point, [`NONE`] if the point has no weight.
    of_points: Vec<u32>,
    /// The points of all sites, one site after the other.
    members: Vec<u32>,
    /// The share of each of these in its site.
    shares: Vec<f64>,
    /// Where the points of each site begin, and the end.
    starts: Vec<usize>,
}

/// No site.
const NONE: u32 = u32::MAX;

/// Some sites, with their basis functions.
#[derive(Debug)]
pub(super) struct Sample {
    pub(super) taps: Vec<InterpolationWeights>,
    pub(super) weights: Vec<f64>,
    /// Basis functions, each the mean of the points, and depth.
    pub(super) rows: Vec<f64>,
}

impl MergedObservations {
    pub(super) fn new(
        rows: &Rows<'_>,
        weights: &[f64],
        scene: Scene<'_>,
        joint: &JointConfig,
    ) -> Result<Self, FitError> {
        let places = rows.places.ok_or_else(|| {
            FitError::Shape("a field cannot be fitted to points whose places are unknown".into())
        })?;
        let (mut members, starts) = by_pixel(places, weights, scene);
        // Within a pixel by place and depth, so that the order of the points does not matter.
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
        let site = |points: &mut [u32]| {
            points.sort_unstable_by(|&a, &b| {
                let keys = key(a).into_iter().zip(key(b));
                let unlike = keys
                    .map(|(a, b)| a.total_cmp(&b))
                    .find(|order| order.is_ne());
                unlike.unwrap_or(a.cmp(&b))
            });
            let total: f64 = points.iter().map(|&i| weights[i as usize]).sum();
            // Off the first place: the mean of equal places is that place.
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
            (scene.taps(place), total, depth, scene.on_grid(place))
        };
        let found: Vec<_> = groups.into_par_iter().gather(site);
        let mut of_points = vec![NONE; places.len()];
        let mut shares = Vec::with_capacity(members.len());
        for (site, ([start, end], (_, total, ..))) in starts.array_windows().zip(&found).enumerate()
        {
            for &i in &members[*start..*end] {
                of_points[i as usize] = site as u32;
                shares.push(weights[i as usize] / total);
            }
        }
        let counts = starts
            .array_windows()
            .map(|[start, end]| (end - start) as f64);
        let means = found.iter().zip(counts).map(|(site, count)| site.1 / count);
        Ok(Self {
            taps: found.iter().map(|site| site.0).collect(),
            weights: found.iter().map(|site| joint.data * site.1).collect(),
            depths: found.iter().map(|site| site.2).collect(),
            places: found.iter().map(|site| site.3).collect(),
            means: means.collect(),
            scales: vec![1.0; found.len()],
            of_points,
            members,
            shares,
            starts,
        })
    }

    /// The number of sites.
    pub(super) fn len(&self) -> usize {
        self.taps.len()
    }

    /// How far each site is believed beside others: by the mean weight of its points, at most 1.
    pub(super) fn firmness(&self) -> Vec<f64> {
        self.means.iter().map(|mean| mean.min(1.0)).collect()
    }

    /// Multiplies the weight of each site by a factor that depends on its depth.
    pub(super) fn scale(&mut self, factor: impl Fn(f64) -> f64) {
        let sites = self.weights.iter_mut().zip(&mut self.scales);
        for ((weight, scale), &depth) in sites.zip(&self.depths) {
            let factor = factor(depth);
            *weight *= factor;
            *scale *= factor;
        }
    }

    /// By what the weight of a site was multiplied.
    pub(super) fn scale_of(&self, site: usize) -> f64 {
        self.scales[site]
    }

    /// The mean at each site of values at the points.
    pub(super) fn means(&self, values: &[f64]) -> Vec<f64> {
        let mean = |site| {
            let members = self.members(site);
            members.map(|(i, share)| share * values[i]).sum()
        };
        (0..self.len()).map(mean).collect()
    }

    /// The points of a site and their shares.
    fn members(&self, site: usize) -> impl Iterator<Item = (usize, f64)> {
        let range = self.starts[site]..self.starts[site + 1];
        let pairs = self.members[range.clone()].iter().zip(&self.shares[range]);
        pairs.map(|(&i, &share)| (i as usize, share))
    }

    /// The site of each point, unless it has no weight.
    pub(super) fn of_points(&self) -> impl Iterator<Item = Option<usize>> {
        let site = |&site: &u32| (site != NONE).then_some(site as usize);
        self.of_points.iter().map(site)
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
            let points: Vec<usize> = members().flatten().map(|(i, _)| i).collect();
            let bases = rows.bases_of(&points)?;
            let mut own = bases.chunks_exact(columns.max(1));
            let targets = values.chunks_exact_mut(columns + 1).zip(sites);
            for ((row, &site), members) in targets.zip(members()) {
                for ((_, share), base) in members.zip(&mut own) {
                    let pairs = row.iter_mut().zip(base);
                    pairs.for_each(|(sum, value)| *sum += share * f64::from(*value));
                }
                row[columns] = self.depths[site];
            }
            Ok(())
        };
        parts
            .zip(chosen.par_chunks(TOGETHER))
            .gather::<Result<(), FitError>, _>(gather)?;
        Ok(Sample {
            taps: chosen.iter().map(|&site| self.taps[site]).collect(),
            weights: chosen.iter().map(|&site| self.weights[site]).collect(),
            rows: values,
        })
    }
}

/// The points with a weight, sorted by the pixels of the field that contain them, and where those of each pixel with
/// points begin, and the end.
fn by_pixel(places: &[[f64; 2]], weights: &[f64], scene: Scene<'_>) -> (Vec<u32>, Vec<usize>) {
    let (height, width) = scene.affinities.size();
    let pairs = places.par_iter().zip(weights);
    let pixels: Vec<u32> = pairs
        .map(|(&place, weight)| {
            let counts = *weight > 0.0;
            counts.then(|| scene.affinities.pixel(place, scene.size))
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
        // Where the next point goes.
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
}
