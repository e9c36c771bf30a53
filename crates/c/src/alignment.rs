//! Alignment of points with images.

use crate::error::{Result, guard};
use crate::handles::Handles;
use crate::input::{lsdc_points, observations};
use crate::memory::{self, Versioned};
use crate::scene::{SCENES, lsdc_scene};
use crate::status::lsdc_status;
use lsdc_core::Alignment;

/// Evidence from one or more frames of a shift between points and images, caused by wrong extrinsics or time stamps.
pub struct lsdc_alignment {
    _opaque: [u8; 0],
}

static ALIGNMENTS: Handles<lsdc_alignment, Alignment> = Handles::new("alignment");

/// The shift at which the points fit the images best. Set `struct_size` to `sizeof(lsdc_shift)`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct lsdc_shift {
    /// `sizeof(lsdc_shift)`.
    pub struct_size: usize,
    /// To the right, in pixels of the image; NaN without evidence.
    pub x: f64,
    /// Down, in pixels of the image; NaN without evidence.
    pub y: f64,
    /// Mean leave-one-out error of the unshifted points, relative to their depth; NaN without evidence.
    pub error: f64,
    /// The same error of the shifted points.
    pub error_moved: f64,
    /// Gain in log-likelihood, divided by its standard error; 0 without evidence.
    pub standard_errors: f64,
    /// Number of points compared in all frames.
    pub points: usize,
    /// Number of frames with evidence.
    pub frames: usize,
    /// 1 if chance does not explain the shift: the gain is 6 standard errors in five frames or more, 9 in fewer, and the
    /// shift lowers the error by 5 %. Check extrinsics and time stamps then. Otherwise 0.
    pub is_clear: u32,
    /// 0.
    pub reserved: u32,
}

// SAFETY: it is `repr(C)`, begins with its size, and consists of numbers.
unsafe impl Versioned for lsdc_shift {
    const LEAST: usize = size_of::<usize>();
}

/// Tests whether points are aligned with the image of a scene: predicts at most 2000 of them from each other, unshifted
/// and with 40 shifts of up to a twentieth of the width of the image. It takes as long as about 41 fits. One image is
/// rarely enough: pool the first five to ten frames of a recording by passing the alignment so far as `before`, which
/// may be null. Fewer than 100 points away from the border give no evidence, but no error. `*alignment` becomes a
/// handle to be freed with `lsdc_alignment_free`, or null if the call fails.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_scene_alignment(
    scene: *const lsdc_scene,
    points: *const lsdc_points,
    before: *const lsdc_alignment,
    alignment: *mut *mut lsdc_alignment,
) -> lsdc_status {
    guard(|| {
        // SAFETY: the caller's promise.
        unsafe { memory::put(alignment, std::ptr::null_mut(), "alignment") }?;
        let scene = SCENES.get(scene)?;
        let before = memory::unless_null(before, |before| ALIGNMENTS.get(before))?;
        // SAFETY: the caller's promise.
        let points = unsafe { observations(points) }?;
        let mut found = scene.run(|scene| Ok(scene.alignment(&points)?))?;
        if let Some(before) = before {
            found.add(&before);
        }
        // SAFETY: the caller's promise.
        unsafe { memory::put(alignment, ALIGNMENTS.add(found), "alignment") }
    })
}

/// Writes the best shift, whether it is clear or not.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_alignment_shift(
    alignment: *const lsdc_alignment,
    shift: *mut lsdc_shift,
) -> lsdc_status {
    guard(|| {
        let found = shift_of(&ALIGNMENTS.get(alignment)?);
        // SAFETY: the caller's promise.
        unsafe { memory::fill(shift, &found, "shift") }
    })
}

/// Frees an alignment; null is ignored. A handle that was freed before gives `LSDC_ERROR_HANDLE`.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_alignment_free(alignment: *mut lsdc_alignment) -> lsdc_status {
    guard(|| -> Result<()> { ALIGNMENTS.free(alignment) })
}

fn shift_of(alignment: &Alignment) -> lsdc_shift {
    let found = alignment.shift();
    let or_nan = |value: fn(&lsdc_core::Shift) -> f64| found.as_ref().map_or(f64::NAN, value);
    lsdc_shift {
        struct_size: size_of::<lsdc_shift>(),
        x: or_nan(|shift| shift.u),
        y: or_nan(|shift| shift.v),
        error: or_nan(|shift| shift.error),
        error_moved: or_nan(|shift| shift.error_moved),
        standard_errors: found.map_or(0.0, |shift| shift.standard_errors),
        points: alignment.points(),
        frames: found.map_or(0, |shift| shift.frames),
        is_clear: found.map_or(0, |shift| shift.is_clear().into()),
        reserved: 0,
    }
}
