//! Connections: accepted, bounded, made secure, served, and ended in good order.

use crate::app::App;
use crate::config::Config;
use crate::error::Error;
use crate::idle::{Busy, Client, IdleConnections};
use crate::metrics::Scalar;
use crate::pace::Paced;
use crate::{routes, spool, tls};
use axum::Router;
use axum::body::Body;
use bytes::Bytes;
use hyper::body::{Frame, SizeHint};
use hyper::server::conn::http1;
use hyper::service::{Service as _, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use lsdc_core::Completer;
use std::net::{SocketAddr, TcpListener};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::sync::{Semaphore, watch};
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval, timeout};
use tokio_rustls::TlsAcceptor;

/// Bytes of the head of a request, and of what is read and written at a time.
const BUFFER: usize = 64 << 10;
/// Lines of a head.
const LINES: usize = 64;
/// Threads that serve connections; none of them computes.
const THREADS: usize = 2;
/// Threads that may block beside those of bodies and computations: for the files of a gallery.
const OTHER_THREADS: usize = 512;
/// Interval between searches for unused scenes.
const TIDYING: Duration = Duration::from_secs(5);

/// A service that listens.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    app: Arc<App>,
    tls: Option<TlsAcceptor>,
    end: watch::Sender<bool>,
}

/// Ends a service from any thread.
#[derive(Clone, Debug)]
pub struct Handle(watch::Sender<bool>);

impl Handle {
    /// Ends the service: what has begun is finished, as long as that takes no longer than the limits allow.
    pub fn end(&self) {
        self.0.send_replace(true);
    }
}

impl Server {
    /// Listens on an address; port 0 is any that is free. Requests wait until the service [runs](Self::run). Uploads
    /// that killed services have left in the temporary folder are removed.
    ///
    /// # Errors
    /// An address that cannot be listened to, or that other machines reach without a token; a certificate that
    /// cannot be used.
    pub fn bind(completer: Completer, address: SocketAddr, config: Config) -> Result<Self, Error> {
        config.access.check(address)?;
        let tls = config.tls.as_ref().map(tls::acceptor).transpose()?;
        let failed = |source| Error::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let app = App::new(completer, config, address);
        spool::sweep();
        Ok(Self {
            listener,
            address,
            app: Arc::new(app),
            tls,
            end: watch::Sender::new(false),
        })
    }

    /// Address on which the service listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Returns a handle that stops the service.
    pub fn handle(&self) -> Handle {
        Handle(self.end.clone())
    }

    /// Serves until [`Handle::end`].
    ///
    /// # Errors
    /// Threads that cannot be started.
    pub fn run(self) -> Result<(), Error> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(THREADS)
            .max_blocking_threads(OTHER_THREADS + self.app.pool.max_threads())
            .thread_name("lsdc-serve")
            .enable_all()
            .build()
            .map_err(Error::Threads)?;
        runtime.block_on(self.serve())
    }

    async fn serve(self) -> Result<(), Error> {
        let listener = tokio::net::TcpListener::from_std(self.listener).map_err(Error::Threads)?;
        let limits = &self.app.config.limits;
        let room = Arc::new(Semaphore::new(limits.connections));
        let (mut end, mut connections) = (self.end.subscribe(), JoinSet::new());
        let router = routes::router(&self.app);
        let mut tidying = interval(TIDYING);
        tidying.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let idle = Arc::new(IdleConnections::default());
        // A connection that has been accepted and for which there is no room yet.
        let mut next: Option<TcpStream> = None;
        loop {
            tokio::select! {
                _ = end.wait_for(|end| *end) => break,
                _ = tidying.tick() => self.app.scenes.expire(Instant::now()),
                Some(_) = connections.join_next() => {}
                accepted = listener.accept(), if next.is_none() => match accepted {
                    Ok((stream, _)) => {
                        next = Some(stream);
                        if room.available_permits() == 0 {
                            idle.make_room();
                        }
                    }
                    // Out of descriptors, or a connection that has gone: it passes.
                    Err(_) => tokio::time::sleep(Duration::from_millis(50)).await,
                },
                Ok(place) = room.clone().acquire_owned(), if next.is_some() => {
                    idle.has_room();
                    let connection = Connection {
                        app: self.app.clone(),
                        router: router.clone(),
                        tls: self.tls.clone(),
                        end: self.end.subscribe(),
                        client: Client::new(&idle),
                    };
                    if let Some(stream) = next.take() {
                        connections.spawn(async move {
                            connection.serve(stream).await;
                            drop(place);
                        });
                    }
                }
            }
        }
        self.app.end();
        drop(listener);
        let finished = async { while connections.join_next().await.is_some() {} };
        let _ = timeout(limits.drain, finished).await;
        connections.shutdown().await;
        Ok(())
    }
}

/// A connection and what it needs.
struct Connection {
    app: Arc<App>,
    router: Router,
    tls: Option<TlsAcceptor>,
    end: watch::Receiver<bool>,
    client: Arc<Client>,
}

impl Connection {
    async fn serve(self, stream: TcpStream) {
        // Heads and bodies of answers go out at once.
        let _ = stream.set_nodelay(true);
        let (app, client) = (self.app.clone(), self.client.clone());
        let _counted = app.metrics.counted(Scalar::Connections);
        tokio::select! {
            () = self.secure(stream) => {}
            () = client.closed() => app.metrics.add(Scalar::ClosedIdle, 1),
        }
    }

    async fn secure(self, stream: TcpStream) {
        let limits = self.app.config.limits.clone();
        let stream = Paced::new(stream, limits.rate, limits.pace);
        match self.tls.clone() {
            None => self.speak(stream).await,
            Some(tls) => {
                if let Ok(Ok(stream)) = timeout(limits.head, tls.accept(stream)).await {
                    self.speak(stream).await;
                }
            }
        }
    }

    /// Speaks HTTP. What goes wrong is the client's affair: it has gone, was too slow, or speaks something else.
    async fn speak<S: AsyncRead + AsyncWrite + Unpin>(mut self, stream: S) {
        let router = TowerToHyperService::new(self.router);
        let service = service_fn(|request| {
            let busy = self.client.busy();
            let answer = router.call(request);
            async {
                let answer = answer.await;
                answer.map(|answer| answer.map(|body| BusyBody { body, _busy: busy }))
            }
        });
        let connection = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(self.app.config.limits.head)
            .max_buf_size(BUFFER)
            .max_headers(LINES)
            .max_header_size(BUFFER)
            .serve_connection(TokioIo::new(stream), service);
        let mut connection = std::pin::pin!(connection);
        let ended = tokio::select! {
            _ = connection.as_mut() => return,
            ended = self.end.wait_for(|end| *end) => ended.is_ok(),
        };
        if ended {
            connection.as_mut().graceful_shutdown();
            let _ = connection.await;
        }
    }
}

/// The body of an answer. Its connection is busy until the last of it has been handed over.
struct BusyBody {
    body: Body,
    _busy: Busy,
}

impl hyper::body::Body for BusyBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(cx)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
