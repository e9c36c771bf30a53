//! The `lsdc` program.

use std::process::ExitCode;

fn main() -> ExitCode {
    lsdc::cli::main()
}
