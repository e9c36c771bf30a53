//! Why a request is not answered as asked: a status, one sentence, and what to do.

use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use lsdc_files::error::Cause;
use std::time::Duration;

/// The kinds of faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum FaultKind {
    /// The request is no multipart, JSON or list of points.
    Malformed,
    /// The token is missing or wrong.
    Unknown,
    /// A page of another site asks.
    Foreign,
    /// There is no such thing.
    NotFound,
    /// Not by this method.
    Method,
    /// No answer of this media type.
    NotAcceptable,
    /// The client sends too slowly.
    Slow,
    /// A limit is exceeded.
    TooLarge,
    /// A kind of file that is not read.
    Unsupported,
    /// Sound, but no depth can be made of it.
    Unusable,
    /// Too much is waiting already.
    Full,
    /// Something here went wrong.
    Failed,
    /// It took too long.
    Late,
    /// The client has gone, or the service ends.
    Gone,
}

impl FaultKind {
    /// The name in logs and metrics, and the status of the answer.
    fn name_and_status(self) -> (&'static str, StatusCode) {
        match self {
            Self::Malformed => ("malformed", StatusCode::BAD_REQUEST),
            Self::Unknown => ("unknown", StatusCode::UNAUTHORIZED),
            Self::Foreign => ("foreign", StatusCode::FORBIDDEN),
            Self::NotFound => ("not-found", StatusCode::NOT_FOUND),
            Self::Method => ("method", StatusCode::METHOD_NOT_ALLOWED),
            Self::NotAcceptable => ("not-acceptable", StatusCode::NOT_ACCEPTABLE),
            Self::Slow => ("slow", StatusCode::REQUEST_TIMEOUT),
            Self::TooLarge => ("too-large", StatusCode::PAYLOAD_TOO_LARGE),
            Self::Unsupported => ("unsupported", StatusCode::UNSUPPORTED_MEDIA_TYPE),
            Self::Unusable => ("unusable", StatusCode::UNPROCESSABLE_ENTITY),
            Self::Full => ("full", StatusCode::TOO_MANY_REQUESTS),
            Self::Failed => ("failed", StatusCode::INTERNAL_SERVER_ERROR),
            Self::Late => ("late", StatusCode::SERVICE_UNAVAILABLE),
            Self::Gone => ("gone", StatusCode::SERVICE_UNAVAILABLE),
        }
    }

    pub(crate) fn name(self) -> &'static str {
        self.name_and_status().0
    }

    pub(crate) fn status(self) -> StatusCode {
        self.name_and_status().1
    }
}

/// A fault: its kind, one sentence that says what is wrong, and often what to do.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{message}")]
pub(crate) struct Fault {
    pub(crate) kind: FaultKind,
    pub(crate) message: String,
    pub(crate) hint: Option<String>,
    /// When to ask again.
    pub(crate) retry: Option<Duration>,
}

impl Fault {
    pub(crate) fn new(kind: FaultKind, message: impl Into<String>) -> Self {
        Self {
            kind,
            message: message.into(),
            hint: None,
            retry: None,
        }
    }

    pub(crate) fn malformed(message: impl Into<String>) -> Self {
        Self::new(FaultKind::Malformed, message)
    }

    pub(crate) fn too_large(message: impl Into<String>) -> Self {
        Self::new(FaultKind::TooLarge, message)
    }

    pub(crate) fn unusable(message: impl Into<String>) -> Self {
        Self::new(FaultKind::Unusable, message)
    }

    /// An internal error, whose cause is logged and not sent to the client.
    pub(crate) fn failed() -> Self {
        Self::new(
            FaultKind::Failed,
            "the service failed; this is an error in it",
        )
    }

    pub(crate) fn hint(self, hint: impl Into<String>) -> Self {
        Self {
            hint: Some(hint.into()),
            ..self
        }
    }

    pub(crate) fn retry(self, after: Duration) -> Self {
        Self {
            retry: Some(after),
            ..self
        }
    }
}

impl From<lsdc_files::error::Error> for Fault {
    fn from(error: lsdc_files::error::Error) -> Self {
        let kind = match error.cause() {
            Cause::TooLarge => FaultKind::TooLarge,
            Cause::Format | Cause::Shape | Cause::Config | Cause::Fit => FaultKind::Unusable,
            _ => FaultKind::Failed,
        };
        Self {
            hint: error.advice().map(str::to_owned),
            ..Self::new(kind, error.with_causes())
        }
    }
}

impl From<lsdc_core::Error> for Fault {
    fn from(error: lsdc_core::Error) -> Self {
        lsdc_files::error::Error::from(error).into()
    }
}

impl IntoResponse for Fault {
    /// Without a body: what observes the request adds it, as it knows the request's name.
    fn into_response(self) -> Response {
        let mut response = self.kind.status().into_response();
        response.extensions_mut().insert(self);
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_client_sent_is_no_failure_of_the_service() {
        let error = lsdc_core::Image::new(0, 3, lsdc_core::Channels::Rgb, &[]).unwrap_err();
        assert_eq!(Fault::from(error).kind, FaultKind::Unusable);
        let path = std::path::Path::new("image");
        let error = lsdc_files::error::Error::read(path, std::io::ErrorKind::NotFound.into());
        assert_eq!(Fault::from(error).kind, FaultKind::Failed);
    }
}
