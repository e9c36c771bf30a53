//! Status codes, the last error of a thread, and versions.

use crate::abi::LSDC_ABI_VERSION;
use crate::last_error;
use std::ffi::c_char;

/// The result of a call: `LSDC_OK`, or one of the codes `LSDC_ERROR_...`.
pub type lsdc_status = i32;

/// The call succeeded.
pub const LSDC_OK: lsdc_status = 0;
/// A pointer is null, a structure has an impossible `struct_size`, or a constant is unknown.
pub const LSDC_ERROR_ARGUMENT: lsdc_status = 1;
/// A handle was freed before, does not belong to this library, or was created before `fork()`.
pub const LSDC_ERROR_HANDLE: lsdc_status = 2;
/// The size, the stride or the number of pixels of a buffer does not match its contents.
pub const LSDC_ERROR_BUFFER: lsdc_status = 3;
/// The colours of an image, or the values of a guide, cannot be used.
pub const LSDC_ERROR_IMAGE: lsdc_status = 4;
/// Weights cannot be read, or do not match their network.
pub const LSDC_ERROR_WEIGHTS: lsdc_status = 5;
/// A setting is out of range.
pub const LSDC_ERROR_SETTINGS: lsdc_status = 6;
/// The fit has no solution: too few usable points.
pub const LSDC_ERROR_FIT: lsdc_status = 7;
/// Memory for a copy of the caller's data cannot be allocated.
pub const LSDC_ERROR_MEMORY: lsdc_status = 8;
/// A bug in lsdc, which should be reported.
pub const LSDC_ERROR_INTERNAL: lsdc_status = 9;

/// Returns the error message of the last failed call on this thread: one sentence in UTF-8, or "" if no call
/// has failed yet. Successful calls do not change it. The text belongs to the library and is valid until the
/// next failed call on this thread, or the end of the thread.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_last_error() -> *const c_char {
    last_error::last_message()
}

/// Returns a hint at a remedy for the error of `lsdc_last_error`, or "" if there is none. It is valid as long.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_last_hint() -> *const c_char {
    last_error::last_hint()
}

/// Returns the version of the library, such as "0.2.0". The text is valid for the lifetime of the program.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}

/// Returns the interface version of the loaded library. A program can compare it with `LSDC_ABI_VERSION`, the
/// version of the header with which it was compiled.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_abi_version() -> u32 {
    LSDC_ABI_VERSION
}
