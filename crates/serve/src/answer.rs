//! Answers on their way out.

use crate::encode::EncodedAnswer;
use crate::worker_pool::QueueSlot;
use axum::body::Body;
use axum::http::{HeaderName, HeaderValue, Response, StatusCode, header};
use bytes::Bytes;
use hyper::body::{Frame, SizeHint};
use std::convert::Infallible;
use std::pin::Pin;
use std::task::{Context, Poll};

/// Bytes that are handed to the connection at a time.
const PIECE: usize = 64 << 10;

/// The header that holds the report, as one line of JSON, beside answers that have no room for it.
pub(crate) const REPORT: HeaderName = HeaderName::from_static("lsdc-report");

/// The answer of a completion, which keeps its slot of the queue until it has been fetched.
pub(crate) fn of(encoded: EncodedAnswer, slot: QueueSlot) -> Response<Body> {
    let media_type = encoded.media_type;
    let mut response = Response::new(Body::new(AnswerBody {
        unsent: encoded.bytes.into(),
        _slot: slot,
    }));
    let headers = response.headers_mut();
    let name = HeaderValue::from_static(media_type.name());
    headers.insert(header::CONTENT_TYPE, name);
    if let Some(name) = media_type.file() {
        let report = HeaderValue::try_from(encoded.report.header());
        headers.extend(report.ok().map(|report| (REPORT, report)));
        let named = HeaderValue::try_from(format!("attachment; filename=\"{name}\""));
        headers.extend(named.ok().map(|named| (header::CONTENT_DISPOSITION, named)));
    }
    response
}

/// JSON with a status.
pub(crate) fn json(status: StatusCode, value: &serde_json::Value) -> Response<Body> {
    let mut response = text("application/json", format!("{value}\n"));
    *response.status_mut() = status;
    response
}

/// Text of a type that does not change.
pub(crate) fn text(media: &'static str, text: impl Into<Body>) -> Response<Body> {
    let mut response = Response::new(text.into());
    let media = HeaderValue::from_static(media);
    response.headers_mut().insert(header::CONTENT_TYPE, media);
    response
}

/// Bytes that go out piece by piece, as the client takes them, and a slot that is released after the last.
struct AnswerBody {
    unsent: Bytes,
    _slot: QueueSlot,
}

impl hyper::body::Body for AnswerBody {
    type Data = Bytes;
    type Error = Infallible;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        _: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Infallible>>> {
        if self.unsent.is_empty() {
            return Poll::Ready(None);
        }
        let length = self.unsent.len().min(PIECE);
        Poll::Ready(Some(Ok(Frame::data(self.unsent.split_to(length)))))
    }

    fn is_end_stream(&self) -> bool {
        self.unsent.is_empty()
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::with_exact(self.unsent.len() as u64)
    }
}
