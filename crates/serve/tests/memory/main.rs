//! What requests cost in memory: hostile ones, and scenes that are kept.

#![allow(clippy::unwrap_used, clippy::print_stdout, unsafe_code)]

#[path = "../service/client.rs"]
#[allow(dead_code)]
mod client;
mod counted;
mod hostile;
mod requests;
mod scene;

use std::sync::Mutex;

/// One measurement at a time.
static ALONE: Mutex<()> = Mutex::new(());
