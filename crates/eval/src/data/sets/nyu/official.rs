//! The official split of the 1449 labelled frames (`splits.mat` of the dataset's page), numbered
//! from 1: 654 test frames, the others for training.

use std::sync::LazyLock;

/// Number of labelled frames.
pub(super) const FRAMES: usize = 1449;

static TEST: LazyLock<Vec<usize>> = LazyLock::new(|| {
    include_str!("test.txt")
        .lines()
        .filter_map(|line| line.parse().ok())
        .collect()
});

/// Returns whether the labelled frame with this number belongs to the test split.
pub(super) fn is_test(number: usize) -> bool {
    TEST.binary_search(&number).is_ok()
}

/// Returns the name of a labelled frame, as in `val/official` of the sparse-to-dense tree.
pub(super) fn name(number: usize) -> String {
    format!("{number:05}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_split_has_its_published_sizes() {
        assert_eq!(TEST.len(), 654);
        assert!(TEST.is_sorted_by(|a, b| a < b));
        assert_eq!((1..=FRAMES).filter(|&n| !is_test(n)).count(), 795);
        // The first and last rows of the published list.
        assert!(is_test(1) && is_test(2) && is_test(9) && is_test(1449) && !is_test(3));
    }
}
