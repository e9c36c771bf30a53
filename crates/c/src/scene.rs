//! Scenes: the output of the network for an image, ready to be fitted to points.

use crate::completer::{COMPLETERS, lsdc_completer};
use crate::completion::{COMPLETIONS, StoredCompletion, lsdc_completion};
use crate::error::{Error, Result, guard};
use crate::handles::Handles;
use crate::input::{
    LSDC_GUIDE_NONE, MapValues, Pixels, lsdc_guide_kind, lsdc_image, lsdc_map, lsdc_points,
    observations, unused,
};
use crate::memory::{self, Versioned};
use crate::network_output::{lsdc_network_output, network_output};
use crate::pool::Pooled;
use crate::status::lsdc_status;
use lsdc_core::{Observations, Scene};

/// Everything that depends only on an image: the network has run, and each set of points needs only a fit.
pub struct lsdc_scene {
    _opaque: [u8; 0],
}

pub(crate) static SCENES: Handles<lsdc_scene, Pooled<Scene>> = Handles::new("scene");

/// Settings of a scene; zeros are the defaults. Set `struct_size` to `sizeof(lsdc_scene_options)`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct lsdc_scene_options {
    /// `sizeof(lsdc_scene_options)`.
    pub struct_size: usize,
    /// A dense depth prediction for the image from another source, of any size, or null. Unit, scale and shift need
    /// not be known; NaN marks gaps. Null means the prediction of the depth head of "anything", if it is installed.
    pub guide: *const lsdc_map,
    /// Quantity of the guide's values.
    pub guide_kind: lsdc_guide_kind,
    /// 0.
    pub reserved: u32,
    /// The output of the network for this image, computed by another program, or null to run the network. Any size is
    /// possible; a fit with a field is solved at this size. Functions are interpolated at points between its pixels.
    pub output: *const lsdc_network_output,
}

// SAFETY: it is `repr(C)`, begins with its size, and consists of numbers and a pointer, which may be 0.
unsafe impl Versioned for lsdc_scene_options {
    const LEAST: usize = size_of::<usize>();
}

/// Settings of a completion; zeros are the defaults. Set `struct_size` to `sizeof(lsdc_complete_options)`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct lsdc_complete_options {
    /// `sizeof(lsdc_complete_options)`.
    pub struct_size: usize,
    /// The completion of the previous frame of a video, which regularises this one, or null. Both must come from
    /// completers with the same weights and fit.
    pub previous: *const lsdc_completion,
}

// SAFETY: as above.
unsafe impl Versioned for lsdc_complete_options {
    const LEAST: usize = size_of::<usize>();
}

/// Runs the network on an image. The buffer is not needed afterwards. `options` may be null. `*scene` becomes
/// a handle to be freed with `lsdc_scene_free`, or null if the call fails.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_scene_create(
    completer: *const lsdc_completer,
    image: *const lsdc_image,
    options: *const lsdc_scene_options,
    scene: *mut *mut lsdc_scene,
) -> lsdc_status {
    guard(|| {
        // SAFETY: the caller's promise.
        unsafe { memory::put(scene, std::ptr::null_mut(), "scene") }?;
        let completer = COMPLETERS.get(completer)?;
        // SAFETY: the caller's promise.
        let (pixels, options) =
            unsafe { (Pixels::read(image)?, memory::optional(options, "options")?) };
        unused(options.reserved, "options")?;
        // SAFETY: the caller's promise.
        let guide = |guide| unsafe { MapValues::read(guide, "options->guide") };
        let guide = memory::unless_null(options.guide, guide)?;
        let guide = guide
            .map(|guide| guide.guide(options.guide_kind))
            .transpose()?;
        // SAFETY: the caller's promise.
        let output = |output| unsafe { network_output(output) };
        let output = memory::unless_null(options.output, output)?;
        let value = completer.run(|completer| {
            let image = pixels.image()?;
            Ok(match (&output, &guide) {
                (Some(output), guide) => {
                    let scene = completer.scene_with_output(&image, output)?;
                    scene.with_guide(guide.as_ref())
                }
                (None, Some(guide)) => completer.guided_scene(&image, guide)?,
                (None, None) if options.guide_kind == LSDC_GUIDE_NONE => {
                    completer.without_depth_head().scene(&image)?
                }
                (None, None) => completer.scene(&image)?,
            })
        })?;
        let pool = completer.pool;
        // SAFETY: the caller's promise.
        unsafe { memory::put(scene, SCENES.add(Pooled { value, pool }), "scene") }
    })
}

