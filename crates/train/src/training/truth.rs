//! Points of a frame, and the true depths to compare its completion with.

use lsdc_eval::data::{DepthMap, Frame};
use lsdc_eval::sampling::{CompletionTask, Pattern};
use lsdc_files::error::Result;

/// Returns the points of a frame with the true depths. Of sparse depths, given ones are excluded from the truth.
///
/// # Errors
/// The points have another size than the frame.
pub(super) fn task(frame: &Frame, sparse: DepthMap) -> Result<CompletionTask> {
    let truth = if frame.is_sparse() {
        let pairs = frame.depth.values().iter().zip(sparse.values());
        let values = pairs.map(|(depth, given)| if *given > 0.0 { 0.0 } else { *depth });
        DepthMap::new(sparse.width(), sparse.height(), values.collect())?
    } else {
        frame.depth.clone()
    };
    Ok(CompletionTask { sparse, truth })
}

/// Returns the number of points to give when `number` are requested: at most half of sparse depths.
pub(super) fn limited(frame: &Frame, number: usize) -> usize {
    if frame.is_sparse() {
        number.min(frame.depth.count() / 2).max(1)
    } else {
        number
    }
}

/// Returns this many random points of a frame, or as many as [`limited`] allows, with the true depths.
///
/// # Errors
/// None for a frame with depths.
pub(super) fn random_task(frame: &Frame, number: usize, seed: u64) -> Result<CompletionTask> {
    let points = Pattern::Exactly(limited(frame, number));
    task(frame, points.draw(frame, seed)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;

    /// Returns a frame of 40x30 pixels in which each `step`-th pixel is measured.
    fn frame(step: usize) -> Frame {
        let values = (0..1200).map(|i| if i % step == 0 { 1.0 + i as f32 } else { 0.0 });
        let depth = DepthMap::new(40, 30, values.collect()).unwrap();
        Frame::new("a".into(), RgbImage::new(40, 30), depth).unwrap()
    }

    #[test]
    fn returns_are_given_or_true() {
        // 100 returns.
        let scan = frame(12);
        for (number, given) in [(5, 5), (50, 50), (500, 50)] {
            let task = random_task(&scan, number, 0).unwrap();
            assert_eq!(task.sparse.count(), given);
            assert_eq!(task.truth.count(), 100 - given);
            for (i, depth) in scan.depth.values().iter().enumerate() {
                assert_eq!(task.sparse.values()[i] + task.truth.values()[i], *depth);
            }
        }
    }

    #[test]
    fn all_of_a_dense_map_is_true() {
        let dense = frame(1);
        let task = random_task(&dense, 500, 3).unwrap();
        assert_eq!(task.truth, dense.depth);
        assert_eq!(task.sparse, Pattern::Exactly(500).draw(&dense, 3).unwrap());
    }
}
