//! Connections whose clients must fetch what they have asked for.

use std::io::{Error, ErrorKind, IoSlice, Result};
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep, sleep};

/// A connection that fails once its client has taken too few bytes in a time in which there was something to take.
pub(crate) struct Paced<S> {
    stream: S,
    pace: Duration,
    /// Bytes in this time.
    least: usize,
    /// Since when the client has been behind, and the bytes that it has taken since.
    behind: Option<Pin<Box<Sleep>>>,
    taken: usize,
}

impl<S> Paced<S> {
    /// At `rate` bytes a second, measured over `pace`.
    pub(crate) fn new(stream: S, rate: u64, pace: Duration) -> Self {
        Self {
            stream,
            pace,
            least: (rate as f64 * pace.as_secs_f64()) as usize,
            behind: None,
            taken: 0,
        }
    }

    /// Notes what a write did: the time begins with the first that has to wait, and ends when enough was taken.
    fn note(&mut self, cx: &mut Context<'_>, written: Poll<Result<usize>>) -> Poll<Result<usize>> {
        match written {
            Poll::Ready(Ok(count)) => {
                self.taken = self.taken.saturating_add(count);
                if self.taken >= self.least {
                    (self.behind, self.taken) = (None, 0);
                }
                Poll::Ready(Ok(count))
            }
            Poll::Ready(Err(error)) => Poll::Ready(Err(error)),
            Poll::Pending => {
                if self.behind.is_none() {
                    (self.behind, self.taken) = (Some(Box::pin(sleep(self.pace))), 0);
                }
                self.check(cx)
            }
        }
    }

    fn check<T>(&mut self, cx: &mut Context<'_>) -> Poll<Result<T>> {
        let Some(behind) = &mut self.behind else {
            return Poll::Pending;
        };
        ready!(behind.as_mut().poll(cx));
        // Anew, should anybody ask again.
        behind.as_mut().reset(Instant::now() + self.pace);
        Poll::Ready(Err(Error::new(
            ErrorKind::TimedOut,
            "the client fetches too slowly",
        )))
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Paced<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Paced<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.note(cx, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, slices);
        self.note(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Result<()>> {
        match Pin::new(&mut self.stream).poll_flush(cx) {
            Poll::Pending => {
                let flushed = self.note(cx, Poll::Pending);
                flushed.map(|result| result.map(|_| ()))
            }
            flushed @ Poll::Ready(_) => flushed,
        }
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _, duplex};

    /// Time on the paused clock, which advances only while all tasks wait.
    const PACE: Duration = Duration::from_secs(10);

    #[tokio::test(start_paused = true)]
    async fn a_client_that_takes_nothing_is_dropped() {
        let (own, _client) = duplex(64);
        let mut paced = Paced::new(own, 1000, PACE);
        let error = paced.write_all(&[0; 1000]).await.unwrap_err();
        assert_eq!(error.kind(), ErrorKind::TimedOut);
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_that_takes_a_little_now_and_then_is_dropped() {
        let (own, mut client) = duplex(64);
        let mut paced = Paced::new(own, 1_000_000, PACE);
        let take = async {
            let mut byte = [0];
            while client.read_exact(&mut byte).await.is_ok() {
                tokio::time::sleep(PACE / 10).await;
            }
        };
        let send = async {
            let error = paced.write_all(&[0; 10_000]).await.unwrap_err();
            assert_eq!(error.kind(), ErrorKind::TimedOut);
            drop(paced);
        };
        tokio::join!(send, take);
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_that_keeps_up_gets_all() {
        let (own, mut client) = duplex(64);
        let mut paced = Paced::new(own, 1000, PACE);
        let take = async {
            let mut all = Vec::new();
            client.read_to_end(&mut all).await.unwrap();
            all
        };
        let send = async {
            paced.write_all(&vec![7; 100_000]).await.unwrap();
            drop(paced);
        };
        let ((), all) = tokio::join!(send, take);
        assert_eq!(all, vec![7; 100_000]);
    }
}
