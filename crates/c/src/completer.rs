//! Completers: weights, settings and threads.

use crate::allocator;
use crate::error::{Error, Result, guard};
use crate::handles::Handles;
use crate::memory::{self, Versioned};
use crate::pool::{Pool, Pooled};
use crate::status::lsdc_status;
use lsdc_core::settings::{FitConfig, FitMethod, Loss, Robust};
use lsdc_core::{Completer, Weights};
use std::ffi::{c_char, c_void};

/// A trained network, the settings of the fit, and threads.
pub struct lsdc_completer {
    _opaque: [u8; 0],
}

pub(crate) static COMPLETERS: Handles<lsdc_completer, Pooled<Completer>> =
    Handles::new("completer");

/// The model of depth: one of the constants `LSDC_FIT_...`.
pub type lsdc_fit = u32;

/// The model for which the weights were trained.
pub const LSDC_FIT_DEFAULT: lsdc_fit = 0;
/// Basis functions only: least squares as in the paper.
pub const LSDC_FIT_LSE: lsdc_fit = 1;
/// A field only, which is smooth except across edges.
pub const LSDC_FIT_FIELD: lsdc_fit = 2;
/// Basis functions and a field.
pub const LSDC_FIT_JOINT: lsdc_fit = 3;

/// How the influence of outliers is limited: one of the constants `LSDC_ROBUST_...`.
pub type lsdc_robust = u32;

/// The setting of the weights; the weights of the library do not limit the influence.
pub const LSDC_ROBUST_DEFAULT: lsdc_robust = 0;
/// No limit.
pub const LSDC_ROBUST_NONE: lsdc_robust = 1;
/// Weights each point by its probability of being an inlier, judged by the other points.
pub const LSDC_ROBUST_AUTO: lsdc_robust = 2;
/// Least absolute residuals, as in the paper.
pub const LSDC_ROBUST_IRLS: lsdc_robust = 3;
/// Huber's loss.
pub const LSDC_ROBUST_HUBER: lsdc_robust = 4;
/// Cauchy's loss.
pub const LSDC_ROBUST_CAUCHY: lsdc_robust = 5;
/// The loss of Geman and McClure.
pub const LSDC_ROBUST_GM: lsdc_robust = 6;
/// Tukey's biweight.
pub const LSDC_ROBUST_TUKEY: lsdc_robust = 7;

/// Settings of a completer; zeros are the defaults. Set `struct_size` to `sizeof(lsdc_completer_options)`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct lsdc_completer_options {
    /// `sizeof(lsdc_completer_options)`.
    pub struct_size: usize,
    /// Number of separate threads, at most 4096. 0 means the shared threads of such completers, one per core.
    pub threads: usize,
    /// With `working_height`: images are resized to about the number of pixels of this size, keeping their aspect
    /// ratio, before they enter the network. Both 0 means the size of the training images.
    pub working_width: usize,
    /// See `working_width`.
    pub working_height: usize,
    /// The model of depth.
    pub fit: lsdc_fit,
    /// How the influence of outliers is limited.
    pub robust: lsdc_robust,
    /// Size of the image that the encoder of "anything" reads: the shorter side of one of 4:3 with as many pixels, from 252 to
    /// 518. 0 means 336, with which it was trained. Other weights take 0 only.
    pub encoder_side: usize,
}

// SAFETY: it is `repr(C)`, begins with its size, and consists of numbers.
unsafe impl Versioned for lsdc_completer_options {
    const LEAST: usize = size_of::<usize>();
}

/// Creates a completer with weights of the library: "default", the most accurate without an installation; "small",
/// which take two thirds of the time; "anything", the most accurate of all; or "none", no network, for scenes with a
/// guide. "anything" needs an encoder, which the program `lsdc` installs once in the user's data folder: `lsdc weights
/// get anything`, or offline `lsdc weights add FILE`; LSDC_WEIGHTS names another folder. `options` may be null.
/// `*completer` becomes a handle to be freed with `lsdc_completer_free`, or null if the call fails.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completer_create(
    weights: *const c_char,
    options: *const lsdc_completer_options,
    completer: *mut *mut lsdc_completer,
) -> lsdc_status {
    // SAFETY: the caller's promise.
    let weights = || named(&unsafe { memory::text(weights, "weights") }?);
    // SAFETY: the caller's promise.
    guard(|| unsafe { make(weights, options, completer) })
}

/// Creates a completer with weights from a file, as `lsdc train` writes them. `path` is null-terminated, and
/// UTF-8 on Windows. Otherwise as `lsdc_completer_create`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completer_create_from_file(
    path: *const c_char,
    options: *const lsdc_completer_options,
    completer: *mut *mut lsdc_completer,
) -> lsdc_status {
    // SAFETY: the caller's promise.
    let weights = || SelectedWeights::all(Weights::read(unsafe { memory::path(path, "path") }?));
    // SAFETY: the caller's promise.
    guard(|| unsafe { make(weights, options, completer) })
}

/// Creates a completer with weights from the `size` bytes of such a file in memory, which are not needed
/// afterwards. Otherwise as `lsdc_completer_create`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lsdc_completer_create_from_memory(
    data: *const c_void,
    size: usize,
    options: *const lsdc_completer_options,
    completer: *mut *mut lsdc_completer,
) -> lsdc_status {
    let weights = || {
        let rows = memory::RowLayout::new("the weights", 1, size, 0)?;
        // SAFETY: the caller's promise.
        let bytes = unsafe { memory::gather(data.cast(), rows, "data") }?;
        SelectedWeights::all(Weights::from_bytes(&bytes))
    };
    // SAFETY: the caller's promise.
    guard(|| unsafe { make(weights, options, completer) })
}

