//! The `lsdc` program.

use std::process::ExitCode;

#[allow(unsafe_code)]
fn main() -> ExitCode {
    // SAFETY: no other thread has started.
    unsafe { lsdc::process::prepare() };
    lsdc::cli::main()
}
