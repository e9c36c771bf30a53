//! The service as seen by a client on the loopback interface.

#![allow(clippy::unwrap_used)]

mod access;
mod answers;
mod bounds;
mod client;
mod life;
mod page;
mod scenes;
