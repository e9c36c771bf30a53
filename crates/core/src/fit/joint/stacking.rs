//! The joint fit beside two other interpolations of the same sites: the field alone, which knows no basis functions, and
//! the surface that the sites span, which knows no image.
//!
//! Where the network knows the place, the joint fit is the best of the three; where it does not, or across an edge that
//! the image does not show, the others may be. At a pixel, the depth with the smallest sum of distances to all three is
//! their median m. The map is `z + s (m - z)`, z being the joint fit and s from 0 to 1. With few sites, s minimises the
//! absolute errors of the sites, each predicted by all three without it (stacking: Wolpert 1992, Breiman 1996):
//!
//! > sum over sites |d - z' - s (m' - z')|
//!
//! whose minimum is a weighted median of the ratios of `d - z'` to `m' - z'`. Sites judge gaps as wide as those around
//! themselves: in wider ones s is smaller, and outside of what the sites span the map is the joint fit. With many sites,
//! none of which judge, the map is the median inside.

use super::merged_observations::MergedObservations;
use super::smoothness::Smoothness;
use super::surface::{LeftOut, Surface, left_out};
use super::weighed::Weighed;
use crate::field::{CovarianceSolver, PrecisionSolver};
use crate::fit::leave_one_out::least_freedom;
use crate::fit::lstsq::dot;
use crate::fit::points::Rows;
use lsdc_kernels::schedule::join;

/// The fits at every pixel of the field.
pub(super) struct Stack {
    /// The joint fit, less what basis functions say.
    pub(super) joint: Vec<f64>,
    /// The field alone.
    pub(super) alone: Vec<f64>,
    /// How far the map goes from the joint fit to the median.
    pub(super) share: f64,
}

/// What a stack leaves of the points.
#[derive(Debug)]
pub(super) struct Stacked {
    /// Depth less the map, and less the field alone.
    pub(super) map: Vec<f64>,
    pub(super) alone: Vec<f64>,
    pub(super) share: f64,
}

/// The share of more sites than are judged one by one. From 0 to 1, the errors with 2,000 and 5,000 points at random
/// change by less than 0.3 % indoors, and fall outdoors; with 16 rows of points they rise by 1.5 % indoors.
const OF_MANY: f64 = 1.0;

/// The share that is assumed, with the weight of so many sites.
const ASSUMED: f64 = 0.0;
const WEIGHT: f64 = 10.0;

impl Stack {
    /// The map, less what basis functions say, which is given at every pixel beside the depth of the surface and how far
    /// the share holds there. Outside of the surface it is the joint fit.
    fn map(
        &self,
        functions: &[f32],
        surface: impl Iterator<Item = Option<(f64, f64)>>,
    ) -> Vec<f64> {
        let fits = self.joint.iter().zip(&self.alone);
        let pixels = fits.zip(functions).zip(surface);
        pixels
            .map(|(((joint, alone), functions), surface)| {
                let Some((surface, holds)) = surface else {
                    return *joint;
                };
                let others = [*alone, surface].map(|depth| depth - f64::from(*functions));
                joint + self.share * holds * (median(*joint, others) - joint)
            })
            .collect()
    }
}

/// The last column, of depths, less the others times their weights.
pub(super) fn rest_of(weights: &[f64]) -> Vec<f64> {
    let less = weights.iter().map(|weight| -weight);
    less.chain([1.0]).collect()
}

