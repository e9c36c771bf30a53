//! Counts and times, in the text format of Prometheus (version 0.0.4).

use crate::fault::Kind;
use crate::part::Part;
use std::collections::BTreeMap;
use std::fmt::{Display, Write as _};
use std::sync::atomic::{AtomicI64, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Upper ends of the bins of request times, in seconds.
const BINS: [f64; 10] = [0.01, 0.03, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0];

/// What a service counts.
#[derive(Debug, Default)]
pub(crate) struct Metrics {
    counts: Mutex<Counts>,
    waiting: AtomicUsize,
    working: AtomicI64,
    places: AtomicI64,
    connections: AtomicI64,
    closed: AtomicU64,
    panics: AtomicU64,
    scenes: AtomicUsize,
    scene_bytes: AtomicU64,
}

#[derive(Debug, Default)]
struct Counts {
    /// By method, route and status.
    requests: BTreeMap<(String, String, u16), u64>,
    /// Counts of the bins and of all, and the sum of seconds.
    times: ([u64; BINS.len()], u64, f64),
    rejected: BTreeMap<Kind, u64>,
    parts: BTreeMap<Part, (u64, f64)>,
}

impl Metrics {
    fn counts(&self) -> MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A request has been answered.
    pub(crate) fn add_request(
        &self,
        (method, route): (&str, &str),
        status: u16,
        time: Duration,
        fault: Option<Kind>,
    ) {
        let mut counts = self.counts();
        let key = (method.to_owned(), route.to_owned(), status);
        *counts.requests.entry(key).or_default() += 1;
        let seconds = time.as_secs_f64();
        for (count, end) in counts.times.0.iter_mut().zip(BINS) {
            *count += u64::from(seconds <= end);
        }
        counts.times.1 += 1;
        counts.times.2 += seconds;
        if let Some(kind) = fault {
            *counts.rejected.entry(kind).or_default() += 1;
        }
    }

    /// The client went before the answer.
    pub(crate) fn add_gone(&self) {
        *self.counts().rejected.entry(Kind::Gone).or_default() += 1;
    }

    pub(crate) fn add_part(&self, part: Part, time: Duration) {
        let mut counts = self.counts();
        let (count, seconds) = counts.parts.entry(part).or_default();
        *count += 1;
        *seconds += time.as_secs_f64();
    }

    pub(crate) fn set_waiting(&self, count: usize) {
        self.waiting.store(count, Ordering::Relaxed);
    }

    pub(crate) fn add_working(&self, change: i64) {
        self.working.fetch_add(change, Ordering::Relaxed);
    }

    pub(crate) fn add_places(&self, change: i64) {
        self.places.fetch_add(change, Ordering::Relaxed);
    }

    /// A connection that waited for a request was closed to make room.
    pub(crate) fn add_closed(&self) {
        self.closed.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn add_connections(&self, change: i64) {
        self.connections.fetch_add(change, Ordering::Relaxed);
    }

    pub(crate) fn panicked(&self) {
        self.panics.fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn set_scenes(&self, count: usize, bytes: u64) {
        self.scenes.store(count, Ordering::Relaxed);
        self.scene_bytes.store(bytes, Ordering::Relaxed);
    }

    /// All of it.
    pub(crate) fn text(&self) -> String {
        let counts = self.counts();
        let mut page = Page(String::new());
        page.family("requests_total", "counter", "Requests that were answered.");
        for ((method, route, status), count) in &counts.requests {
            page.line(
                "requests_total",
                &format!("method=\"{method}\",route=\"{route}\",status=\"{status}\""),
                count,
            );
        }
        page.family(
            "request_seconds",
            "histogram",
            "From the head of a request to that of its answer.",
        );
        let (bins, all, seconds) = &counts.times;
        for (count, end) in bins.iter().zip(BINS) {
            page.line("request_seconds_bucket", &format!("le=\"{end}\""), count);
        }
        page.line("request_seconds_bucket", "le=\"+Inf\"", all);
        page.line("request_seconds_sum", "", seconds);
        page.line("request_seconds_count", "", all);
        page.family("part_seconds", "summary", "Parts of the computations.");
        for (part, (count, seconds)) in &counts.parts {
            let label = format!("part=\"{}\"", part.name());
            page.line("part_seconds_sum", &label, seconds);
            page.line("part_seconds_count", &label, count);
        }
        page.family("rejected_total", "counter", "Requests that were refused.");
        for (kind, count) in &counts.rejected {
            let label = format!("reason=\"{}\"", kind.name());
            page.line("rejected_total", &label, count);
        }
        drop(counts);
        let panics = self.panics.load(Ordering::Relaxed);
        page.single("panics_total", "counter", "Panics, all caught.", panics);
        let waiting = self.waiting.load(Ordering::Relaxed);
        page.single("queue", "gauge", "Computations that wait.", waiting);
        let working = self.working.load(Ordering::Relaxed);
        page.single("working", "gauge", "Computations that run.", working);
        let places = self.places.load(Ordering::Relaxed);
        let what = "Requests from the head to the end of the answer, of those that compute.";
        page.single("places", "gauge", what, places);
        let open = self.connections.load(Ordering::Relaxed);
        page.single("connections", "gauge", "Open connections.", open);
        let closed = self.closed.load(Ordering::Relaxed);
        let what = "Connections without a request that were closed to make room.";
        page.single("closed_idle_total", "counter", what, closed);
        let scenes = self.scenes.load(Ordering::Relaxed);
        page.single("scenes", "gauge", "Scenes that are kept.", scenes);
        let bytes = self.scene_bytes.load(Ordering::Relaxed);
        page.single("scene_bytes", "gauge", "Their size, about.", bytes);
        page.0
    }
}

/// Text in the format of Prometheus. Writing to a string does not fail.
struct Page(String);

impl Page {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(
            self.0,
            "# HELP lsdc_{name} {help}\n# TYPE lsdc_{name} {kind}"
        );
    }

    fn line(&mut self, name: &str, labels: &str, value: impl Display) {
        let _ = if labels.is_empty() {
            writeln!(self.0, "lsdc_{name} {value}")
        } else {
            writeln!(self.0, "lsdc_{name}{{{labels}}} {value}")
        };
    }

    fn single(&mut self, name: &str, kind: &str, help: &str, value: impl Display) {
        self.family(name, kind, help);
        self.line(name, "", value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_cumulative() {
        let metrics = Metrics::default();
        for millis in [5, 50, 50, 40_000] {
            let time = Duration::from_millis(millis);
            metrics.add_request(("GET", "/healthz"), 200, time, None);
        }
        let text = metrics.text();
        for line in [
            "lsdc_requests_total{method=\"GET\",route=\"/healthz\",status=\"200\"} 4",
            "lsdc_request_seconds_bucket{le=\"0.01\"} 1",
            "lsdc_request_seconds_bucket{le=\"0.1\"} 3",
            "lsdc_request_seconds_bucket{le=\"30\"} 3",
            "lsdc_request_seconds_bucket{le=\"+Inf\"} 4",
            "lsdc_request_seconds_count 4",
        ] {
            assert!(text.lines().any(|found| found == line), "{line}\n{text}");
        }
    }
}
