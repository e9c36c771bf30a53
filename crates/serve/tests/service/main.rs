//! The service as a client meets it, on the loopback.

#![allow(clippy::unwrap_used)]

mod access;
mod answers;
mod bounds;
mod client;
mod life;
mod page;
mod scenes;