/// The map of few sites.
pub(super) fn stack_few(
    surface: &Surface,
    (sites, rows): (&MergedObservations, &Rows<'_>),
    found: &Weighed,
    smoothness: &Smoothness,
) -> (Vec<f64>, Stack) {
    let (field, weights) = (&found.field, &found.solution.weights);
    let grid = smoothness.affinities.grid(smoothness.level);
    let (functions, judges) = join(
        || rows.map(smoothness.affinities.size(), weights),
        || Judges::new(sites, field),
    );
    // Sites span a surface only if functions are known at every pixel.
    let functions = functions.unwrap_or_default();
    let rest = rest_of(weights);
    let mut only_depth = vec![0.0; rest.len()];
    only_depth[weights.len()] = 1.0;
    let right = surface.pulls(&grid, &functions);
    let [joint, alone] = apart(&field.extend_all([&rest, &only_depth], right));
    let share = judges.share(found, [&joint, &alone]);
    let stack = Stack {
        joint,
        alone,
        share,
    };
    (stack.map(&functions, surface.inside()), stack)
}

/// The map of many sites, for targets less what basis functions with these weights say.
pub(super) fn stack_many(
    surface: &Surface,
    (sites, rows): (&MergedObservations, &Rows<'_>),
    targets: &[f64],
    field: &PrecisionSolver,
    (weights, smoothness): (&[f64], &Smoothness),
) -> (Vec<f64>, Stack) {
    let grid = smoothness.affinities.grid(smoothness.level);
    let map = rows.map(smoothness.affinities.size(), weights);
    let functions = map.unwrap_or_default();
    let targets = targets.iter().zip(&sites.depths);
    let targets: Vec<[f64; 2]> = targets.map(|(&less, &depth)| [less, depth]).collect();
    let fits = field.extend_all_with(&targets, surface.pulls(&grid, &functions));
    let [joint, alone] = apart(&fits);
    let stack = Stack {
        joint,
        alone,
        share: OF_MANY,
    };
    let inside = surface.inside();
    let everywhere = inside.map(|found| found.map(|(depth, _)| (depth, 1.0)));
    (stack.map(&functions, everywhere), stack)
}

fn apart(fits: &[[f64; 2]]) -> [Vec<f64>; 2] {
    [0, 1].map(|i| fits.iter().map(|fit| fit[i]).collect())
}

fn median(value: f64, [one, other]: [f64; 2]) -> f64 {
    // Not `clamp`, which would panic at NaN.
    value.max(one.min(other)).min(one.max(other))
}

/// The leave-one-out errors of the joint fit and of the median at a site: from those of the joint fit and of the field alone
/// for a given surface, and what the surface of the other sites says.
pub(super) fn errors(depth: f64, given: [f64; 2], others: LeftOut) -> [f64; 2] {
    let surface = depth - others.depth;
    let [joint, alone] = given.map(|error| error + others.trust * (surface - error));
    [joint, median(joint, [alone, surface])]
}

/// Sites that are predicted by the others, to learn which fit to believe.
struct Judges<'a> {
    sites: &'a MergedObservations,
    which: Vec<usize>,
    /// The leverages of these in the field alone.
    leverages: Vec<f64>,
    /// What the surface of the other sites says of all sites.
    others: Vec<Option<LeftOut>>,
}

impl<'a> Judges<'a> {
    /// At most so many, evenly spread over the sites.
    const MOST: usize = 200;

    fn new(sites: &'a MergedObservations, field: &CovarianceSolver) -> Self {
        let step = sites.len().div_ceil(Self::MOST);
        let which: Vec<usize> = (0..sites.len()).step_by(step).collect();
        let (variances, others) = join(
            || field.variances_of(&which),
            || left_out(&sites.places, &sites.depths, &sites.firmness()),
        );
        let pairs = which.iter().zip(variances);
        let leverages = pairs.map(|(&site, variance)| sites.weights[site] * variance);
        Self {
            sites,
            leverages: leverages.collect(),
            which,
            others,
        }
    }

    /// The share of the median in the map, for the fields of the joint fit and alone at every pixel.
    fn share(&self, found: &Weighed, [joint, alone]: [&[f64]; 2]) -> f64 {
        let (sample, weights) = (&found.sample, &found.solution.weights);
        let columns = sample.columns();
        let free = |leverage: f64| (1.0 - leverage).max(least_freedom(true));
        // The mean of all sites, as in generalised cross-validation.
        let of_weights = free(found.determined / self.sites.len() as f64);
        let judged = self.which.iter().zip(&self.leverages);
        share(judged.filter_map(|(&site, leverage)| {
            let depth = self.sites.depths[site];
            let functions = dot(&sample.rows[site * (columns + 1)..][..columns], weights);
            let taps = &self.sites.taps[site];
            let left = free(*leverage);
            let joint = (depth - functions - taps.read(joint)) / (left * of_weights);
            let alone = (depth - taps.read(alone)) / left;
            Some(errors(depth, [joint, alone], self.others[site]?))
        }))
    }
}

/// The share that minimises the absolute errors of sites, from the leave-one-out errors of the joint fit and of the
/// median.
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
        // One site is no evidence, many are.
        assert_eq!(share([[1.0, 0.0]; 3].into_iter()), 0.0);
        assert_eq!(share([[1.0, 0.0]; 30].into_iter()), 1.0);
        assert_eq!(share([[0.0, 1.0]; 30].into_iter()), 0.0);
    }

    #[test]
    fn the_map_lies_between_the_joint_fit_and_the_median() {
        let stack = Stack {
            joint: vec![1.0, 3.0, 1.5, 5.0],
            alone: vec![2.5, 2.5, 4.5, 4.5],
            share: 0.5,
        };
        // With functions of 1, the joint fit has the depths 2, 4, 2.5 and 6.
        let surface = [(3.0, 1.0), (3.0, 1.0), (3.0, 0.5), (9.0, 1.0)].map(Some);
        let found = stack.map(&[1.0; 4], surface.into_iter());
        // The medians are 2.5, 3, 3 and 6.
        assert_eq!(found, [1.25, 2.5, 1.625, 5.0]);
        // Where the points span nothing, nothing judges.
        let found = stack.map(&[1.0; 4], [None; 4].into_iter());
        assert_eq!(found, stack.joint);
    }
}
