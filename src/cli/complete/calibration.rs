//! Whether points lie where the images show them, in the first of several frames. One alone hardly ever tells.

use super::frame::Completed;
use super::inputs::Loaded;
use crate::cli::args::Complete;
use lsdc_core::{Alignment, Shift};

/// Frames that are checked, each in the time of some fits.
const FRAMES: usize = 5;

/// Pools the evidence for wrong extrinsics or time stamps until it is clear.
pub(super) struct Calibration {
    frames_left: usize,
    pooled: Option<Alignment>,
}

impl Calibration {
    pub(super) fn new(args: &Complete) -> Self {
        Self {
            frames_left: if args.no_alignment { 0 } else { FRAMES },
            pooled: None,
        }
    }

    /// Takes in the next frame, and returns the shift when it becomes clear. A check that fails is no failure of the frame.
    pub(super) fn add(&mut self, frame: &Loaded, found: &Completed) -> Option<Shift> {
        let fit = found
            .diagnostics
            .as_ref()
            .filter(|_| self.frames_left > 0)?;
        let alignment = fit
            .completion
            .scene()
            .alignment(&frame.points.points)
            .ok()?;
        if alignment.points() == 0 {
            return None;
        }
        self.frames_left -= 1;
        match &mut self.pooled {
            Some(pooled) => pooled.add(&alignment),
            none => *none = Some(alignment),
        }
        let shift = self.pooled.as_ref()?.shift()?;
        let clear = shift.is_clear().then_some(shift)?;
        self.frames_left = 0;
        Some(clear)
    }
}

/// What to do about a clear shift.
pub(super) fn warning(shift: &Shift) -> String {
    format!("{shift}; check extrinsics and time stamps (--no-alignment skips this check)")
}
