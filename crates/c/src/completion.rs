//! Completions: depth, its errors, and results at the points.

use crate::completer::{fit_of, lsdc_fit};
use crate::error::{Error, Result, guard};
use crate::handles::Handles;
use crate::input::checked_size;
use crate::memory::{self, RowLayout, Versioned};
use crate::pool::Pooled;
use crate::status::lsdc_status;
use lsdc_core::{Completion, Observations, Outlier};
use std::sync::Arc;

/// A scene fitted to points. Results beyond the fit are computed on request.
pub struct lsdc_completion {
    _opaque: [u8; 0],
}

/// A completion, and the points to which it was fitted.
#[derive(Clone)]
pub(crate) struct StoredCompletion {
    pub(crate) completion: Completion,
    pub(crate) points: Arc<Observations>,
}

pub(crate) static COMPLETIONS: Handles<lsdc_completion, Pooled<StoredCompletion>> =
    Handles::new("completion");

/// Statistics of a fit. Set `struct_size` to `sizeof(lsdc_report)`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct lsdc_report {
    /// `sizeof(lsdc_report)`.
    pub struct_size: usize,
    /// Number of points given: `used + invalid + outside`.
    pub given: usize,
    /// Number of points fitted.
    pub used: usize,
    /// Points left out because their depth is not from 1e-15 to 1e15, or their position is not finite.
    pub invalid: usize,
    /// Points left out because they are outside the image.
    pub outside: usize,
    /// Points used without a positive and finite sigma, if others have one.
    pub without_deviation: usize,
    /// Number of directions that the points determine, at most `functions`.
    pub rank: usize,
    /// Number of basis functions of the network, including the constant.
    pub functions: usize,
    /// Root mean square of the residuals, in the unit of the points.
    pub residual: f64,
    /// The strength of the prior; NaN if there is none.
    pub lambda: f64,
    /// Trust in the guide, 0 if the points do not support it; NaN if there was none.
    pub guide_trust: f64,
    /// Lower limit of depths: a tenth of the smallest given depth. Below 0.7 times the smallest, the fitted depth is continued
    /// linearly in inverse depth.
    pub lowest: f64,
    /// Upper limit of depths: ten times the largest given depth.
    pub highest: f64,
    /// Run time of the network in seconds.
    pub network_seconds: f64,
    /// Run time of the fit in seconds, including `field_seconds` and `solve_seconds`.
    pub fit_seconds: f64,
    /// Run time of the preparation that only the first fit to an image needs, in seconds.
    pub field_seconds: f64,
    /// Run time of the solver in seconds.
    pub solve_seconds: f64,
    /// The model of depth: `LSDC_FIT_LSE`, `LSDC_FIT_FIELD` or `LSDC_FIT_JOINT`.
    pub fit: lsdc_fit,
    /// 0.
    pub reserved: u32,
    /// Share of the median in the map: 0 is the joint fit, 1 the median of this fit, of the field alone, and of the surface
    /// spanned by the points; NaN for other fits, and for points that span no surface.
    pub median_share: f64,
    /// Pixels that show sky without a point near, by the depth head of `anything`: their standard deviation is at least their
    /// depth, whose value means nothing.
    pub sky_pixels: usize,
}

// SAFETY: it is `repr(C)`, begins with its size, and consists of numbers.
unsafe impl Versioned for lsdc_report {
    const LEAST: usize = size_of::<usize>();
}

/// A point that is more likely an outlier than an inlier, judged by the other points.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct lsdc_outlier {
    /// Its index among the given points, from 0.
    pub index: usize,
    /// Its column.
    pub x: f64,
    /// Its row.
    pub y: f64,
    /// Its depth.
    pub depth: f64,
    /// Probability that it is an outlier, from 0.5 to 1.
    pub probability: f64,
    /// Its depth minus the prediction from the other points, over the scale of the errors of inliers there;
    /// positive if it is farther away.
    pub score: f64,
    /// Its depth minus the prediction from the other points.
    pub error: f64,
    /// Its weight in a robust fit.
    pub weight: f64,
}

/// Writes the dense depth, in the unit of the points, as `height` rows of `width` floats. Rows start `stride`
/// bytes apart; 0 means no gaps. `size` is the number of bytes from `depth` to the end of the buffer; bytes
/// between rows are unchanged. Any size is possible; the size of the image (`lsdc_scene_size`) gives a depth for
/// each of its pixels. If the call fails, the buffer is unchanged.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completion_depth(
    completion: *const lsdc_completion,
    width: usize,
    height: usize,
    depth: *mut f32,
    size: usize,
    stride: usize,
) -> lsdc_status {
    let map = |found: &Completion| found.depth_at(width, height);
    guard(|| {
        let (shape, buffer) = ([width, height], [size, stride]);
        // SAFETY: the caller's promise.
        unsafe { write_map(completion, map, shape, depth, buffer, "depth") }
    })
}

