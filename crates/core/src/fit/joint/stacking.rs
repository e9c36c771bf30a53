//! The joint fit stacked with two other interpolations of the same observations: the field alone, without basis
//! functions, and the surface that the observations span, which does not depend on the image.
//!
//! On images like the training images, the joint fit is the best of the three; on others, or across an edge that the
//! image does not show, another may be. At a pixel, the depth with the smallest sum of distances to all three is their
//! median m. The map is `z + s (m - z)`, where z is the joint fit and s from 0 to 1. With few observations, s minimises
//! the absolute errors of the observations, each predicted by all three without it (stacking: Wolpert 1992, Breiman
//! 1996):
//!
//! > sum over observations |d - z' - s (m' - z')|
//!
//! whose minimum is a weighted median of the ratios of `d - z'` to `m' - z'`. Observations test gaps as wide as those
//! around themselves: in wider gaps s is smaller, and outside of the surface the map is the joint fit. With many
//! observations no s is estimated, and the map is the median inside.

use super::merged_observations::MergedObservations;
use super::smoothness::Smoothness;
use super::surface::{LeftOut, Surface, left_out};
use super::weight_estimate::WeightEstimate;
use crate::field::{CovarianceSolver, PrecisionSolver};
use crate::fit::leave_one_out::least_freedom;
use crate::fit::lstsq::dot;
use crate::fit::points::FitRows;
use lsdc_kernels::schedule::join;

/// The fits at every pixel of the field.
pub(super) struct Stack {
    /// The field of the joint fit, without its basis functions.
    pub(super) joint: Vec<f64>,
    /// The field alone.
    pub(super) field: Vec<f64>,
    /// Share of the median in the map, from 0 (the joint fit) to 1.
    pub(super) share: f64,
}

/// Residuals of the points, for the map and for the field alone.
#[derive(Debug)]
pub(super) struct StackedResiduals {
    pub(super) map: Vec<f64>,
    pub(super) field: Vec<f64>,
    pub(super) share: f64,
}

/// The share if there are too many observations to predict them one by one. For shares from 0 to 1, the errors with 2,000 and
/// 5,000 random points change by less than 0.3 % indoors, and decrease outdoors; with 16 rows of points they increase by 1.5 %
/// indoors.
const OF_MANY: f64 = 1.0;

/// The prior share, with the weight of this many observations.
const ASSUMED: f64 = 0.0;
const WEIGHT: f64 = 10.0;

impl Stack {
    /// The map, without the basis functions, whose values at every pixel are `functions`. `surface` has the depth of the
    /// surface and the share of [`Self::share`] that applies there; outside of it, the map is the joint fit.
    fn map(
        &self,
        functions: &[f32],
        surface: impl Iterator<Item = Option<(f64, f64)>>,
    ) -> Vec<f64> {
        let fits = self.joint.iter().zip(&self.field);
        let pixels = fits.zip(functions).zip(surface);
        pixels
            .map(|(((joint, field), functions), surface)| {
                let Some((surface, narrow)) = surface else {
                    return *joint;
                };
                let others = [*field, surface].map(|depth| depth - f64::from(*functions));
                joint + self.share * narrow * (median(*joint, others) - joint)
            })
            .collect()
    }
}

/// Returns the combination of the columns that is the residual: the last column, of depths, minus the weighted sum of the
/// others.
pub(super) fn residual_combination(weights: &[f64]) -> Vec<f64> {
    let negated = weights.iter().map(|weight| -weight);
    negated.chain([1.0]).collect()
}

