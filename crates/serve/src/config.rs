//! Limits and access of a service.

use crate::page::Page;
use serde::Serialize;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// The settings of a service.
#[derive(Clone, Default)]
pub struct Config {
    /// Limits of a request, and of all requests together.
    pub limits: Limits,
    /// Access control.
    pub access: Access,
    /// A certificate, for HTTPS.
    pub tls: Option<Tls>,
    /// The name of the weights, for clients to read.
    pub weights: String,
    /// The page, if it is shown.
    pub page: Option<Page>,
    /// Is told of every request when it has been answered.
    pub log: Option<Log>,
    /// Is called before each part of a computation, in its thread, with the name of the part: for traces. A panic in
    /// it is one of the request.
    pub trace: Option<Trace>,
}

/// Is told of every request.
pub type Log = Arc<dyn Fn(&LogEntry) + Send + Sync>;

/// Is called before each stage of a computation.
pub type Trace = Arc<dyn Fn(&str) + Send + Sync>;

/// Log entry of a request, without any of its contents.
#[derive(Clone, Debug, Serialize)]
#[non_exhaustive]
pub struct LogEntry {
    /// Seconds since 1970.
    pub time: f64,
    /// The name of the request, as in its answer.
    pub request: String,
    /// GET, POST or DELETE.
    pub method: String,
    /// The path, without names of scenes.
    pub route: String,
    /// The status of the answer.
    pub status: u16,
    /// From the head of the request to that of the answer.
    pub seconds: f64,
    /// Why it was not answered as requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fault: Option<&'static str>,
}

/// Bounds. More is refused with a status that says so.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Bytes of a request.
    pub body: u64,
    /// Pixels of an image, as its head declares them.
    pub pixels: usize,
    /// Points of a request.
    pub points: usize,
    /// Bytes that a compressed file may unfold to.
    pub unfolded: u64,
    /// Requests whose bodies are being read, that wait for a thread, or whose answers are being fetched, beyond those
    /// that are worked on.
    pub queue: usize,
    /// Computations at a time; 0 is one for each core.
    pub workers: usize,
    /// Connections at a time. Where there are more, those that wait longest for a request are closed; if none waits, the
    /// others are accepted later.
    pub connections: usize,
    /// Time for the head of a request.
    pub head: Duration,
    /// Bytes a second that a client must send or fetch, on average over `pace`.
    pub rate: u64,
    /// The time over which the rate is measured.
    pub pace: Duration,
    /// Time for a computation, from its place in the queue to its answer.
    pub request: Duration,
    /// Time for what has begun when the service is to end.
    pub drain: Duration,
    /// Bytes of all scenes that are kept; the least recently used make room.
    pub scenes: u64,
    /// Lifetime of an unused scene.
    pub expiry: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            body: 64 << 20,
            pixels: 50_000_000,
            points: 2_000_000,
            unfolded: 512 << 20,
            queue: 32,
            workers: 0,
            connections: 256,
            head: Duration::from_secs(10),
            rate: 4 << 10,
            pace: Duration::from_secs(10),
            request: Duration::from_mins(1),
            drain: Duration::from_secs(30),
            scenes: 2 << 30,
            expiry: Duration::from_mins(10),
        }
    }
}

/// Access control.
#[derive(Clone, Debug, Default)]
pub struct Access {
    /// Token that clients must send as `Authorization: Bearer TOKEN`.
    pub token: Option<String>,
    /// Whether clients of other machines may ask without a token.
    pub open: bool,
}

/// A certificate with its chain, and its key, as PEM files.
#[derive(Clone, Debug)]
pub struct Tls {
    /// The certificate and those above it.
    pub certificate: PathBuf,
    /// The private key.
    pub key: PathBuf,
}

/// Shorter tokens can be guessed.
const SHORTEST_TOKEN: usize = 16;

impl Access {
    /// Checks that the service does not stand open to other machines unless that is meant.
    pub(crate) fn check(&self, address: SocketAddr) -> Result<(), crate::Error> {
        match &self.token {
            Some(token) if token.len() < SHORTEST_TOKEN => Err(crate::Error::Token(SHORTEST_TOKEN)),
            Some(token) if !token.bytes().all(|b| b.is_ascii_graphic()) => {
                Err(crate::Error::TokenCharacters)
            }
            None if !address.ip().is_loopback() && !self.open => Err(crate::Error::Open(address)),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_machines_need_a_token_or_a_word() {
        let access = |token: Option<&str>, open| Access {
            token: token.map(str::to_owned),
            open,
        };
        let check = |access: Access, address: &str| access.check(address.parse().unwrap()).is_ok();
        let token = Some("0123456789abcdef");
        for loopback in ["127.0.0.1:1", "127.9.9.9:1", "[::1]:1"] {
            assert!(check(access(None, false), loopback), "{loopback}");
        }
        for other in ["0.0.0.0:1", "[::]:1", "192.168.1.7:1"] {
            assert!(!check(access(None, false), other), "{other}");
            assert!(check(access(token, false), other), "{other}");
            assert!(check(access(None, true), other), "{other}");
        }
        assert!(!check(access(Some("short"), true), "127.0.0.1:1"));
        assert!(!check(
            access(Some("0123456789 abcdef"), true),
            "127.0.0.1:1"
        ));
    }
}