/// Writes the standard deviation of the depth error at every pixel, in the unit of the points: half the width
/// of the interval around the depth that contains 68.27 % of errors. Otherwise as `lsdc_completion_depth`.
/// Fails with `LSDC_ERROR_FIT` if there are too few points for an estimate.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completion_standard_deviation(
    completion: *const lsdc_completion,
    width: usize,
    height: usize,
    deviation: *mut f32,
    size: usize,
    stride: usize,
) -> lsdc_status {
    let map = |found: &Completion| found.standard_deviation_at(width, height);
    guard(|| {
        let (shape, buffer) = ([width, height], [size, stride]);
        // SAFETY: the caller's promise.
        unsafe { write_map(completion, map, shape, deviation, buffer, "deviation") }
    })
}

/// Writes the number of standard deviations around the depth that contain a share `level` of errors, between 0
/// and 1: 95 % need more than 1.96.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completion_interval(
    completion: *const lsdc_completion,
    level: f64,
    deviations: *mut f64,
) -> lsdc_status {
    guard(|| {
        let fitted = COMPLETIONS.get(completion)?.value;
        let found = fitted.completion.interval(level)?;
        // SAFETY: the caller's promise.
        unsafe { memory::put(deviations, found, "deviations") }
    })
}

/// Writes the depth at `count` positions of the image, which may lie between pixels; see `lsdc_points` for
/// `x` and `y`. Fails with `LSDC_ERROR_FIT`, and writes nothing, if one is outside the image.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completion_depth_at(
    completion: *const lsdc_completion,
    x: *const f64,
    y: *const f64,
    depth: *mut f32,
    count: usize,
) -> lsdc_status {
    guard(|| {
        let fitted = COMPLETIONS.get(completion)?;
        let rows = RowLayout::new("positions", count, size_of::<f64>(), 0)?;
        // SAFETY: the caller's promise.
        let (x, y) = unsafe { (memory::gather(x, rows, "x")?, memory::gather(y, rows, "y")?) };
        let places: Vec<[f64; 2]> = x.into_iter().zip(y).map(|(x, y)| [x, y]).collect();
        let found = fitted.run(|fitted| Ok(fitted.completion.at(&places)?))?;
        // SAFETY: the caller's promise.
        unsafe { write_values(&found, depth, count, "depth") }
    })
}

/// Writes the report.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completion_report(
    completion: *const lsdc_completion,
    report: *mut lsdc_report,
) -> lsdc_status {
    guard(|| {
        let fitted = COMPLETIONS.get(completion)?.value;
        // SAFETY: the caller's promise.
        unsafe { memory::fill(report, &report_of(&fitted.completion), "report") }
    })
}

/// Writes, for each of the `count` points given, its depth minus the fitted depth; NaN for points that were
/// not used. `count` must be `given` of the report.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completion_residuals(
    completion: *const lsdc_completion,
    residuals: *mut f64,
    count: usize,
) -> lsdc_status {
    // SAFETY: the caller's promise.
    guard(|| unsafe {
        write_points(
            completion,
            Completion::residuals,
            residuals,
            count,
            "residuals",
        )
    })
}

/// Writes, for each of the `count` points given, its depth minus the prediction of a fit to all others; NaN for
/// points that were not used, and for points that the fit interpolates whatever their depths are. `count` must
/// be `given` of the report.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completion_leave_one_out(
    completion: *const lsdc_completion,
    errors: *mut f64,
    count: usize,
) -> lsdc_status {
    // SAFETY: the caller's promise.
    guard(|| unsafe {
        write_points(
            completion,
            Completion::leave_one_out,
            errors,
            count,
            "errors",
        )
    })
}

/// Writes the root mean square of the leave-one-out errors, an estimate of the depth error between the points;
/// NaN if no point has such an error.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completion_leave_one_out_error(
    completion: *const lsdc_completion,
    error: *mut f64,
) -> lsdc_status {
    guard(|| {
        let fitted = COMPLETIONS.get(completion)?;
        let found = fitted.run(|fitted| Ok(fitted.completion.leave_one_out_error()))?;
        // SAFETY: the caller's promise.
        unsafe { memory::put(error, found.unwrap_or(f64::NAN), "error") }
    })
}

/// Writes the final weight of each of the `count` points given: 1 in a plain fit without sigmas, less for points
/// that a robust fit downweights, or that have a larger sigma; NaN for points that were not used. `count` must
/// be `given` of the report.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completion_point_weights(
    completion: *const lsdc_completion,
    weights: *mut f64,
    count: usize,
) -> lsdc_status {
    // SAFETY: the caller's promise.
    guard(|| unsafe {
        write_points(
            completion,
            Completion::point_weights,
            weights,
            count,
            "weights",
        )
    })
}

