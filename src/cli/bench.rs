//! `lsdc bench`: how fast is it on this machine.

use super::args::Bench;
use super::{Exit, ui};
use crate::data::{Dataset as _, Rooms, RoomsConfig, Split};
use crate::device::device;
use crate::error::{Error, Result};
use crate::predict::{Completer, Timings};
use crate::sample::Pattern;
use crate::simd::Level;
use serde::Serialize;
use std::time::{Duration, Instant};

/// Medians over all runs.
#[derive(Debug, Serialize)]
struct Outcome {
    /// Image to features.
    network_ms: f64,
    /// Base functions at the points, and the solve.
    fit_ms: f64,
    /// Dense depth from the weights.
    dense_ms: f64,
    /// Image in memory to dense depth in memory.
    total_ms: f64,
    /// The most memory that the process has held, where the system tells.
    peak_mb: Option<f64>,
    device: String,
    threads: usize,
    instructions: &'static str,
    width: usize,
    height: usize,
    points: usize,
    runs: usize,
}

pub(super) fn run(args: &Bench) -> Result<Exit> {
    if args.runs == 0 {
        return Err(Error::config("`--runs` must be above 0"));
    }
    let mut completer =
        Completer::open(args.model.weights.as_deref(), &device(&args.model.device)?)?;
    if args.full {
        completer = completer.with_input([args.size.height, args.size.width]);
    }
    let rooms = RoomsConfig {
        width: args.size.width,
        height: args.size.height,
        ..RoomsConfig::default()
    };
    let frame = Rooms::new(Split::Val, &rooms)?.load(0)?;
    let sparse = Pattern::Exactly(args.points).draw(&frame.depth, 0, &frame.id);

    let mut times: Vec<(Timings, Duration)> = Vec::with_capacity(args.runs);
    for run in 0..=args.runs {
        let started = Instant::now();
        let completion = completer.complete(&frame.rgb, &sparse, None)?;
        // The first run warms up caches and memory.
        if run > 0 {
            times.push((completion.timings, started.elapsed()));
        }
    }
    let median = |of: fn(&(Timings, Duration)) -> Duration| {
        let mut values: Vec<f64> = times.iter().map(|t| of(t).as_secs_f64() * 1e3).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let outcome = Outcome {
        network_ms: median(|(t, _)| t.network),
        fit_ms: median(|(t, _)| t.fit),
        dense_ms: median(|(t, _)| t.dense),
        total_ms: median(|(_, total)| *total),
        peak_mb: peak_memory(),
        device: args.model.device.clone(),
        threads: rayon::current_num_threads(),
        instructions: Level::here().name(),
        width: args.size.width,
        height: args.size.height,
        points: sparse.count(),
        runs: args.runs,
    };
    if args.json {
        ui::print(
            &serde_json::to_string(&outcome)
                .map_err(|e| Error::config("the outcome cannot be written as JSON").because(e))?,
        );
    } else {
        show(&outcome);
    }
    Ok(Exit::Done)
}

fn show(outcome: &Outcome) {
    ui::print(&format!(
        "machine   {}, {} threads, {}",
        outcome.device, outcome.threads, outcome.instructions
    ));
    ui::print(&format!(
        "work      {}x{}, {} points, median of {} runs",
        outcome.width, outcome.height, outcome.points, outcome.runs
    ));
    for (name, value) in [
        ("network", outcome.network_ms),
        ("fit", outcome.fit_ms),
        ("dense", outcome.dense_ms),
        ("total", outcome.total_ms),
    ] {
        ui::print(&format!("{name:<9} {value:8.2} ms"));
    }
    if let Some(peak) = outcome.peak_mb {
        ui::print(&format!("memory    {peak:8.1} MB at most"));
    }
}

/// The most memory that this process has held, in megabytes.
fn peak_memory() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: f64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kilobytes * 1024.0 / 1e6)
}
