//! Writes `include/lsdc.h` from the types, constants and comments of `lsdc-c`, or compares it with that.
//!
//!     cargo run --release --manifest-path crates/c/header/Cargo.toml              writes it
//!     cargo run --release --manifest-path crates/c/header/Cargo.toml -- --check   fails if it is not current

use cbindgen::{Builder, Config, DocumentationStyle, Language};
use std::error::Error;
use std::path::Path;

/// In the order in which a reader meets them.
const SOURCES: [&str; 8] =
    ["abi", "status", "input", "completer", "network_output", "scene", "completion", "alignment"];

const ABOUT: &str = "\
// lsdc: an RGB image and a few sparse depths in, a dense depth map out.
//
// An lsdc_completer turns an image into an lsdc_scene, which runs the network, once; a scene turns points
// into an lsdc_completion, which runs a fit, as often as you like. Depth, standard deviations, residuals
// and outliers are asked from the completion.
//
// Units. Depths are along the optical axis in metres, or in any other unit, which is then that of all
// results. Positions are in pixels: x to the right, y down, (0, 0) is the centre of the first pixel.
// Strides and sizes of buffers are in bytes.
//
// Errors. A function returns LSDC_OK or one of LSDC_ERROR_...; lsdc_last_error() and lsdc_last_hint() tell
// this thread what was wrong and what to do. A call that fails changes nothing but the handle that it would
// have returned, or the count of outliers, which become null and 0.
//
// Ownership. What the caller passes is copied, so that it may be freed or changed as soon as the call
// returns. Handles belong to the caller, who frees each once, in any order; they are numbers, not
// addresses. Null, freed and foreign handles give an error. That a buffer is as long as its size says
// cannot be checked.
//
// Threads. Every function may be called from any number of threads at once, on the same handle too: handles
// do not change. The same input gives the same bits for any number of threads. After fork(), a child makes
// a completer of its own: work with those of its parent gives LSDC_ERROR_HANDLE.
//
// Structures begin with their size, so that fields can be added at their end: a program that was compiled
// with an older header keeps working. Set struct_size, leave the other fields that you do not need 0:
//
//     lsdc_image image = {.struct_size = sizeof image, .data = pixels, .size = 3 * 640 * 480,
//                         .width = 640, .height = 480, .format = LSDC_RGB8};
//
// Written by cbindgen from the sources of lsdc-c. Do not edit.
";

fn main() -> Result<(), Box<dyn Error>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut builder = Builder::new().with_config(config());
    for source in SOURCES {
        builder = builder.with_src(root.join("src").join(source).with_extension("rs"));
    }
    let mut header = Vec::new();
    builder.generate()?.write(&mut header);
    let path = root.join("include/lsdc.h");
    if !std::env::args().any(|argument| argument == "--check") {
        std::fs::write(path, header)?;
    } else if std::fs::read(path)? != header {
        return Err("crates/c/include/lsdc.h is not that of the sources: write it again".into());
    }
    Ok(())
}

fn config() -> Config {
    Config {
        language: Language::C,
        header: Some(ABOUT.into()),
        include_guard: Some("LSDC_H".into()),
        no_includes: true,
        sys_includes: vec!["stddef.h".into(), "stdint.h".into()],
        cpp_compat: true,
        usize_is_size_t: true,
        documentation_style: DocumentationStyle::Cxx,
        tab_width: 4,
        line_length: 100,
        ..Config::default()
    }
}