/// Frees the memory that a completer keeps for further images, and the memory that all completers keep for further
/// fits. With glibc, it also returns all free memory of the process to the system. Programs with little memory call
/// it after `lsdc_scene_create`; later calls allocate again.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_completer_release(completer: *const lsdc_completer) -> lsdc_status {
    guard(|| {
        COMPLETERS.get(completer)?.value.release();
        allocator::return_free_memory();
        Ok(())
    })
}

/// Frees a completer; null is ignored. Its scenes, and calls in progress, are not affected. A handle that was
/// freed before gives `LSDC_ERROR_HANDLE`.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_completer_free(completer: *mut lsdc_completer) -> lsdc_status {
    guard(|| COMPLETERS.free(completer))
}

/// Weights with their network, or only with the settings of their fit.
struct SelectedWeights {
    weights: Weights,
    network: bool,
}

impl SelectedWeights {
    fn all(weights: lsdc_core::Result<Weights>) -> Result<Self> {
        let (weights, network) = (weights?, true);
        Ok(Self { weights, network })
    }
}

/// # Safety
/// The pointers are null or lead to what they say.
unsafe fn make(
    weights: impl FnOnce() -> Result<SelectedWeights>,
    options: *const lsdc_completer_options,
    completer: *mut *mut lsdc_completer,
) -> Result<()> {
    // SAFETY: the caller's promise.
    unsafe { memory::put(completer, std::ptr::null_mut(), "completer") }?;
    // SAFETY: the caller's promise.
    let options = unsafe { memory::optional(options, "options") }?;
    let made = COMPLETERS.add(with(&weights()?, &options)?);
    // SAFETY: the caller's promise.
    unsafe { memory::put(completer, made, "completer") }
}

fn with(selected: &SelectedWeights, options: &lsdc_completer_options) -> Result<Pooled<Completer>> {
    let recorded = selected.weights.fit()?.unwrap_or_default();
    let fit = FitConfig {
        method: method(options.fit, recorded.method)?,
        robust: robust(options.robust, recorded.robust)?,
        ..recorded
    };
    let pool = Pool::new(options.threads)?;
    let mut value = if selected.network {
        let network = &selected.weights.network;
        let encoder = pool.threads.install(|| lsdc_weights::encoder_of(network))?;
        let mut builder = Completer::builder(&selected.weights).fit(fit);
        if let Some(encoder) = encoder {
            builder = builder.encoder(encoder);
        }
        let value = builder.thread_pool(pool.threads.clone()).build()?;
        pool.threads
            .install(|| lsdc_weights::guided_by_head(value))?
    } else {
        Completer::without_network(fit)?
    };
    match (options.working_height, options.working_width) {
        (0, 0) => {}
        (height, width) => value = value.with_working_size(height, width)?,
    }
    if options.encoder_side != 0 {
        value = value.with_encoder_side(options.encoder_side)?;
    }
    Ok(Pooled { value, pool })
}

fn method(fit: lsdc_fit, recorded: FitMethod) -> Result<FitMethod> {
    match fit {
        LSDC_FIT_DEFAULT => Ok(recorded),
        LSDC_FIT_LSE => Ok(FitMethod::Lse),
        LSDC_FIT_FIELD => Ok(FitMethod::Field),
        LSDC_FIT_JOINT => Ok(FitMethod::Joint),
        other => Err(Error::unknown("options->fit", other)),
    }
}

pub(crate) fn fit_of(method: FitMethod) -> lsdc_fit {
    match method {
        FitMethod::Lse => LSDC_FIT_LSE,
        FitMethod::Field => LSDC_FIT_FIELD,
        FitMethod::Joint => LSDC_FIT_JOINT,
    }
}

fn robust(robust: lsdc_robust, recorded: Option<Robust>) -> Result<Option<Robust>> {
    let loss = match robust {
        LSDC_ROBUST_DEFAULT => return Ok(recorded),
        LSDC_ROBUST_NONE => return Ok(None),
        LSDC_ROBUST_AUTO => Loss::Auto,
        LSDC_ROBUST_IRLS => Loss::Irls,
        LSDC_ROBUST_HUBER => Loss::Huber,
        LSDC_ROBUST_CAUCHY => Loss::Cauchy,
        LSDC_ROBUST_GM => Loss::Gm,
        LSDC_ROBUST_TUKEY => Loss::Tukey,
        other => return Err(Error::unknown("options->robust", other)),
    };
    Ok(Some(Robust::new(loss)))
}

/// Returns weights of the library by name.
fn named(name: &str) -> Result<SelectedWeights> {
    let network = name != NONE;
    let found = if network {
        lsdc_weights::named(name)
    } else {
        lsdc_weights::embedded().first()
    };
    let weights = found.ok_or_else(|| unknown(name))?.read()?;
    Ok(SelectedWeights { weights, network })
}

/// Name of the weights without a network.
const NONE: &str = "none";

/// Returns the error for an unknown name of weights; without the features `weights` and `weights-small`, for any name.
fn unknown(name: &str) -> Error {
    let read = "read a file with lsdc_completer_create_from_file";
    if lsdc_weights::embedded().is_empty() {
        return Error::weights("this library was built without weights").with_hint(read);
    }
    let names = lsdc_weights::embedded().iter().map(|weights| weights.name);
    let names: Vec<String> = names
        .chain([NONE])
        .map(|name| format!("{name:?}"))
        .collect();
    Error::weights(format!("there are no weights named `{name}`"))
        .with_hint(format!("choose {}, or {read}", names.join(", ")))
}
