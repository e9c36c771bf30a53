//! `lsdc bench`: how fast is it on this machine.

#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "train")]
mod training;

use super::args::{Bench, Settings};
use super::network::{at_quality, open_guided_completer, open_system};
use super::{Exit, ui};
use lsdc_core::Quality;
use lsdc_eval::data::{Dataset as _, Frame, Rooms, RoomsConfig, Split};
use lsdc_eval::evaluation::{CompletionTimes, median_ms, time, time_deviations};
use lsdc_eval::predict::{
    DepthCompleter as _, GuideSpec, Method, MonocularGuide, complete_classic,
};
use lsdc_eval::sampling::{Pattern, Size};
use lsdc_files::error::{Error, Result};
use lsdc_kernels::simd::Level;
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Instant;

/// The conditions of a measurement.
#[derive(Debug, Serialize)]
struct Setting {
    device: String,
    threads: usize,
    instructions: &'static str,
    width: usize,
    height: usize,
    runs: usize,
    /// If it is not the standard one.
    #[serde(skip_serializing_if = "Option::is_none")]
    quality: Option<Quality>,
    #[serde(skip_serializing_if = "Option::is_none")]
    encoder_side: Option<usize>,
}

/// Times of a completion.
#[derive(Debug, Serialize)]
struct Completing {
    #[serde(flatten)]
    times: CompletionTimes,
    /// The standard deviation of every pixel, which the total does not contain.
    #[serde(skip_serializing_if = "Option::is_none")]
    deviation_ms: Option<f64>,
    /// The prediction of each guide, which the total does not contain either.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    guide_ms: BTreeMap<String, f64>,
    /// Launches and transfers of a completion on a GPU, by part.
    #[cfg(feature = "gpu")]
    #[serde(skip_serializing_if = "Vec::is_empty")]
    gpu: Vec<gpu::PartTraffic>,
    points: usize,
    /// The most memory that the process has held, where the system tells; with the networks of the guides.
    peak_mb: Option<f64>,
    #[serde(flatten)]
    setting: Setting,
}

/// Times of a method without stages.
#[derive(Debug, Serialize)]
struct InOnePiece {
    total_ms: f64,
    points: usize,
    peak_mb: Option<f64>,
    #[serde(flatten)]
    setting: Setting,
}

pub(super) fn run(args: &Bench) -> Result<Exit> {
    if args.runs == 0 {
        return Err(Error::config("`--runs` must be above 0"));
    }
    if is_given(&args.settings) && !args.training {
        return Err(
            Error::config("`--config` and `--set` are settings of training steps")
                .hint("add `--training`"),
        );
    }
    if args.training && args.fit.given().next().is_some() {
        return Err(Error::config(
            "options of the fit are for completion; steps are fitted by their configuration",
        )
        .hint("set `fit.method` and others by `--set`, or leave the options out"));
    }
    if args.method != Method::Lsdc {
        return in_one_piece(args, size(args, 640, 480));
    }
    if args.training {
        #[cfg(feature = "train")]
        return training::run(args);
        #[cfg(not(feature = "train"))]
        return Err(super::network::needs_training(Error::config(
            "this build cannot train",
        )));
    }
    let outcome = complete(args, size(args, 640, 480))?;
    let mut lines = vec![work(
        &outcome.setting,
        &ui::counted(outcome.points, "point"),
    )];
    for (name, value) in [
        ("network", outcome.times.network_ms),
        ("fit", outcome.times.fit_ms),
        ("- field", outcome.times.field_ms),
        ("dense", outcome.times.dense_ms),
        ("total", outcome.times.total_ms),
    ] {
        lines.push(format!("{name:<9} {value:8.2} ms"));
    }
    if let Some(value) = outcome.deviation_ms {
        lines.push(format!(
            "deviation {value:8.2} ms (of every pixel, beside the total)"
        ));
    }
    for (name, value) in &outcome.guide_ms {
        lines.push(format!(
            "guide     {value:8.2} ms ({name} on the CPU, beside the total)"
        ));
    }
    #[cfg(feature = "gpu")]
    lines.extend(outcome.gpu.iter().map(ToString::to_string));
    report(args.json, &outcome, lines, outcome.peak_mb)
}

fn size(args: &Bench, width: usize, height: usize) -> Size {
    args.size.unwrap_or(Size { height, width })
}

fn rooms(split: Split, size: Size) -> Result<Rooms> {
    let config = RoomsConfig {
        width: size.width,
        height: size.height,
        ..RoomsConfig::default()
    };
    Rooms::new(split, &config)
}

fn setting(args: &Bench, size: Size) -> Setting {
    let quality = args.fit.quality;
    Setting {
        device: args.model.device.clone(),
        threads: rayon::current_num_threads(),
        instructions: Level::here().name(),
        width: size.width,
        height: size.height,
        runs: args.runs,
        quality: (quality != Quality::Standard).then_some(quality),
        encoder_side: args.fit.encoder.side,
    }
}

