//! Exit codes.

use lsdc_files::error::{Cause, Error};

/// Exit code of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Exit {
    /// Success.
    Done = 0,
    /// Something failed that the user's input did not cause.
    Failed = 1,
    /// Wrong usage, configuration or input.
    Usage = 2,
    /// Finished, but some frames failed.
    Partial = 3,
    /// Stopped by Ctrl-C.
    Interrupted = 130,
}

impl From<&Error> for Exit {
    fn from(error: &Error) -> Self {
        match error.cause() {
            Cause::Write | Cause::Network => Self::Failed,
            _ => Self::Usage,
        }
    }
}
