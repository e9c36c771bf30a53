//! Conversion of errors to the exceptions of the package.

use lsdc_core::Error;
use lsdc_files::error::{self as files, Cause};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;
use std::error::Error as _;

/// Exceptions of the package.
#[derive(Clone, Copy)]
pub(crate) enum ExceptionKind {
    Base,
    Input,
    Weights,
    Settings,
    Fit,
    Read,
}

impl ExceptionKind {
    fn class(self, py: Python<'_>) -> PyResult<&Bound<'_, PyType>> {
        static CLASSES: [PyOnceLock<Py<PyType>>; 6] = [const { PyOnceLock::new() }; 6];
        let name = match self {
            Self::Base => "Error",
            Self::Input => "InputError",
            Self::Weights => "WeightsError",
            Self::Settings => "SettingsError",
            Self::Fit => "FitError",
            Self::Read => "ReadError",
        };
        CLASSES[self as usize].import(py, "lsdc._errors", name)
    }

    /// Creates the exception with a message and a hint.
    pub(crate) fn raise(self, py: Python<'_>, message: &str, hint: Option<&str>) -> PyErr {
        let made = self
            .class(py)
            .and_then(|class| class.call1((message, hint)));
        made.map_or_else(|error| error, PyErr::from_value)
    }
}

/// Returns the exception for an error of `lsdc-core`.
pub(crate) fn raised(py: Python<'_>, error: &Error) -> PyErr {
    let kind = match error {
        Error::Image(_) => ExceptionKind::Input,
        Error::Weights(_) => ExceptionKind::Weights,
        Error::Settings(_) => ExceptionKind::Settings,
        Error::Fit(_) => ExceptionKind::Fit,
        _ => ExceptionKind::Base,
    };
    let message = match error.source() {
        Some(cause) => format!("{error}: {cause}"),
        None => error.to_string(),
    };
    let hint = error.hint().map(|hint| hint.replace("::", "."));
    kind.raise(py, &message, hint.as_deref())
}

/// Returns the exception for an error of a file.
pub(crate) fn raised_by_file(py: Python<'_>, error: &files::Error) -> PyErr {
    let kind = match error.cause() {
        Cause::Read | Cause::Write | Cause::Format | Cause::TooLarge => ExceptionKind::Read,
        Cause::Shape => ExceptionKind::Input,
        Cause::Config | Cause::Device => ExceptionKind::Settings,
        Cause::Weights => ExceptionKind::Weights,
        Cause::Fit => ExceptionKind::Fit,
        _ => ExceptionKind::Base,
    };
    kind.raise(py, &error.with_causes(), error.advice())
}
