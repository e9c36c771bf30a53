//! The cameras of a recording: of its colour images and of its depth images.

use crate::message::{StampedCamera, Timestamp, camera_of};
use crate::rigid::Rigid;
use crate::series::TimeSeries;
use crate::transforms::Transforms;
use lsdc_files::Camera;
use lsdc_files::error::{Cause, Error};

/// The distinct cameras that a topic describes, by time.
#[derive(Clone, Debug, Default)]
pub(super) struct Cameras {
    /// Whether the images are rectified.
    rectified: bool,
    /// Frame of reference of the first camera.
    pub(super) frame: Option<String>,
    series: TimeSeries<StampedCamera>,
    /// The last camera that was added.
    last: Option<StampedCamera>,
    /// Whether the cameras are offset from the origin of their frame by their baselines.
    is_beside: bool,
    /// Number of messages that describe no camera; below, the error of the first.
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

    /// Returns the error of the first message that describes no camera.
    pub(super) fn first_error(&self) -> Option<Error> {
        let what = self.first_error.as_ref()?;
        Some(Error::new(Cause::Format, what))
    }

    /// Drops all but the last `most` cameras. Those of a running robot change seldom.
    pub(super) fn keep_last(&mut self, most: usize) {
        self.series.keep_last(most);
    }

    /// Makes the last camera valid at all times, for a clock that was set back.
    pub(super) fn forget_times(&mut self) {
        let last = self.last.clone().map(|last| (Timestamp::MIN, last));
        self.series = TimeSeries::new(last.into_iter().collect());
    }

    pub(super) fn is_empty(&self) -> bool {
        self.series.is_empty()
    }

    /// Returns the message of the camera that was valid at a time.
    pub(super) fn message(&self, stamp: Timestamp) -> Option<&[u8]> {
        Some(&self.series.valid(stamp)?.message)
    }

    /// Returns the camera that was valid at a time, at its position in its frame.
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

    /// Offsets cameras with a baseline from the origin of their frame, unless the transforms already place this frame
    /// beside that of the first camera. Returns remarks about it.
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

/// Returns the frame of the first camera of a stereo pair: the one from which `frame` is offset by the baseline.
fn first_of_pair(
    tree: &Transforms,
    frame: &str,
    [x, y]: [f64; 2],
    stamp: Timestamp,
) -> Option<String> {
    // Calibration and mechanical drawings of a camera differ slightly.
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

/// Returns the registration error of a depth camera against the camera of the images, in pixels of the image: 0 if depths
/// are registered. It is the largest over a grid of pixels at a depth of 1 m that both cameras see; infinite if there are
/// none.
pub(super) fn registration_error(depths: &Camera, images: &Camera) -> f64 {
    /// Grid points across and down.
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
