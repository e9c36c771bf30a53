//! Why a call failed, as JavaScript throws it.

use serde::Serialize;
use std::error::Error as _;

pub(crate) type Result<T, E = Error> = std::result::Result<T, E>;

/// Kinds of errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Kind {
    /// The size or the length of an image.
    Image,
    /// A weights file.
    Weights,
    /// An option that is unknown or out of range.
    Settings,
    /// The points do not determine a depth map.
    Fit,
    /// A number of a scene that was freed, or a call out of order: an error of the JavaScript.
    Use,
}

/// A failed call: one sentence, and what to do about it.
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

    /// For JavaScript.
    pub(crate) fn json(&self) -> String {
        // Names and texts always have a form.
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl From<lsdc_core::Error> for Error {
    fn from(error: lsdc_core::Error) -> Self {
        let kind = match &error {
            lsdc_core::Error::Image(_) => Kind::Image,
            lsdc_core::Error::Weights(_) => Kind::Weights,
            lsdc_core::Error::Settings(_) => Kind::Settings,
            // Kinds that are added later are of the fit until they are listed here.
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
