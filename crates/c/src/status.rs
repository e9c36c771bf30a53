//! Status codes, the last error of a thread, and versions.

use crate::abi::LSDC_ABI_VERSION;
use crate::last_error;
use std::ffi::c_char;

/// What became of a call: `LSDC_OK`, or one of the codes `LSDC_ERROR_...`.
pub type lsdc_status = i32;

/// The call did what it was asked for.
pub const LSDC_OK: lsdc_status = 0;
/// A pointer is null, a structure has an impossible `struct_size`, or a constant is unknown.
pub const LSDC_ERROR_ARGUMENT: lsdc_status = 1;
/// A handle was freed before, is none of this library's, or was made before `fork()`.
pub const LSDC_ERROR_HANDLE: lsdc_status = 2;
/// The size, the stride or the number of pixels of a buffer is not that of its contents.
pub const LSDC_ERROR_BUFFER: lsdc_status = 3;
/// The colours of an image, or the values of a guide, cannot be used.
pub const LSDC_ERROR_IMAGE: lsdc_status = 4;
/// Weights cannot be read, or do not match their network.
pub const LSDC_ERROR_WEIGHTS: lsdc_status = 5;
/// A setting is out of range.
pub const LSDC_ERROR_SETTINGS: lsdc_status = 6;
/// The fit has no solution: too few points, or none that can be used.
pub const LSDC_ERROR_FIT: lsdc_status = 7;
/// Memory for a copy of the caller's data cannot be had.
pub const LSDC_ERROR_MEMORY: lsdc_status = 8;
/// An error in lsdc itself, which should be reported.
pub const LSDC_ERROR_INTERNAL: lsdc_status = 9;

/// What was wrong in the last call on this thread that failed: one sentence in UTF-8, or "" if none failed
/// yet. Calls that succeed leave it as it is. The text belongs to the library and lives until the next
/// failing call on this thread, or its end.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_last_error() -> *const c_char {
    last_error::last_message()
}

/// What to do about the error of `lsdc_last_error`, or "" if nothing can be suggested. It lives as long.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_last_hint() -> *const c_char {
    last_error::last_hint()
}

/// The version of the library, as "0.2.0". The text lives as long as the program.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}

/// The version of the interface of the library that was loaded. A program can compare it with
/// `LSDC_ABI_VERSION`, that of the header which it was compiled with.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_abi_version() -> u32 {
    LSDC_ABI_VERSION
}
