//! Whether points lie where the images show them, in the first of several frames. One alone hardly ever tells.

use super::frame::Completed;
use super::loaded::Loaded;
use super::recorded::Recorded;
use super::settings::Settings;
use lsdc_core::{Alignment, Comparison, Observations, Scene};
use lsdc_recordings::SyncedFrame;

/// Frames that are checked, each in the time of some fits.
const FRAMES: usize = 5;

/// Differences of clocks that are tried, in milliseconds.
const LATER: [i64; 8] = [-200, -100, -50, -20, 20, 50, 100, 200];

const SKIPPED: &str = "(--no-alignment skips this check)";

/// Points that move by less, in pixels, are no evidence for a stamp: a robot that stands still has none.
const MOVED: f64 = 2.0;

/// Pools the evidence for wrong extrinsics or time stamps until it is clear.
pub(super) struct Calibration {
    shifts: Check<Alignment>,
    stamps: Check<Comparison>,
}

/// The evidence so far, and of how many more frames it is taken: none once it is clear.
struct Check<T> {
    pooled: Option<T>,
    frames_left: usize,
}

impl Calibration {
    pub(super) fn new(settings: &Settings) -> Self {
        let frames = if settings.checks_alignment { FRAMES } else { 0 };
        Self {
            shifts: Check::new(frames),
            stamps: Check::new(frames),
        }
    }

    /// Takes in the next frame, of a recording or not, and returns what becomes clear. A check that fails is no failure of the
    /// frame.
    pub(super) fn add(
        &mut self,
        frame: &Loaded,
        found: &Completed,
        recorded: Option<(&Recorded, &SyncedFrame)>,
    ) -> Vec<String> {
        let Some(fit) = &found.diagnostics else {
            return Vec::new();
        };
        let scene = fit.completion.scene();
        let shift = self.shift(scene, &frame.points.points);
        let stamp = recorded.and_then(|recorded| self.stamp(scene, frame, recorded));
        shift.into_iter().chain(stamp).collect()
    }

    /// A shift in pixels with which the points fit the image clearly better.
    fn shift(&mut self, scene: &Scene, points: &Observations) -> Option<String> {
        if self.shifts.frames_left == 0 {
            return None;
        }
        let found = scene.alignment(points).ok()?;
        if found.points() == 0 {
            return None;
        }
        let shift = self.shifts.pool(found, Alignment::add).shift();
        let shift = shift.filter(lsdc_core::Shift::is_clear)?;
        self.shifts.frames_left = 0;
        Some(format!(
            "{shift}; check extrinsics and time stamps {SKIPPED}"
        ))
    }

    /// A stamp at which the points of a recording fit the image clearly better.
    fn stamp(
        &mut self,
        scene: &Scene,
        loaded: &Loaded,
        (recorded, frame): (&Recorded, &SyncedFrame),
    ) -> Option<String> {
        if self.stamps.frames_left == 0 {
            return None;
        }
        let seen = (&loaded.points.points, loaded.camera.as_ref()?);
        let later = LATER.map(|later| recorded.seen_after(frame, seen, later * 1_000_000));
        let others: Vec<Observations> = later.into_iter().collect::<Option<_>>()?;
        if !others.iter().any(|other| moves(seen.0, other)) {
            return None;
        }
        let found = scene.compare(seen.0, &others).ok()?;
        if found.points() == 0 {
            return None;
        }
        let pooled = self.stamps.pool(found, Comparison::add);
        let best = pooled.best().filter(lsdc_core::Alternative::is_clear)?;
        self.stamps.frames_left = 0;
        Some(format!(
            "the points fit the image better if it was taken {} ms {} than its stamp: their leave-one-out error falls from {:.1} to \
             {:.1} % of the depth; check time stamps {SKIPPED}",
            LATER[best.index].abs(),
            if LATER[best.index] > 0 {
                "later"
            } else {
                "earlier"
            },
            100.0 * best.error,
            100.0 * best.error_there,
        ))
    }
}

/// Whether half of the points move, or leave the view.
fn moves(points: &Observations, other: &Observations) -> bool {
    let pairs = points.iter().zip(other.iter());
    let stays = pairs.filter(|(a, b)| b.depth.is_finite() && (a.u - b.u).hypot(a.v - b.v) < MOVED);
    2 * stays.count() < points.len()
}

impl<T> Check<T> {
    fn new(frames_left: usize) -> Self {
        Self {
            pooled: None,
            frames_left,
        }
    }

    /// The evidence of another frame with that of those before.
    fn pool(&mut self, found: T, add: impl FnOnce(&mut T, &T)) -> &T {
        self.frames_left -= 1;
        match &mut self.pooled {
            Some(pooled) => {
                add(pooled, &found);
                pooled
            }
            none => none.insert(found),
        }
    }
}
