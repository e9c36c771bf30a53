//! The version of the interface, which `build.rs` reads too.

/// The version of this interface, which is part of the name of the shared library (`liblsdc.so.1`). It rises
/// when a program that was compiled with an older header would no longer work.
pub const LSDC_ABI_VERSION: u32 = 1;
