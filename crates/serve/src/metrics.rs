//! Counts and times, in the text format of Prometheus (version 0.0.4).

use crate::computation::Stage;
use crate::fault::FaultKind;
use std::collections::BTreeMap;
use std::fmt::{Display, Write as _};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Upper ends of the bins of request times, in seconds.
const BINS: [f64; 10] = [0.01, 0.03, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0];

/// The metrics without labels, in the order of [`SCALARS`].
#[derive(Clone, Copy, Debug)]
pub(crate) enum Scalar {
    Panics,
    Waiting,
    Working,
    QueueSlots,
    Connections,
    ClosedIdle,
    Scenes,
    SceneBytes,
}

/// Name, type and description of each.
const SCALARS: [(&str, &str, &str); 8] = [
    ("panics_total", "counter", "Panics, all caught."),
    ("queue", "gauge", "Computations that wait."),
    ("working", "gauge", "Computations that run."),
    (
        "places",
        "gauge",
        "Requests from the head to the end of the answer, of those that compute.",
    ),
    ("connections", "gauge", "Open connections."),
    (
        "closed_idle_total",
        "counter",
        "Connections without a request that were closed to make room.",
    ),
    ("scenes", "gauge", "Scenes that are kept."),
    ("scene_bytes", "gauge", "Their size, about."),
];

/// Counters of a service.
#[derive(Debug, Default)]
pub(crate) struct Metrics {
    counts: Mutex<Counts>,
    scalars: [AtomicI64; SCALARS.len()],
}

#[derive(Debug, Default)]
struct Counts {
    /// By method, route and status.
    requests: BTreeMap<(String, String, u16), u64>,
    /// Counts of the bins and of all, and the sum of seconds.
    times: ([u64; BINS.len()], u64, f64),
    rejected: BTreeMap<FaultKind, u64>,
    stages: BTreeMap<Stage, (u64, f64)>,
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
        fault: Option<FaultKind>,
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
        *self.counts().rejected.entry(FaultKind::Gone).or_default() += 1;
    }

    pub(crate) fn add_stage(&self, stage: Stage, time: Duration) {
        let mut counts = self.counts();
        let (count, seconds) = counts.stages.entry(stage).or_default();
        *count += 1;
        *seconds += time.as_secs_f64();
    }

    pub(crate) fn add(&self, scalar: Scalar, change: i64) {
        self.scalars[scalar as usize].fetch_add(change, Ordering::Relaxed);
    }

    /// Adds 1 until the guard is dropped.
    pub(crate) fn counted(self: &Arc<Self>, scalar: Scalar) -> Counted {
        self.add(scalar, 1);
        Counted(self.clone(), scalar)
    }

    pub(crate) fn get(&self, scalar: Scalar) -> i64 {
        self.scalars[scalar as usize].load(Ordering::Relaxed)
    }

    pub(crate) fn set(&self, scalar: Scalar, value: i64) {
        self.scalars[scalar as usize].store(value, Ordering::Relaxed);
    }

    /// Writes all metrics.
    pub(crate) fn text(&self) -> String {
        let counts = self.counts();
        let mut page = Exposition(String::new());
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
        for (stage, (count, seconds)) in &counts.stages {
            let label = format!("part=\"{}\"", stage.name());
            page.line("part_seconds_sum", &label, seconds);
            page.line("part_seconds_count", &label, count);
        }
        page.family("rejected_total", "counter", "Requests that were refused.");
        for (kind, count) in &counts.rejected {
            let label = format!("reason=\"{}\"", kind.name());
            page.line("rejected_total", &label, count);
        }
        drop(counts);
        for ((name, kind, help), value) in SCALARS.into_iter().zip(&self.scalars) {
            page.family(name, kind, help);
            page.line(name, "", value.load(Ordering::Relaxed));
        }
        page.0
    }
}

/// A guard that counts while it lives.
pub(crate) struct Counted(Arc<Metrics>, Scalar);

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.add(self.1, -1);
    }
}

/// Text in the format of Prometheus. Writing to a string does not fail.
struct Exposition(String);

impl Exposition {
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