fn complete(args: &Bench, size: Size) -> Result<Completing> {
    let guides = open_guides(args)?;
    let weights = args.model.weights.as_deref();
    let none = args.guide.iter().find(|guide| **guide == GuideSpec::None);
    let completer = open_guided_completer(weights, &args.model.device, none)?;
    let mut settings = *completer.fit_config();
    args.fit.apply(&mut settings);
    let completer = completer.with_fit(settings);
    let mut completer = at_quality(&completer, args.fit.quality, args.fit.encoder.side, weights)?;
    if args.full {
        completer = completer.with_working_size(size.height, size.width)?;
    }
    let frame = rooms(Split::Val, size)?.load(0)?;
    let points = Pattern::Exactly(args.points);
    Ok(Completing {
        times: time(&completer, &frame, &points, args.runs)?,
        // Before standard deviations, which most completions do without.
        peak_mb: peak_memory(),
        deviation_ms: time_deviations(&completer, &frame, &points, args.runs)?,
        guide_ms: time_guides(&guides, &frame, args.runs)?,
        #[cfg(feature = "gpu")]
        gpu: gpu::traffic(&args.model.device, &completer, &frame, &points)?,
        points: args.points,
        setting: setting(args, size),
    })
}

/// The networks that predict guides, by what was chosen.
fn open_guides(args: &Bench) -> Result<BTreeMap<String, MonocularGuide>> {
    let named = args.guide.iter();
    let guides = named
        .filter(|guide| **guide != GuideSpec::None)
        .map(|guide| {
            let network = MonocularGuide::open(Some(guide))?.ok_or_else(|| {
                Error::config(format!("the guide `{guide}` is read, not predicted"))
                    .hint("give --guide depth-anything or depth-anything:SIDE")
            })?;
            Ok((guide.to_string(), network))
        });
    guides.collect()
}

/// The times of predicting guides.
fn time_guides(
    guides: &BTreeMap<String, MonocularGuide>,
    frame: &Frame,
    runs: usize,
) -> Result<BTreeMap<String, f64>> {
    let times = guides.iter().map(|(name, network)| {
        let time = median_of(runs, || network.predict(&frame.rgb).map(drop))?;
        Ok((name.clone(), time))
    });
    times.collect()
}

/// The median time of `work` in milliseconds, after one warm-up.
fn median_of(runs: usize, work: impl Fn() -> Result<()>) -> Result<f64> {
    let mut times = Vec::with_capacity(runs);
    for run in 0..=runs {
        let started = Instant::now();
        work()?;
        if run > 0 {
            times.push(started.elapsed());
        }
    }
    median_ms(times.into_iter())
}

/// Completes by a method that looks at image and points together.
fn in_one_piece(args: &Bench, size: Size) -> Result<Exit> {
    let name = args.method.name();
    let guided = !args.guide.is_empty();
    if args.training || args.full || guided || args.fit.given().next().is_some() {
        return Err(Error::config(format!(
            "`--training`, `--full`, `--guide` and options of the fit need method `lsdc`, not `{name}`"
        )));
    }
    let predictor = match args.method {
        Method::System(kind) => Some(open_system(
            kind,
            args.model.weights.as_deref(),
            &args.model.device,
        )?),
        _ => None,
    };
    let frame = rooms(Split::Val, size)?.load(0)?;
    let sparse = Pattern::Exactly(args.points).draw(&frame, 0)?;
    let complete = || match (&predictor, args.method) {
        (Some(predictor), _) => predictor.depth(&frame.rgb, &sparse).map(drop),
        (None, Method::Classic(method)) => complete_classic(method, &frame.rgb, &sparse).map(drop),
        (None, _) => Ok(()),
    };
    let outcome = InOnePiece {
        total_ms: median_of(args.runs, complete)?,
        points: args.points,
        peak_mb: peak_memory(),
        setting: setting(args, size),
    };
    let lines = vec![
        work(
            &outcome.setting,
            &format!("{name}, {}", ui::counted(args.points, "point")),
        ),
        format!("{:<9} {:8.2} ms", "total", outcome.total_ms),
    ];
    report(args.json, &outcome, lines, outcome.peak_mb)
}

fn is_given(settings: &Settings) -> bool {
    settings.config.is_some() || !settings.set.is_empty()
}

fn work(setting: &Setting, what: &str) -> String {
    let quality = setting.quality.map(Quality::name);
    let quality = quality.map_or(String::new(), |name| format!(", quality {name}"));
    let side = setting.encoder_side;
    let side = side.map_or(String::new(), |side| format!(", encoder side {side}"));
    format!(
        "machine   {}, {} threads, {}\nwork      {}x{}, {what}{quality}{side}, median of {} runs",
        setting.device,
        setting.threads,
        setting.instructions,
        setting.width,
        setting.height,
        setting.runs
    )
}

fn report(
    json: bool,
    outcome: &impl Serialize,
    lines: Vec<String>,
    peak: Option<f64>,
) -> Result<Exit> {
    if json {
        ui::print(
            &serde_json::to_string(outcome)
                .map_err(|e| Error::config("the outcome cannot be written as JSON").because(e))?,
        );
        return Ok(Exit::Done);
    }
    for line in lines {
        ui::print(&line);
    }
    if let Some(peak) = peak {
        ui::print(&format!("memory    {peak:8.1} MB at most"));
    }
    Ok(Exit::Done)
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
