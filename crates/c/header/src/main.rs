//! Writes `include/lsdc.h` from the types, constants and comments of `lsdc-c`, or checks that it is up to date.
//!
//!     cargo run --release --manifest-path crates/c/header/Cargo.toml              writes it
//!     cargo run --release --manifest-path crates/c/header/Cargo.toml -- --check   fails if it is not current

use cbindgen::{Builder, Config, DocumentationStyle, Language};
use std::error::Error;
use std::path::Path;

/// Sources in the order of the header.
const SOURCES: [&str; 8] =
    ["abi", "status", "input", "completer", "network_output", "scene", "completion", "alignment"];

const ABOUT: &str = "\
// lsdc: an RGB image and a few sparse depths in, a dense depth map out.
//
// An lsdc_completer runs the network on an image once and creates an lsdc_scene. A scene can be fitted to
// points any number of times, each giving an lsdc_completion, which returns depth, standard deviations,
// residuals and outliers.
//
// Units. Depths are along the optical axis, in metres or any other unit; results are in the same unit.
// Positions are in pixels: x to the right, y down, (0, 0) is the centre of the first pixel.
// Strides and sizes of buffers are in bytes.
//
// Errors. A function returns LSDC_OK or one of LSDC_ERROR_...; lsdc_last_error() and lsdc_last_hint() give
// the message of the last error on the calling thread and a hint at a remedy. A failed call changes only the
// handle that it would have returned, which becomes null, or the count of outliers, which becomes 0.
//
// Ownership. Data passed by the caller is copied and may be freed or changed once the call returns. Handles
// belong to the caller, who frees each once, in any order; they are numbers, not addresses. Null, freed and
// foreign handles give an error. The library cannot check that a buffer is as long as its declared size.
//
// Threads. Every function may be called from any number of threads at once, also on the same handle: handles
// are immutable. The same input gives the same bits for any number of threads. After fork(), a child process
// must create its own completer: computing with its parent's handles gives LSDC_ERROR_HANDLE.
//
// Structures begin with their size, so fields can be added at their end and programs compiled with an older
// header keep working. Set struct_size, and leave fields that you do not need 0:
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
