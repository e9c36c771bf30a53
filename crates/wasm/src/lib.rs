//! The WebAssembly module of the npm package `lsdc`: a few exports, and no imports.
//!
//! An instance of the module has one completer and any number of scenes. The JavaScript (`npm/src/module.ts`) writes the
//! bytes of an argument to the address from [`lsdc_input`], calls a function, and copies its outputs. A function that fails
//! returns 0, and its text is an error in JSON (`error.rs`). No export dereferences an address from JavaScript.
//!
//! The target has no threads and no clock. Work runs on the calling thread, and JavaScript measures run times.

// For the names of exports; there is no unsafe block.
#![allow(unsafe_code)]

mod error;
mod options;
mod panic;
mod report;
mod session;

use error::Result;
use session::Session;
use std::cell::RefCell;

thread_local! {
    static SESSION: RefCell<Session> = RefCell::default();
}

/// Runs a function on the session; returns 0 if it fails.
fn run(work: impl FnOnce(&mut Session) -> Result<u32>) -> u32 {
    SESSION.with_borrow_mut(|session| {
        let done = work(session);
        done.unwrap_or_else(|error| {
            session.fail(&error);
            0
        })
    })
}

/// Prepares the instance, and returns the address of the message of a panic (`panic.rs`). Must be called once, before all
/// other functions.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_start() -> *const u8 {
    panic::keep_message()
}

/// Returns the address of a buffer of `bytes` bytes for the input of the next call; null if it cannot be allocated.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_input(bytes: usize) -> *const u8 {
    SESSION.with_borrow_mut(|session| session.reserve(bytes))
}

/// Creates the completer from the input, a weights file. Frees the scenes of an earlier one.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_load() -> u32 {
    run(Session::load)
}

/// Creates a scene from the input, an image: rows of pixels of 1 (grey), 3 (RGB) or 4 (RGBA) bytes. If `best` is not 0,
/// also completes the mirror image. Returns the scene's number.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_scene(width: usize, height: usize, channels: usize, best: u32) -> u32 {
    run(|session| session.scene((width, height), channels, best != 0))
}

/// Fits a scene to `count` points. The input has four 64-bit floats for each point (column, row, depth and standard
/// deviation, NaN if unknown), then options in JSON (`options.rs`). The text becomes a report.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_complete(scene: u32, count: usize) -> u32 {
    run(|session| session.complete(scene, count))
}

/// Frees a scene; unknown numbers are ignored.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_free(scene: u32) {
    SESSION.with_borrow_mut(|session| session.free(scene));
}

/// Returns the address of the text of the last call, in UTF-8.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_text() -> *const u8 {
    SESSION.with_borrow(|session| session.text().as_ptr())
}

/// Returns the number of bytes of this text.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_text_length() -> usize {
    SESSION.with_borrow(|session| session.text().len())
}

/// Returns the address of an output of the last completion, 32-bit floats: 0, the depth of every pixel; 1, its standard
/// deviation; 2, the residual of every point; 3, its leave-one-out error. It is valid until the next call of any other
/// function.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_output(which: usize) -> *const f32 {
    SESSION.with_borrow(|session| session.output(which).as_ptr())
}

/// Returns the number of values of an output; 0 if it was not requested, or cannot be computed.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_output_length(which: usize) -> usize {
    SESSION.with_borrow(|session| session.output(which).len())
}
