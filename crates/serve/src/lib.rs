//! Depth completion as a service over HTTP, and the page that shows it.
//!
//! Images and points come as forms, answers as JSON, PNG, EXR, npz or PLY. An image that is posted as a scene passes the
//! network once, whatever the number of its completions. Everything that a request can cost is [bounded](Limits),
//! computations run on threads of their own, and a request that panics is answered like any other failure. The
//! description of all addresses is at `/openapi.json`.
//!
//! ```no_run
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! use lsdc_core::{Completer, Weights};
//! use lsdc_serve::{Config, Server};
//!
//! let completer = Completer::new(&Weights::builtin())?;
//! let server = Server::bind(completer, "127.0.0.1:8080".parse()?, Config::default())?;
//! let handle = server.handle(); // ends it, from any thread
//! server.run()?;
//! # Ok(())
//! # }
//! ```
//!
//! Completion is that of `lsdc-core`, formats those of `lsdc-files`, weights come from `lsdc-weights`.

mod answer;
mod api;
mod app;
mod body;
mod complete;
mod computation;
mod config;
mod encode;
mod error;
mod fault;
mod frame;
#[doc(hidden)]
pub mod fuzzing;
mod guard;
mod idle;
mod layers;
mod media_type;
mod metrics;
mod observe;
mod options;
mod pace;
mod page;
mod points;
mod receive;
mod report;
mod routes;
mod scene_cache;
mod server;
mod spool;
mod tls;
mod upload;
mod worker_pool;

use axum::http::{HeaderMap, HeaderName};

pub use config::{Access, Config, Limits, Log, LogEntry, Tls, Trace};
pub use error::Error;
pub use page::{Asset, Demo, Page, Start};
pub use server::{Handle, Server};

/// The value of a header, if it is text.
fn header_text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

/// A name that cannot be guessed: 128 random bits in hexadecimal; none if the system has no random numbers.
fn random_name() -> Option<String> {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).ok()?;
    Some(format!("{:032x}", u128::from_be_bytes(bytes)))
}

/// A token that cannot be guessed.
///
/// # Errors
/// The system gives no random numbers.
pub fn random_token() -> Result<String, Error> {
    random_name().ok_or(Error::Random)
}
