//! The version of the interface, also used by `build.rs`.

/// Version of this interface, which is part of the name of the shared library (`liblsdc.so.1`). It increases
/// if programs compiled with an older header would no longer work.
pub const LSDC_ABI_VERSION: u32 = 1;
