//! The cameras of a recording: of its images, and of its images of depths.

use crate::message::{StampedCamera, Timestamp, camera_of};
use crate::rigid::Rigid;
use crate::series::TimeSeries;
use crate::transforms::Transforms;
use lsdc_files::Camera;
use lsdc_files::error::{Cause, Error};

/// The cameras that a topic describes, by time, each once.
#[derive(Clone, Debug, Default)]
pub(super) struct Cameras {
    /// Whether they are those of rectified images.
    rectified: bool,
    /// The frame of reference that the first of them names.
    pub(super) frame: Option<String>,
    series: TimeSeries<StampedCamera>,
    /// The last that was added.
    last: Option<StampedCamera>,
    /// Whether they are beside the origin of their frame by their baselines.
    is_beside: bool,
    /// How many messages describe none, and what is wrong with the first of them.
    pub(super) unusable: usize,
    first_error: Option<String>,
}

impl Cameras {
    pub(super) fn new(rectified: bool) -> Self {
        Self {
            rectified,
            ..Self::default()
        }
    }

    /// Adds the camera of a message. Returns whether it differs from the last one.
    pub(super) fn add(&mut self, message: &[u8]) -> bool {
        let found = match camera_of(message, self.rectified) {
            Ok(found) => found,
            Err(error) => {
                self.unusable += 1;
                self.first_error.get_or_insert_with(|| error.with_causes());
                return false;
            }
        };
        let same =
            |last: &StampedCamera| last.camera == found.camera && last.baseline == found.baseline;
        if self.last.as_ref().is_some_and(same) {
            return false;
        }
        self.frame.get_or_insert_with(|| found.header.frame.clone());
        self.last = Some(found.clone());
        self.series.insert(found.header.stamp, found);
        true
    }

    /// What is wrong with the first message that describes no camera.
    pub(super) fn first_error(&self) -> Option<Error> {
        let what = self.first_error.as_ref()?;
        Some(Error::new(Cause::Format, what))
    }

    /// Forgets all cameras but the last of a time. Those of a running robot change seldom.
    pub(super) fn keep_last(&mut self, most: usize) {
        self.series.keep_last(most);
    }

    /// Lets the last camera be valid at all times, for a clock that was set back.
    pub(super) fn forget_times(&mut self) {
        let last = self.last.clone().map(|last| (Timestamp::MIN, last));
        self.series = TimeSeries::new(last.into_iter().collect());
    }

    pub(super) fn is_empty(&self) -> bool {
        self.series.is_empty()
    }

    /// The message of the camera that was valid at a time.
    pub(super) fn message(&self, stamp: Timestamp) -> Option<&[u8]> {
        Some(&self.series.valid(stamp)?.message)
    }

    /// At its place in its frame, that which was valid at a time.
    pub(super) fn at(&self, stamp: Timestamp) -> Option<Camera> {
        let StampedCamera {
            camera, baseline, ..
        } = self.series.valid(stamp)?;
        Some(if self.is_beside {
            let [x, y] = *baseline;
            camera
                .clone()
                .with_pose(Rigid::IDENTITY.matrix(), [-x, -y, 0.0])
        } else {
            camera.clone()
        })
    }

    /// Places cameras of the topic that have a baseline: beside the origin of their frame, unless transforms place this
    /// frame beside another one already. Returns what is to be said about it.
    pub(super) fn apply_baseline(
        &mut self,
        topic: &str,
        frame: &str,
        stamp: Timestamp,
        tree: &Transforms,
    ) -> Option<String> {
        let baseline = self.series.valid(stamp)?.baseline;
        if baseline == [0.0; 2] {
            return None;
        }
        let first = first_of_pair(tree, frame, baseline, stamp);
        self.is_beside = first.is_none();
        let length = baseline[0].hypot(baseline[1]);
        let pair = format!(
            "the fourth column of P of `{topic}` is that of the second camera of a stereo pair with a baseline of {length:.4} m"
        );
        Some(match first {
            Some(first) => format!(
                "{pair}: transforms place its frame `{frame}` so far beside `{first}`, so that the camera is taken to be at the \
                 origin of `{frame}`"
            ),
            None => format!(
                "{pair}: its frame `{frame}` is taken for that of the first camera, and the camera is moved by the baseline; if \
                 `{frame}` is at the second camera already, give --camera FILE"
            ),
        })
    }
}

/// The frame that another one is beside by a baseline, if transforms say so.
fn first_of_pair(
    tree: &Transforms,
    frame: &str,
    [x, y]: [f64; 2],
    stamp: Timestamp,
) -> Option<String> {
    // Calibrations and drawings of a camera differ.
    let near = 0.1 * x.hypot(y) + 0.002;
    let is_beside = |other: &&str| {
        let route = tree.route(other, frame, None).ok()?;
        let moved = tree.between(&route, [stamp; 2]).ok()?;
        let [a, b, c] = moved.translation();
        let matrix = moved.matrix();
        let identity = Rigid::IDENTITY.matrix();
        let pairs = matrix.as_flattened().iter().zip(identity.as_flattened());
        let turned = pairs.map(|(v, one)| (v - one).abs()).fold(0.0, f64::max);
        let deviation = (a + x).hypot(b + y).hypot(c);
        (deviation <= near && turned < 0.02).then_some(())
    };
    let mut others = tree.frames().filter(|other| *other != frame);
    others
        .find(|other| is_beside(other).is_some())
        .map(str::to_owned)
}

/// How far apart a camera of depths and that of images see the same place, in pixels of the image: 0 where depths are
/// registered. The largest of a grid of pixels, a metre away, that both see; infinite if there is none.
pub(super) fn registration_error(depths: &Camera, images: &Camera) -> f64 {
    /// Pixels of the grid, across and down.
    const STEPS: usize = 9;
    let [.., cx, cy] = depths.intrinsics();
    let middle = [cx, cy].map(|centre| (2.0 * centre + 1.0).round().max(1.0) as usize);
    let (width, height) = depths
        .size()
        .or(images.size())
        .unwrap_or((middle[0], middle[1]));
    let (across, down) = images.size().unwrap_or((width, height));
    let at = |step: usize, length: usize| (length as f64 - 1.0) * step as f64 / (STEPS - 1) as f64;
    let scaled =
        |position: f64, from: usize, to: usize| (position + 0.5) * to as f64 / from as f64 - 0.5;
    let deviation = |row: usize, column: usize| {
        let [u, v] = [at(column, width), at(row, height)];
        let position = depths.unproject([u, v], 1.0)?;
        let ([x, y], _) = images.project(position)?;
        Some((x - scaled(u, width, across)).hypot(y - scaled(v, height, down)))
    };
    let all = (0..STEPS).flat_map(|row| (0..STEPS).map(move |column| (row, column)));
    let seen = all.filter_map(|(row, column)| deviation(row, column));
    seen.reduce(f64::max).unwrap_or(f64::INFINITY)
}
