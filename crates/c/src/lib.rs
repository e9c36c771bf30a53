//! The C interface of `lsdc`; see `README.md` for how to use it from C and C++.
//!
//! The exported functions are in `completer`, `network_output`, `scene`, `completion`, `alignment` and `status`. Each copies
//! the caller's memory (`memory`) into Rust types, computes, and copies the results back. Handles are looked up in tables
//! (`handles`) and never dereferenced. Errors become a status code (`error`) and a message for the thread (`last_error`).
//!
//! `cargo run --manifest-path crates/c/header/Cargo.toml` writes `include/lsdc.h` from the types, constants and comments of
//! this crate.

#![allow(non_camel_case_types)]
// The memory of C callers is only accessible through pointers.
#![allow(unsafe_code)]
#![deny(unsafe_op_in_unsafe_fn, clippy::undocumented_unsafe_blocks)]
// Doc comments are copied to the header, which has no links to items.
#![allow(clippy::doc_markdown, clippy::missing_safety_doc)]

mod abi;
mod alignment;
mod allocator;
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
