//! Bodies of requests, as they come in: bounded in size, and dropped where they come too slowly.

use crate::config::Limits;
use crate::fault::{Fault, FaultKind};
use axum::body::{Body, BodyDataStream};
use bytes::Bytes;
use futures_util::{Stream, StreamExt as _, stream};
use std::time::Duration;
use tokio::time::Instant;

/// A body that is being read.
pub(crate) struct Incoming {
    stream: BodyDataStream,
    limit: u64,
    read: u64,
    pace: Duration,
    /// Bytes in the time of a pace.
    least: u64,
    /// When the present pace ends, and the bytes of it so far.
    end: Instant,
    within: u64,
}

impl Incoming {
    pub(crate) fn new(body: Body, limits: &Limits) -> Self {
        Self {
            stream: body.into_data_stream(),
            limit: limits.body,
            read: 0,
            pace: limits.pace,
            least: (limits.rate as f64 * limits.pace.as_secs_f64()) as u64,
            end: Instant::now() + limits.pace,
            within: 0,
        }
    }

    /// Refuses a body that its head declares to be longer than what is read.
    ///
    /// # Errors
    /// It is.
    pub(crate) fn check(&self, declared: Option<u64>) -> Result<(), Fault> {
        match declared {
            Some(bytes) if bytes > self.limit => Err(self.too_large()),
            _ => Ok(()),
        }
    }

    fn too_large(&self) -> Fault {
        Fault::too_large(format!("a request has at most {} bytes", self.limit))
    }

    /// The next bytes; none at the end.
    ///
    /// # Errors
    /// More bytes than are read, or too few in a time; a client that has gone.
    pub(crate) async fn next(&mut self) -> Result<Option<Bytes>, Fault> {
        let next = tokio::time::timeout_at(self.end, self.stream.next()).await;
        let next = next.map_err(|_| {
            Fault::new(FaultKind::Slow, "the request came too slowly")
                .hint("send it again over a better connection")
        })?;
        let Some(chunk) = next else {
            return Ok(None);
        };
        let chunk = chunk.map_err(|_| Fault::malformed("the request ended before its body did"))?;
        self.read += chunk.len() as u64;
        self.within += chunk.len() as u64;
        if self.read > self.limit {
            return Err(self.too_large());
        }
        if self.within >= self.least {
            self.end = Instant::now() + self.pace;
            self.within = 0;
        }
        Ok(Some(chunk))
    }

    /// Reads the whole body.
    ///
    /// # Errors
    /// As for [`Self::next`].
    pub(crate) async fn whole(&mut self) -> Result<Vec<u8>, Fault> {
        let mut all = Vec::new();
        while let Some(chunk) = self.next().await? {
            all.extend_from_slice(&chunk);
        }
        Ok(all)
    }

    /// Turns the body into a stream, which ends after a fault.
    pub(crate) fn stream(&mut self) -> impl Stream<Item = Result<Bytes, Fault>> + Send {
        stream::unfold(Some(self), |body| async {
            let body = body?;
            match body.next().await.transpose()? {
                Ok(chunk) => Some((Ok(chunk), Some(body))),
                Err(fault) => Some((Err(fault), None)),
            }
        })
    }

    /// Reads what is left, as far as it would have been taken, for a client that is still sending would not see that
    /// it is refused.
    pub(crate) async fn linger(&mut self) {
        self.limit = self.limit.saturating_add(self.read);
        while let Ok(Some(_)) = self.next().await {}
    }
}
