//! The C interface of `lsdc`; see `README.md` for how to use it from C and C++.
//!
//! Functions enter in `completer`, `network_output`, `scene`, `completion`, `alignment` and `status`. Each reads the caller's memory
//! (`memory`) into types of Rust, does its work on them, and writes the results back; handles are looked up
//! in tables (`handles`), so that none is ever followed as a pointer. Whatever fails becomes a status code
//! (`error`), and a message that the thread can ask for (`last_error`).
//!
//! `cargo run --manifest-path crates/c/header/Cargo.toml` writes `include/lsdc.h` from the types, constants
//! and comments here.

#![allow(non_camel_case_types)]
// What C code passes can only be reached through its pointers.
#![allow(unsafe_code)]
#![deny(unsafe_op_in_unsafe_fn, clippy::undocumented_unsafe_blocks)]
// A comment here is a comment in the header, which has no links to items.
#![allow(clippy::doc_markdown, clippy::missing_safety_doc)]

mod abi;
mod alignment;
mod completer;
mod completion;
mod error;
mod handles;
mod input;
mod last_error;
mod memory;
mod network_output;
mod pool;
mod scene;
mod status;

pub use abi::LSDC_ABI_VERSION;
pub use alignment::*;
pub use completer::*;
pub use completion::*;
pub use input::*;
pub use network_output::*;
pub use scene::*;
pub use status::*;
