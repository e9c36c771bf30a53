//! A single error type, classified by cause, for files and for the program.

use std::path::Path;

/// Cause of a failure; it determines the exit code of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Cause {
    /// A file or folder cannot be read.
    Read,
    /// A file or folder cannot be written.
    Write,
    /// A server cannot be reached, or does not have the expected file.
    Network,
    /// A file is damaged or is not of the expected format.
    Format,
    /// The contents of a file exceed a limit.
    TooLarge,
    /// Sizes or shapes do not match.
    Shape,
    /// A setting is unknown or out of range.
    Config,
    /// Network weights do not match the network.
    Weights,
    /// A compute device cannot be used.
    Device,
    /// The least-squares problem has no solution.
    Fit,
}

/// An error: its cause, one sentence that states what is wrong and where, and often a hint.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct Error {
    cause: Cause,
    message: String,
    hint: Option<String>,
    source: Option<Box<dyn std::error::Error + Send + Sync>>,
}

/// A result with this error.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Creates an error with a cause; `message` is one sentence without a full stop.
    pub fn new(cause: Cause, message: impl Into<String>) -> Self {
        Self {
            cause,
            message: message.into(),
            hint: None,
            source: None,
        }
    }

    /// Returns the error for a `path` that cannot be read.
    pub fn read(path: &Path, source: std::io::Error) -> Self {
        Self::new(Cause::Read, format!("cannot read `{}`", path.display())).because(source)
    }

    /// Returns the error for a `path` that cannot be written.
    pub fn write(path: &Path, source: std::io::Error) -> Self {
        Self::new(Cause::Write, format!("cannot write `{}`", path.display())).because(source)
    }

    /// Returns the error for a `path` that is damaged or not of the expected format.
    pub fn format(path: &Path, what: impl std::fmt::Display) -> Self {
        Self::new(Cause::Format, format!("`{}`: {what}", path.display()))
    }

    /// Returns the error for sizes or shapes that do not match.
    pub fn shape(message: impl Into<String>) -> Self {
        Self::new(Cause::Shape, message)
    }

    /// Returns the error for a setting that is unknown or out of range.
    pub fn config(message: impl Into<String>) -> Self {
        Self::new(Cause::Config, message)
    }

    /// Returns the error for weights that do not match the network.
    pub fn weights(message: impl Into<String>) -> Self {
        Self::new(Cause::Weights, message)
    }

    /// Returns the error for a compute device that cannot be used.
    pub fn device(message: impl Into<String>) -> Self {
        Self::new(Cause::Device, message)
    }

    /// Returns the error for a least-squares problem without a solution.
    pub fn fit(message: impl Into<String>) -> Self {
        Self::new(Cause::Fit, message)
    }

    /// Adds a hint on what to do.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Adds the underlying error.
    #[must_use]
    pub fn because(mut self, source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        self.source = Some(source.into());
        self
    }

    /// Converts an error of the core; `what` names the file or setting.
    pub fn of_core(error: lsdc_core::Error, what: impl std::fmt::Display) -> Self {
        let inner = Self::from(error);
        Self {
            message: format!("{what}: {}", inner.message),
            ..inner
        }
    }

    /// Returns the cause.
    pub fn cause(&self) -> Cause {
        self.cause
    }

    /// Returns the error and its sources on one line.
    pub fn with_causes(&self) -> String {
        let mut text = self.message.clone();
        let mut source = std::error::Error::source(self);
        while let Some(cause) = source {
            let line = cause.to_string();
            text.push_str(": ");
            text.push_str(line.lines().next().unwrap_or_default());
            source = cause.source();
        }
        text
    }

    /// Returns the hint on what to do, if there is one.
    pub fn advice(&self) -> Option<&str> {
        self.hint.as_deref()
    }
}

impl From<lsdc_core::Error> for Error {
    fn from(error: lsdc_core::Error) -> Self {
        use lsdc_core::{Error as Core, WeightsError};
        let cause = match &error {
            Core::Image(_) => Cause::Shape,
            Core::Weights(WeightsError::Read { .. }) => Cause::Read,
            Core::Weights(_) => Cause::Weights,
            Core::Settings(_) => Cause::Config,
            _ => Cause::Fit,
        };
        let (message, hint) = (error.to_string(), error.hint().map(str::to_owned));
        let mut found = Self::new(cause, message);
        found.hint = hint;
        match std::error::Error::source(&error).map(ToString::to_string) {
            Some(source) => found.because(source),
            None => found,
        }
    }
}

macro_rules! through_the_core {
    ($($kind:ident)*) => {$(
        impl From<lsdc_core::$kind> for Error {
            fn from(error: lsdc_core::$kind) -> Self {
                lsdc_core::Error::from(error).into()
            }
        }
    )*};
}

through_the_core!(FitError ImageError SettingsError WeightsError);
