//! Observations against the true points.

use crate::camera::Sight;
use lsdc_eval::data::Sparse;

/// Tolerances of a position, in pixels, and of a depth, relative to it.
pub(crate) const PLACE: f64 = 0.01;
pub(crate) const DEPTH: f64 = 1e-5;

/// Returns which points, in the order of their file, were observed. Every observation must match the position and depth of a
/// point.
pub(crate) fn observed(sparse: &Sparse, truth: &[Sight]) -> Vec<bool> {
    let mut stayed = vec![false; truth.len()];
    let mut next = 0;
    for (i, found) in sparse.points.iter().enumerate() {
        let is = |truth: &Sight| {
            let off = (found.u - truth.place[0]).hypot(found.v - truth.place[1]);
            let depth = f64::from(found.depth) / truth.depth - 1.0;
            off < PLACE && depth.abs() < DEPTH
        };
        let Some(steps) = truth[next..].iter().position(is) else {
            let after = &truth[next..];
            panic!(
                "observation {i}, {found:?}, is none of {}: {:?}",
                after.len(),
                after.first()
            );
        };
        stayed[next + steps] = true;
        next += steps + 1;
    }
    stayed
}

/// Asserts that every point was observed.
pub(crate) fn assert_all(sparse: &Sparse, truth: &[Sight], what: &str) {
    let stayed = observed(sparse, truth);
    assert!(stayed.iter().all(|&stayed| stayed), "{what}: {sparse:?}");
    assert_eq!(
        (sparse.ignored, sparse.outside, sparse.hidden),
        (0, 0, 0),
        "{what}"
    );
}