/// Writes the size of the image of a scene.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_scene_size(
    scene: *const lsdc_scene,
    width: *mut usize,
    height: *mut usize,
) -> lsdc_status {
    guard(|| {
        let scene = SCENES.get(scene)?.value;
        if height.is_null() {
            return Err(Error::null("height"));
        }
        // SAFETY: the caller's promise.
        unsafe {
            memory::put(width, scene.width(), "width")?;
            memory::put(height, scene.height(), "height")
        }
    })
}

/// Fits the scene to points, which are not needed afterwards. Points outside the image, and points whose depth
/// is not from 1e-15 to 1e15, are left out and counted in the report. `options` may be null.
/// `*completion` becomes a handle to be freed with `lsdc_completion_free`, or null if the call fails.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_scene_complete(
    scene: *const lsdc_scene,
    points: *const lsdc_points,
    options: *const lsdc_complete_options,
    completion: *mut *mut lsdc_completion,
) -> lsdc_status {
    // SAFETY: the caller's promise.
    let points = |_: &Scene| unsafe { observations(points) };
    // SAFETY: the caller's promise.
    guard(|| unsafe { complete(scene, points, options, completion) })
}

/// Fits the scene to a map of the size of its image, where 0 means no measurement. NaN, infinite and negative
/// values, and 65535 in 16 bits if no other value is near it, are left out and counted in the report as invalid. The
/// points are the pixels that are not 0, row by row. `sigma` is a map of the standard deviations of the depths, or
/// null; values that are not positive and finite mean unknown. Otherwise as `lsdc_scene_complete`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_scene_complete_map(
    scene: *const lsdc_scene,
    depth: *const lsdc_map,
    sigma: *const lsdc_map,
    options: *const lsdc_complete_options,
    completion: *mut *mut lsdc_completion,
) -> lsdc_status {
    let points = |scene: &Scene| {
        // SAFETY: the caller's promise.
        let depth = unsafe { MapValues::read(depth, "depth") }?;
        // SAFETY: the caller's promise.
        let sigma = memory::unless_null(sigma, |sigma| unsafe { MapValues::read(sigma, "sigma") })?;
        depth.observations(sigma, (scene.width(), scene.height()))
    };
    // SAFETY: the caller's promise.
    guard(|| unsafe { complete(scene, points, options, completion) })
}

/// Frees a scene; null is ignored. Its completions, and calls in progress, are not affected. A handle that was
/// freed before gives `LSDC_ERROR_HANDLE`.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_scene_free(scene: *mut lsdc_scene) -> lsdc_status {
    guard(|| SCENES.free(scene))
}

/// # Safety
/// The pointers are null or lead to what they say.
unsafe fn complete(
    scene: *const lsdc_scene,
    points: impl FnOnce(&Scene) -> Result<Observations>,
    options: *const lsdc_complete_options,
    completion: *mut *mut lsdc_completion,
) -> Result<()> {
    // SAFETY: the caller's promise.
    unsafe { memory::put(completion, std::ptr::null_mut(), "completion") }?;
    let scene = SCENES.get(scene)?;
    // SAFETY: the caller's promise.
    let options = unsafe { memory::optional(options, "options") }?;
    let previous = memory::unless_null(options.previous, |previous| COMPLETIONS.get(previous))?;
    let previous = previous.map(|previous| previous.value.completion);
    let points = points(&scene.value)?;
    let found = scene.run(|scene| {
        Ok(match &previous {
            None => scene.complete(&points)?,
            Some(previous) => scene.complete_near(&points, previous.weights())?,
        })
    })?;
    let value = StoredCompletion {
        completion: found,
        points: points.into(),
    };
    let pool = scene.pool;
    // SAFETY: the caller's promise.
    unsafe {
        memory::put(
            completion,
            COMPLETIONS.add(Pooled { value, pool }),
            "completion",
        )
    }
}
