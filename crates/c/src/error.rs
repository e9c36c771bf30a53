//! Errors of calls, and their status codes.

use crate::last_error;
use crate::status::{
    LSDC_ERROR_ARGUMENT, LSDC_ERROR_BUFFER, LSDC_ERROR_FIT, LSDC_ERROR_HANDLE, LSDC_ERROR_IMAGE,
    LSDC_ERROR_INTERNAL, LSDC_ERROR_MEMORY, LSDC_ERROR_SETTINGS, LSDC_ERROR_WEIGHTS, LSDC_OK,
    lsdc_status,
};
use lsdc_core::FitError;
use std::error::Error as _;
use std::panic::{AssertUnwindSafe, catch_unwind};

pub(crate) type Result<T, E = Error> = std::result::Result<T, E>;

/// A failed call.
#[derive(Debug)]
pub(crate) struct Error {
    status: lsdc_status,
    message: String,
    hint: String,
}

impl Error {
    fn new(status: lsdc_status, message: impl Into<String>) -> Self {
        Self {
            status,
            message: message.into(),
            hint: String::new(),
        }
    }

    pub(crate) fn argument(message: impl Into<String>) -> Self {
        Self::new(LSDC_ERROR_ARGUMENT, message)
    }

    pub(crate) fn unknown(what: &str, value: u32) -> Self {
        Self::argument(format!("`{what}` {value} is unknown"))
    }

    pub(crate) fn null(what: &str) -> Self {
        Self::argument(format!("`{what}` is null"))
    }

    pub(crate) fn handle(what: &str) -> Self {
        let message = format!("this {what} was freed before, or was never made");
        Self::new(LSDC_ERROR_HANDLE, message)
    }

    pub(crate) fn forked() -> Self {
        let message = "the threads of this completer are those of the process before fork()";
        Self::new(LSDC_ERROR_HANDLE, message).with_hint("make a completer in this process")
    }

    pub(crate) fn buffer(message: impl Into<String>) -> Self {
        Self::new(LSDC_ERROR_BUFFER, message)
    }

    pub(crate) fn weights(message: impl Into<String>) -> Self {
        Self::new(LSDC_ERROR_WEIGHTS, message)
    }

    pub(crate) fn memory(bytes: usize) -> Self {
        let message = format!("{bytes} bytes of memory cannot be had");
        Self::new(LSDC_ERROR_MEMORY, message)
    }

    pub(crate) fn with_hint(self, hint: impl Into<String>) -> Self {
        Self {
            hint: hint.into(),
            ..self
        }
    }

    fn panic(payload: &(dyn std::any::Any + Send)) -> Self {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| payload.downcast_ref::<&str>().copied());
        let message = format!("an error in lsdc itself: {}", text.unwrap_or("a panic"));
        Self::new(LSDC_ERROR_INTERNAL, message)
            .with_hint("please report it; handles can still be used")
    }
}

impl From<lsdc_core::Error> for Error {
    fn from(error: lsdc_core::Error) -> Self {
        use lsdc_core::Error as Core;
        let status = match &error {
            Core::Image(_) => LSDC_ERROR_IMAGE,
            Core::Weights(_) => LSDC_ERROR_WEIGHTS,
            Core::Settings(_) => LSDC_ERROR_SETTINGS,
            Core::Fit(_) => LSDC_ERROR_FIT,
            _ => LSDC_ERROR_INTERNAL,
        };
        let mut message = error.to_string();
        let mut cause = error.source();
        while let Some(source) = cause {
            message = format!("{message}: {source}");
            cause = source.source();
        }
        let hint = hint(&error).unwrap_or_default().to_owned();
        Self::new(status, message).with_hint(hint)
    }
}

impl From<lsdc_weights::error::Error> for Error {
    /// Converts an error of the weights in the user's data folder.
    fn from(error: lsdc_weights::error::Error) -> Self {
        Self::weights(error.with_causes()).with_hint(error.advice().unwrap_or_default())
    }
}

/// Returns a hint in terms of this interface.
fn hint(error: &lsdc_core::Error) -> Option<&str> {
    use lsdc_core::Error::Fit;
    match error {
        Fit(FitError::TooFewPoints(_)) => {
            Some("give more points, or choose another fit (`options.fit = LSDC_FIT_LSE`)")
        }
        Fit(FitError::OtherWeights { .. }) => Some(
            "`options.previous` is a completion of a completer with the same weights and settings",
        ),
        Fit(FitError::NearNothing) => Some("complete this image without `options.previous`"),
        Fit(FitError::NearWithoutPrior) => Some(
            "choose `LSDC_FIT_LSE` or `LSDC_FIT_JOINT`, and weights with a learned prior, such as \"default\"",
        ),
        other => other.hint(),
    }
}

/// Runs the body of a function of the interface. Catches panics, and keeps errors for `lsdc_last_error`.
pub(crate) fn guard(work: impl FnOnce() -> Result<()>) -> lsdc_status {
    let caught = catch_unwind(AssertUnwindSafe(work));
    match caught.unwrap_or_else(|payload| Err(Error::panic(&*payload))) {
        Ok(()) => LSDC_OK,
        Err(error) => {
            last_error::keep(&error.message, &error.hint);
            error.status
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::last_error::{last_hint, last_message};
    use std::ffi::{CStr, c_char};

    fn text(pointer: *const c_char) -> String {
        // SAFETY: the texts of this thread are null-terminated and valid until its next failure.
        let text = unsafe { CStr::from_ptr(pointer) };
        text.to_str().unwrap().to_owned()
    }

    #[test]
    fn a_panic_becomes_a_status() {
        assert_eq!(guard(|| panic!("by {}", "design")), LSDC_ERROR_INTERNAL);
        assert_eq!(text(last_message()), "an error in lsdc itself: by design");
        assert!(text(last_hint()).contains("report"));
    }

    #[test]
    fn errors_belong_to_their_thread_and_outlive_success() {
        let own = || {
            assert_eq!(text(last_message()), "");
            assert_eq!(guard(|| Err(Error::null("here"))), LSDC_ERROR_ARGUMENT);
            let other = std::thread::spawn(|| text(last_message())).join().unwrap();
            assert_eq!(guard(|| Ok(())), LSDC_OK);
            (text(last_message()), other)
        };
        let (here, other) = std::thread::spawn(own).join().unwrap();
        assert_eq!([here.as_str(), other.as_str()], ["`here` is null", ""]);
    }

    #[test]
    fn a_text_with_a_zero_is_kept_whole() {
        guard(|| Err(Error::argument("a\0b")));
        assert_eq!(text(last_message()), "a b");
    }

    #[test]
    fn the_cause_is_part_of_the_message() {
        let error = lsdc_core::Weights::read("no/such/file").unwrap_err();
        guard(|| Err(error.into()));
        let message = text(last_message());
        assert!(
            message.starts_with("cannot read weights from `no/such/file`: "),
            "{message}"
        );
    }
}
