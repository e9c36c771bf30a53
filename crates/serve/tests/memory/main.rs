//! Memory use of hostile requests, and of cached scenes.

#![allow(clippy::unwrap_used, clippy::print_stdout, unsafe_code)]

#[path = "../service/client.rs"]
#[allow(dead_code)]
mod client;
mod counted;
mod hostile;
mod requests;
mod scene;

use std::sync::Mutex;

/// Serialises measurements.
static ALONE: Mutex<()> = Mutex::new(());
