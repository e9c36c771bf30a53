//! Requests until their computation: the head is checked, a slot of the queue taken, then the body read.

use crate::app::App;
use crate::body::Incoming;
use crate::fault::{Fault, FaultKind};
use crate::header_text;
use crate::media_type::MediaType;
use crate::metrics::Scalar;
use crate::upload::Upload;
use crate::worker_pool::QueueSlot;
use axum::body::Body;
use axum::http::{HeaderMap, header};
use std::sync::Arc;
use tokio::runtime::Handle;

/// A request with its slot of the queue, whose body has not been read.
pub(crate) struct Request {
    /// The media type of its answer.
    pub(crate) media_type: MediaType,
    app: Arc<App>,
    content_type: String,
    body: Incoming,
    slot: QueueSlot,
}

impl Request {
    /// Checks the head, and takes a slot.
    ///
    /// # Errors
    /// No such media type; a body that is too large; no slot. What is sent all the same is read and dropped.
    pub(crate) async fn new(
        app: &Arc<App>,
        headers: &HeaderMap,
        body: Body,
    ) -> Result<Self, Fault> {
        let mut body = Incoming::new(body, &app.config.limits);
        match checked(app, headers, &body) {
            Ok((media_type, slot)) => Ok(Self {
                media_type,
                app: app.clone(),
                content_type: header_text(headers, header::CONTENT_TYPE)
                    .unwrap_or_default()
                    .to_owned(),
                body,
                slot,
            }),
            Err(fault) => Err(refused(&mut body, fault).await),
        }
    }

    /// Reads the body, on a thread that may block: forms are parsed there and their parts written to files.
    ///
    /// # Errors
    /// Those of the work; a panic in it. What is refused gives its slot back before the rest of it is read.
    pub(crate) async fn read<T: Send + 'static>(
        self,
        work: impl FnOnce(&mut Receiver<'_>) -> Result<T, Fault> + Send + 'static,
    ) -> Result<(T, QueueSlot), Fault> {
        let Self {
            app,
            content_type,
            mut body,
            slot,
            ..
        } = self;
        let runtime = Handle::current();
        let done = tokio::task::spawn_blocking(move || {
            let found = work(&mut Receiver {
                runtime,
                content_type: &content_type,
                body: &mut body,
            });
            (found.map(|found| (found, slot)), body)
        });
        match done.await {
            Ok((Ok(found), _)) => Ok(found),
            Ok((Err(fault), mut body)) => Err(refused(&mut body, fault).await),
            Err(_) => {
                app.metrics.add(Scalar::Panics, 1);
                Err(Fault::failed())
            }
        }
    }
}

/// The body of a request, for a thread that may block.
pub(crate) struct Receiver<'a> {
    runtime: Handle,
    content_type: &'a str,
    body: &'a mut Incoming,
}

impl Receiver<'_> {
    /// Whether the body is JSON, and no form.
    pub(crate) fn is_json(&self) -> bool {
        let essence = self.content_type.split(';').next().unwrap_or_default();
        essence.trim().eq_ignore_ascii_case("application/json")
    }

    /// A form with these parts, each of which may be missing.
    ///
    /// # Errors
    /// As for [`Upload::read`].
    pub(crate) fn form(&mut self, known: &[&'static str]) -> Result<Upload, Fault> {
        let read = Upload::read(self.content_type, self.body, known);
        self.runtime.block_on(read)
    }

    /// Reads all bytes.
    ///
    /// # Errors
    /// As for [`Incoming::next`].
    pub(crate) fn whole(&mut self) -> Result<Vec<u8>, Fault> {
        self.runtime.block_on(self.body.whole())
    }
}

fn checked(
    app: &App,
    headers: &HeaderMap,
    body: &Incoming,
) -> Result<(MediaType, QueueSlot), Fault> {
    // A header that is not text accepts no known type.
    let accept = headers.get(header::ACCEPT);
    let accept = accept.map(|value| value.to_str().unwrap_or_default());
    let media_type = MediaType::accepted(accept)?;
    let length = header_text(headers, header::CONTENT_LENGTH);
    body.check(length.and_then(|length| length.parse().ok()))?;
    Ok((media_type, app.pool.slot()?))
}

/// A request that is refused, whose body is read to its end so that its client hears of it.
async fn refused(body: &mut Incoming, fault: Fault) -> Fault {
    if fault.kind != FaultKind::Slow {
        body.linger().await;
    }
    fault
}
