//! The measured points of earlier images, which join those of each image.

use lsdc_core::{Completion, PosedView, Scene, ViewOutcome, ViewSettings, neighbours};
use lsdc_files::error::Result;
use lsdc_recordings::{CameraPose, NEIGHBOUR_WINDOW, Timestamp};
use std::collections::VecDeque;

/// Stamps that go back by more nanoseconds are those of a clock that was set back.
const JUMP: i64 = 1_000_000_000;

/// The last images with points of their own, and where their cameras were.
pub(crate) struct PastViews {
    settings: ViewSettings,
    /// The frame that motion is measured in.
    fixed: String,
    /// In the order of time. Of images with the same points, the one nearest to them in time: points are carried once.
    images: VecDeque<PastImage>,
}

/// An image whose camera is at its place in the frame that motion is measured in.
#[derive(Clone)]
pub(crate) struct PastImage {
    pub(crate) stamp: Timestamp,
    pub(crate) points_stamp: Timestamp,
    pub(crate) view: PosedView,
}

/// What became of the points of earlier images.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Carried {
    /// Points that joined the fit.
    pub(crate) points: usize,
    /// Earlier images that see the same, and those of them that contradict the image.
    pub(crate) considered: usize,
    pub(crate) inconsistent: usize,
}

impl PastImage {
    /// Images with the same points are chosen by their distance from these, then by time.
    fn rank(&self) -> (u64, Timestamp) {
        (self.stamp.abs_diff(self.points_stamp), self.stamp)
    }
}

impl PastViews {
    pub(crate) fn new(settings: ViewSettings) -> Self {
        Self {
            settings: ViewSettings {
                only_past: true,
                ..settings
            },
            fixed: String::new(),
            images: VecDeque::new(),
        }
    }

    /// Adds an image, and returns its neighbours among the earlier ones, the closest first.
    pub(crate) fn add(&mut self, own: &PastImage, pose: &CameraPose) -> Vec<PosedView> {
        let newest = self.images.back().map_or(own.stamp, |last| last.stamp);
        if self.fixed != pose.fixed || newest.saturating_sub(own.stamp) > JUMP {
            self.fixed.clone_from(&pose.fixed);
            self.images.clear();
        }
        let same = |other: &PastImage| other.points_stamp == own.points_stamp;
        let known = self.images.iter().position(same);
        if known.is_none_or(|known| own.rank() < self.images[known].rank()) {
            if let Some(known) = known {
                self.images.remove(known);
            }
            self.images.insert(self.place(own), own.clone());
        }
        let end = self.place(own);
        let start = end.saturating_sub(NEIGHBOUR_WINDOW);
        let before = self.images.range(start..end).filter(|other| !same(other));
        let mut views: Vec<PosedView> = before.map(|other| other.view.clone()).collect();
        let index = views.len();
        views.push(own.view.clone());
        // The next image needs as many before it, and may replace the last.
        let beyond = self.images.len().saturating_sub(NEIGHBOUR_WINDOW + 1);
        self.images.drain(..beyond);
        let found = neighbours(&views, index, &self.settings).into_iter();
        found.map(|other| views[other].clone()).collect()
    }

    /// Where an image is in the order of time.
    fn place(&self, own: &PastImage) -> usize {
        self.images.partition_point(|other| other.stamp < own.stamp)
    }

    /// Fits an image to its points and those of others.
    pub(crate) fn complete(
        &self,
        scene: &Scene,
        own: &PosedView,
        others: &[PosedView],
    ) -> Result<(Completion, Carried)> {
        let others: Vec<&PosedView> = others.iter().collect();
        let (completion, report) = scene.complete_with_views(own, &others, &self.settings)?;
        let carried = Carried {
            points: report.carried(),
            considered: report.views.len(),
            inconsistent: report.count(ViewOutcome::Inconsistent),
        };
        Ok((completion, carried))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_core::{Camera, Observation};
    use lsdc_recordings::Rigid;

    fn image(stamp: Timestamp, points_stamp: Timestamp) -> PastImage {
        let point = |i: usize| Observation {
            u: (i % 8) as f64,
            v: (i / 8) as f64,
            depth: 2.0,
            sigma: None,
        };
        let camera = Camera::pinhole([8.0, 8.0], [3.5, 3.5]);
        let points = (0..64).map(point).collect();
        PastImage {
            stamp,
            points_stamp,
            view: PosedView::new(camera, 8, 8, points).unwrap(),
        }
    }

    fn past(all: &[(Timestamp, Timestamp)]) -> (PastViews, Vec<usize>) {
        let settings = ViewSettings {
            count: 100,
            ..ViewSettings::default()
        };
        let mut past = PastViews::new(settings);
        let pose = CameraPose {
            fixed: "odom".to_owned(),
            rigid: Rigid::IDENTITY,
        };
        let counts = all.iter();
        let counts = counts.map(|&(stamp, points)| past.add(&image(stamp, points), &pose).len());
        let counts = counts.collect();
        (past, counts)
    }

    #[test]
    fn points_are_carried_once_by_the_image_nearest_to_them() {
        let (past, counts) = past(&[(10, 12), (11, 12), (13, 12), (20, 21), (25, 21)]);
        assert_eq!(counts, [0, 0, 0, 1, 1]);
        let kept: Vec<_> = past.images.iter().map(|image| image.stamp).collect();
        assert_eq!(kept, [11, 20]);
    }

    #[test]
    fn so_many_images_are_kept_as_recordings_look_at() {
        let all: Vec<_> = (0..30).map(|i| (i, i)).collect();
        let (past, counts) = past(&all);
        let wanted: Vec<_> = (0..30).map(|i| i.min(NEIGHBOUR_WINDOW)).collect();
        assert_eq!(counts, wanted);
        assert_eq!(past.images.len(), NEIGHBOUR_WINDOW + 1);
    }

    #[test]
    fn a_clock_that_is_set_back_or_another_frame_begins_anew() {
        let second = 1_000_000_000;
        let (mut past, counts) = past(&[(9 * second, 0), (10 * second, 1), (second, 2)]);
        assert_eq!(counts, [0, 1, 0]);
        let pose = CameraPose {
            fixed: "map".to_owned(),
            rigid: Rigid::IDENTITY,
        };
        assert!(past.add(&image(2 * second, 3), &pose).is_empty());
        assert_eq!(past.images.len(), 1);
    }
}
