//! Frames that could not be completed.

use crate::cli::ui;
use indicatif::ProgressBar;
use lsdc_files::error::Error;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::Mutex;

/// Frames that could not be completed: said at once, counted for the end.
#[derive(Default)]
pub(super) struct Failures {
    count: Mutex<usize>,
    json: bool,
    bar: Option<ProgressBar>,
}

impl Failures {
    /// Says each on stderr, and with `json` as an object on stdout too.
    pub(super) fn new(json: bool) -> Self {
        Self {
            json,
            ..Self::default()
        }
    }

    /// Goes on beside a bar, which steps with every failure.
    pub(super) fn beside(self, bar: &ProgressBar) -> Self {
        Self {
            bar: Some(bar.clone()),
            ..self
        }
    }

    pub(super) fn add(&self, name: &Path, error: &Error) {
        let say = || {
            if self.json {
                ui::print(&failure(name, error).to_string());
            }
            ui::print_failure(name, error);
        };
        if let Some(bar) = &self.bar {
            bar.suspend(say);
            bar.inc(1);
        } else {
            say();
        }
        if let Ok(mut count) = self.count.lock() {
            *count += 1;
        }
    }

    pub(super) fn count(&self) -> usize {
        self.count.lock().map_or(0, |count| *count)
    }
}

/// JSON object of a frame that could not be completed.
pub(super) fn failure(name: &Path, error: &Error) -> Value {
    json!({
        "image": name.display().to_string(),
        "status": "failed",
        "error": error.with_causes(),
        "hint": error.advice(),
    })
}