/// Lists the points that are more likely outliers than inliers, worst first. Writes the first `capacity` of
/// them to `outliers`, which may be null if `capacity` is 0, and the number of all to `*count`. `outlier_size`
/// is `sizeof(lsdc_outlier)`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completion_outliers(
    completion: *const lsdc_completion,
    outliers: *mut lsdc_outlier,
    capacity: usize,
    outlier_size: usize,
    count: *mut usize,
) -> lsdc_status {
    guard(|| {
        // SAFETY: the caller's promise.
        unsafe { memory::put(count, 0, "count") }?;
        let fitted = COMPLETIONS.get(completion)?;
        if outlier_size != size_of::<lsdc_outlier>() {
            let message = format!("`outlier_size` is {outlier_size}");
            return Err(Error::argument(message).with_hint("set it to sizeof(lsdc_outlier)"));
        }
        if outliers.is_null() && capacity > 0 {
            return Err(Error::null("outliers"));
        }
        let points = &fitted.value.points;
        let found = fitted.run(|fitted| Ok(fitted.completion.outliers()?))?;
        let found = found.iter().map(|found| outlier_of(found, points));
        let found: Vec<_> = found.collect();
        let some = &found[..found.len().min(capacity)];
        // SAFETY: the caller's promise.
        unsafe {
            write_values(some, outliers, some.len(), "outliers")?;
            memory::put(count, found.len(), "count")
        }
    })
}

/// Frees a completion; null is ignored. Calls in progress are not affected. A handle that was freed before gives
/// `LSDC_ERROR_HANDLE`.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_completion_free(completion: *mut lsdc_completion) -> lsdc_status {
    guard(|| COMPLETIONS.free(completion))
}

// SAFETY: it is `repr(C)` with fields of 8 bytes each where a pointer has 8; it is only copied out, never read.
unsafe impl memory::Plain for lsdc_outlier {}

fn report_of(completion: &Completion) -> lsdc_report {
    let report = completion.report();
    let (lowest, highest) = completion.limits();
    lsdc_report {
        struct_size: size_of::<lsdc_report>(),
        given: report.given,
        used: report.used,
        invalid: report.invalid,
        outside: report.outside,
        without_deviation: report.without_deviation,
        rank: report.rank,
        functions: report.functions,
        residual: report.residual,
        lambda: report.lambda.unwrap_or(f64::NAN),
        guide_trust: report.guide_trust.unwrap_or(f64::NAN),
        lowest: lowest.into(),
        highest: highest.into(),
        network_seconds: report.network.as_secs_f64(),
        fit_seconds: report.fit.as_secs_f64(),
        field_seconds: report.field.as_secs_f64(),
        solve_seconds: report.solve.as_secs_f64(),
        fit: fit_of(report.method),
        reserved: 0,
        median_share: report.median_share.unwrap_or(f64::NAN),
        sky_pixels: completion.sky_pixels(),
    }
}

fn outlier_of(found: &Outlier, points: &Observations) -> lsdc_outlier {
    let point = points.as_slice()[found.index];
    lsdc_outlier {
        index: found.index,
        x: point.u,
        y: point.v,
        depth: point.depth.into(),
        probability: found.probability,
        score: found.score,
        error: found.error,
        weight: found.weight,
    }
}

/// # Safety
/// `data` is null or leads to `size` bytes, which nobody else uses meanwhile.
unsafe fn write_map(
    completion: *const lsdc_completion,
    map: impl FnOnce(&Completion) -> lsdc_core::Result<lsdc_core::DepthMap> + Send,
    [width, height]: [usize; 2],
    data: *mut f32,
    [size, stride]: [usize; 2],
    what: &str,
) -> Result<()> {
    let fitted = COMPLETIONS.get(completion)?;
    if data.is_null() {
        return Err(Error::null(what));
    }
    let name = format!("`{what}`");
    checked_size(&name, width, height)?;
    let rows = RowLayout::new(&name, height, width * size_of::<f32>(), stride)?.fit(&name, size)?;
    let found = fitted.run(|fitted| Ok(map(&fitted.completion)?))?;
    // SAFETY: the rows lie within `size` bytes.
    unsafe { memory::scatter(found.values(), data, rows, what) }
}

/// # Safety
/// `data` is null or leads to `count` values, which nobody else uses meanwhile.
unsafe fn write_points(
    completion: *const lsdc_completion,
    values: impl FnOnce(&Completion) -> Vec<f64> + Send,
    data: *mut f64,
    count: usize,
    what: &str,
) -> Result<()> {
    let fitted = COMPLETIONS.get(completion)?;
    if data.is_null() {
        return Err(Error::null(what));
    }
    let given = fitted.value.completion.report().given;
    if count != given {
        let message = format!("`{what}` has {count} values for {given} points");
        return Err(Error::buffer(message).with_hint("`count` is `given` of the report"));
    }
    let found = fitted.run(|fitted| Ok(values(&fitted.completion)))?;
    // SAFETY: the caller's promise.
    unsafe { write_values(&found, data, count, what) }
}

/// # Safety
/// `data` is null or leads to `count` values, which nobody else uses meanwhile.
unsafe fn write_values<T: memory::Plain>(
    values: &[T],
    data: *mut T,
    count: usize,
    what: &str,
) -> Result<()> {
    let rows = RowLayout::new(what, count, size_of::<T>(), 0)?;
    // SAFETY: the caller's promise.
    unsafe { memory::scatter(values, data, rows, what) }
}
