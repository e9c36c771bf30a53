//! Errors of calls, which JavaScript throws.

use serde::Serialize;
use std::error::Error as _;

pub(crate) type Result<T, E = Error> = std::result::Result<T, E>;

/// Kinds of errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Kind {
    /// The size or the length of an image is wrong.
    Image,
    /// A weights file cannot be used.
    Weights,
    /// An option that is unknown or out of range.
    Settings,
    /// The points do not determine a depth map.
    Fit,
    /// The number of a freed scene, or a call out of order: a bug in the JavaScript.
    Use,
}

/// A failed call: a message of one sentence, and a hint.
#[derive(Debug, Serialize)]
pub(crate) struct Error {
    pub(crate) kind: Kind,
    message: String,
    hint: Option<String>,
}

impl Error {
    pub(crate) fn new(kind: Kind, message: impl Into<String>) -> Self {
        Self {
            kind,
            message: message.into(),
            hint: None,
        }
    }

    pub(crate) fn with_hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Returns the error as JSON, for JavaScript.
    pub(crate) fn json(&self) -> String {
        // Names and texts can always be serialised.
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl From<lsdc_core::Error> for Error {
    fn from(error: lsdc_core::Error) -> Self {
        let kind = match &error {
            lsdc_core::Error::Image(_) => Kind::Image,
            lsdc_core::Error::Weights(_) => Kind::Weights,
            lsdc_core::Error::Settings(_) => Kind::Settings,
            // Future kinds count as errors of the fit until they are listed here.
            _ => Kind::Fit,
        };
        let mut message = error.to_string();
        let mut cause = error.source();
        while let Some(inner) = cause {
            message = format!("{message}: {inner}");
            cause = inner.source();
        }
        Self {
            kind,
            message,
            hint: error.hint().map(str::to_owned),
        }
    }
}