/// Returns the map for few observations.
pub(super) fn stack_few(
    surface: &Surface,
    (merged, rows): (&MergedObservations, &FitRows<'_>),
    (found, field): (&WeightEstimate, &CovarianceSolver),
    smoothness: &Smoothness,
) -> (Vec<f64>, Stack) {
    let weights = &found.solution.weights;
    let grid = smoothness.grid();
    let (functions, held_out) = join(
        || basis_map(rows, weights, smoothness),
        || HeldOutObservations::new(merged, field),
    );
    let residual = residual_combination(weights);
    let mut only_depth = vec![0.0; residual.len()];
    only_depth[weights.len()] = 1.0;
    let right_sides = surface.right_sides(&grid, &functions);
    let fits = field.extend_all([&residual, &only_depth], right_sides);
    let [joint, field] = unzipped(&fits);
    let share = held_out.share(found, [&joint, &field]);
    let stack = Stack {
        joint,
        field,
        share,
    };
    (stack.map(&functions, surface.inside()), stack)
}

/// Returns the map for many observations, with targets from which the weighted basis functions are subtracted.
pub(super) fn stack_many(
    surface: &Surface,
    (merged, rows): (&MergedObservations, &FitRows<'_>),
    targets: &[f64],
    field: &PrecisionSolver,
    (weights, smoothness): (&[f64], &Smoothness),
) -> (Vec<f64>, Stack) {
    let grid = smoothness.grid();
    let functions = basis_map(rows, weights, smoothness);
    let targets = targets.iter().zip(&merged.depths);
    let targets: Vec<[f64; 2]> = targets.map(|(&rest, &depth)| [rest, depth]).collect();
    let fits = field.extend_with(&targets, surface.right_sides(&grid, &functions));
    let [joint, field] = unzipped(&fits);
    let stack = Stack {
        joint,
        field,
        share: OF_MANY,
    };
    let size = smoothness.affinities.size();
    (stack.map(&functions, surface.up_to_outline(size)), stack)
}

/// Returns the weighted sum of basis functions at every pixel. Observations span a surface only if the functions are known
/// there.
fn basis_map(rows: &FitRows<'_>, weights: &[f64], smoothness: &Smoothness) -> Vec<f32> {
    let functions = rows.everywhere();
    let size = smoothness.affinities.size();
    functions.map_or_else(Vec::new, |functions| functions.map(size, weights))
}

fn unzipped(fits: &[[f64; 2]]) -> [Vec<f64>; 2] {
    [0, 1].map(|i| fits.iter().map(|fit| fit[i]).collect())
}

fn median(value: f64, [one, other]: [f64; 2]) -> f64 {
    // Not `clamp`, which would panic at NaN.
    value.max(one.min(other)).min(one.max(other))
}

/// The leave-one-out errors of the joint fit and of the median at an observation: from those of the joint fit and of the
/// field alone for a given surface, and the surface of the other observations.
pub(super) fn errors(depth: f64, given: [f64; 2], others: LeftOut) -> [f64; 2] {
    let surface = depth - others.depth;
    let [joint, field] = given.map(|error| error + others.confidence * (surface - error));
    [joint, median(joint, [field, surface])]
}

/// Observations that are predicted by the others, to compare the fits.
struct HeldOutObservations<'a> {
    merged: &'a MergedObservations,
    indices: Vec<usize>,
    /// Leverages of these observations in the field alone.
    leverages: Vec<f64>,
    /// The surface of the other observations at each observation.
    others: Vec<Option<LeftOut>>,
}

impl<'a> HeldOutObservations<'a> {
    /// At most this many, evenly spread over the observations.
    const MOST: usize = 200;

    fn new(merged: &'a MergedObservations, field: &CovarianceSolver) -> Self {
        let step = merged.len().div_ceil(Self::MOST);
        let indices: Vec<usize> = (0..merged.len()).step_by(step).collect();
        let (variances, others) = join(
            || field.variances_of(&indices),
            || left_out(&merged.places, &merged.depths, &merged.firmness()),
        );
        let pairs = indices.iter().zip(variances);
        let leverages =
            pairs.map(|(&observation, variance)| merged.weights[observation] * variance);
        Self {
            merged,
            leverages: leverages.collect(),
            indices,
            others,
        }
    }

    /// Returns the share of the median in the map, given the fields of the joint fit and alone at every pixel.
    fn share(&self, found: &WeightEstimate, [joint, field]: [&[f64]; 2]) -> f64 {
        let (sample, weights) = (&found.sample, &found.solution.weights);
        let columns = sample.columns();
        let free = |leverage: f64| (1.0 - leverage).max(least_freedom(true));
        // The mean of all observations, as in generalised cross-validation.
        let of_weights = free(found.determined / self.merged.len() as f64);
        let held_out = self.indices.iter().zip(&self.leverages);
        share(held_out.filter_map(|(&observation, leverage)| {
            let depth = self.merged.depths[observation];
            let functions = dot(
                &sample.rows[observation * (columns + 1)..][..columns],
                weights,
            );
            let interpolation = &self.merged.interpolation[observation];
            let left = free(*leverage);
            let joint = (depth - functions - interpolation.read(joint)) / (left * of_weights);
            let field = (depth - interpolation.read(field)) / left;
            Some(errors(depth, [joint, field], self.others[observation]?))
        }))
    }
}

/// Returns the share that minimises the absolute errors of observations, from the leave-one-out errors of the joint fit and of
/// the median.
fn share(errors: impl Iterator<Item = [f64; 2]>) -> f64 {
    let steps = errors.map(|[joint, median]| (joint, joint - median));
    let mut ratios: Vec<(f64, f64)> = steps
        .map(|(joint, step)| (joint / step, step.abs()))
        .filter(|(ratio, weight)| ratio.is_finite() && weight.is_finite())
        .collect();
    let total: f64 = ratios.iter().map(|(_, weight)| weight).sum();
    if total == 0.0 {
        return ASSUMED;
    }
    ratios.push((ASSUMED, WEIGHT * total / ratios.len() as f64));
    ratios.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * ratios.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    let middle = ratios.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    middle.map_or(ASSUMED, |(ratio, _)| ratio.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;

    #[test]
    fn the_share_has_the_smallest_sum_of_absolute_errors() {
        let mut rng = Rng::stream(4, &["stacking"]);
        let mut between = 0;
        for round in 0..50 {
            let truth = f64::from(round % 11) / 10.0;
            let error = |_| {
                let step = f64::from(rng.normal());
                let joint = truth * step + 0.3 * f64::from(rng.normal());
                [joint, joint - step]
            };
            let errors: Vec<[f64; 2]> = (0..60).map(error).collect();
            let mean = errors
                .iter()
                .map(|[joint, median]| (joint - median).abs())
                .sum::<f64>()
                / 60.0;
            let sum = |share: f64| -> f64 {
                let errors = errors.iter();
                let all = errors.map(|[joint, median]| (joint + share * (median - joint)).abs());
                all.sum::<f64>() + WEIGHT * mean * (share - ASSUMED).abs()
            };
            let found = share(errors.iter().copied());
            let least = (0..=1000)
                .map(|i| sum(f64::from(i) / 1000.0))
                .fold(f64::INFINITY, f64::min);
            assert!(
                (0.0..=1.0).contains(&found) && sum(found) <= least + 1e-12,
                "{found}"
            );
            between += usize::from(found > 0.01 && found < 0.99);
        }
        assert!(between > 25, "{between}");
    }

    #[test]
    fn without_evidence_the_joint_fit_is_the_map() {
        assert_eq!(share([].into_iter()), ASSUMED);
        // Where all agree, and where depths are not finite.
        assert_eq!(share([[0.5, 0.5]; 9].into_iter()), ASSUMED);
        assert_eq!(
            share([[f64::NAN, 1.0], [f64::INFINITY, 0.0]].into_iter()),
            ASSUMED
        );
        // One observation is no evidence, many are.
        assert_eq!(share([[1.0, 0.0]; 3].into_iter()), 0.0);
        assert_eq!(share([[1.0, 0.0]; 30].into_iter()), 1.0);
        assert_eq!(share([[0.0, 1.0]; 30].into_iter()), 0.0);
    }

    #[test]
    fn the_map_lies_between_the_joint_fit_and_the_median() {
        let stack = Stack {
            joint: vec![1.0, 3.0, 1.5, 5.0],
            field: vec![2.5, 2.5, 4.5, 4.5],
            share: 0.5,
        };
        // With functions of 1, the joint fit has the depths 2, 4, 2.5 and 6.
        let surface = [(3.0, 1.0), (3.0, 1.0), (3.0, 0.5), (9.0, 1.0)].map(Some);
        let found = stack.map(&[1.0; 4], surface.into_iter());
        // The medians are 2.5, 3, 3 and 6.
        assert_eq!(found, [1.25, 2.5, 1.625, 5.0]);
        // No change if the points span no surface.
        let found = stack.map(&[1.0; 4], [None; 4].into_iter());
        assert_eq!(found, stack.joint);
    }
}
