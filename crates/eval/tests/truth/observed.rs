//! Observations against where the points are.

use crate::camera::Sight;
use lsdc_eval::data::Sparse;

/// How far a place may be off, in pixels, and a depth, as a share of it.
pub(crate) const PLACE: f64 = 0.01;
pub(crate) const DEPTH: f64 = 1e-5;

/// Which of the points, in the order of their file, were observed. Every observation must be at the
/// place and depth of one of them.
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

/// That every point was observed.
pub(crate) fn assert_all(sparse: &Sparse, truth: &[Sight], what: &str) {
    let stayed = observed(sparse, truth);
    assert!(stayed.iter().all(|&stayed| stayed), "{what}: {sparse:?}");
    assert_eq!(
        (sparse.ignored, sparse.outside, sparse.hidden),
        (0, 0, 0),
        "{what}"
    );
}
