//! The allocator of the C library. Declared in a file of its own, which is not a source of the header.

/// Returns free memory to the system. The allocator of glibc keeps it for the thread that allocated it; others return it.
pub(crate) fn return_free_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: the argument is a number, and other threads may allocate during the call.
    unsafe {
        malloc_trim(0);
    }
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
unsafe extern "C" {
    fn malloc_trim(kept: usize) -> std::ffi::c_int;
}
