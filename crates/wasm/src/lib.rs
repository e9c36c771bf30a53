//! The WebAssembly module of the npm package `lsdc`: a few exports, and no imports.
//!
//! An instance of the module has one completer and any number of scenes. Its JavaScript (`npm/src/module.ts`) asks
//! [`lsdc_input`] where to write the bytes of an argument, calls a function, and copies its outputs. A function that
//! returns 0 has failed: its text is then an error in JSON (`error.rs`). No export follows an address that JavaScript
//! gives.
//!
//! The target has no threads and no clock. Work runs on the calling thread, and JavaScript measures run times.

// The names of the exports; there is no unsafe block.
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

/// Runs a function on the session; 0 if it fails.
fn run(work: impl FnOnce(&mut Session) -> Result<u32>) -> u32 {
    SESSION.with_borrow_mut(|session| {
        let done = work(session);
        done.unwrap_or_else(|error| {
            session.fail(&error);
            0
        })
    })
}

/// Prepares the instance, and returns the address of the message of a panic (`panic.rs`). Call it once, before
/// anything else.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_start() -> *const u8 {
    panic::keep_message()
}

/// The address of so many bytes, which the next call takes as its input; null if memory cannot be had.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_input(bytes: usize) -> *const u8 {
    SESSION.with_borrow_mut(|session| session.reserve(bytes))
}

/// Makes the completer from a weights file, the input. Scenes of an earlier one are freed.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_load() -> u32 {
    run(Session::load)
}

/// Makes a scene from an image, the input: rows of pixels of 1 (grey), 3 (RGB) or 4 (RGBA) bytes. `best`, unless it
/// is 0, completes the mirror image too. Returns the scene's number.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_scene(width: usize, height: usize, channels: usize, best: u32) -> u32 {
    run(|session| session.scene((width, height), channels, best != 0))
}

/// Fits a scene to `count` points. The input is a row of four 64-bit floats for each, column, row, depth and standard
/// deviation (NaN if it is unknown), then options in JSON (`options.rs`). The text is then a report.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_complete(scene: u32, count: usize) -> u32 {
    run(|session| session.complete(scene, count))
}

/// Frees a scene; another number does nothing.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_free(scene: u32) {
    SESSION.with_borrow_mut(|session| session.free(scene));
}

/// The address of the text of the last call, in UTF-8.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_text() -> *const u8 {
    SESSION.with_borrow(|session| session.text().as_ptr())
}

/// The number of bytes of this text.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_text_length() -> usize {
    SESSION.with_borrow(|session| session.text().len())
}

/// The address of an output of the last completion, 32-bit floats: 0, the depth of every pixel; 1, its standard
/// deviation; 2, the residual of every point; 3, its leave-one-out error. It is valid until the next call of any
/// other function.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_output(which: usize) -> *const f32 {
    SESSION.with_borrow(|session| session.output(which).as_ptr())
}

/// The number of values of an output; 0 if it was not asked for, or cannot be computed.
#[unsafe(no_mangle)]
pub extern "C" fn lsdc_output_length(which: usize) -> usize {
    SESSION.with_borrow(|session| session.output(which).len())
}
