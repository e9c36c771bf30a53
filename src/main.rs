//! The `lsdc` program.

use std::process::ExitCode;

#[allow(unsafe_code)]
fn main() -> ExitCode {
    // burn reads the optimiser of a checkpoint on its default device before it moves it to that of
    // the run. The default would be a GPU, and the program would end where there is none.
    // SAFETY: no other thread has started.
    unsafe { std::env::set_var("BURN_DEVICE", "flex") };
    keep_pages();
    lsdc::cli::main()
}

/// Lets the C library keep the pages of freed tensors: to hand them back and to fault them in again
/// takes longer than to compute a training step (measured: 2.0 s instead of 1.2 s).
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[allow(unsafe_code)]
fn keep_pages() {
    for (option, value) in [
        // The most that older versions accept, then more.
        (libc::M_MMAP_THRESHOLD, 32 << 20),
        (libc::M_MMAP_THRESHOLD, i32::MAX),
        (libc::M_TRIM_THRESHOLD, i32::MAX),
        (libc::M_TOP_PAD, 64 << 20),
    ] {
        // SAFETY: no other thread has started; a refused option changes nothing.
        unsafe { libc::mallopt(option, value) };
    }
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn keep_pages() {}
