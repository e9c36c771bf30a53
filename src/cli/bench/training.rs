//! Steps of training.

use super::{Setting, is_given, peak_memory, report, rooms, setting, work};
use crate::cli::args::Bench;
use crate::cli::{Exit, ui};
use crate::config::Config;
use lsdc_core::fit::FitConfig;
use lsdc_core::network::NetworkConfig;
use lsdc_core::weights::Normalisation;
use lsdc_eval::data::Split;
use lsdc_eval::evaluation::median_ms;
use lsdc_eval::sampling::{Protocol, Size};
use lsdc_files::error::{Error, Result};
use lsdc_train::device::{device, is_gpu};
use lsdc_train::model::InitNetwork as _;
use lsdc_train::sample::{Batch, Encoding, Sampler, SamplerConfig};
use lsdc_train::traffic::{Traffic, counted};
use lsdc_train::training::{Learner, TrainConfig, UnreadLosses};
use lsdc_weights::{encoder_of, open_weights};
use serde::Serialize;
use std::sync::Arc;
use std::time::Instant;

/// Medians over all steps of training.
#[derive(Debug, Serialize)]
struct Training {
    /// Forward, fit, losses, backward and the optimiser.
    step_ms: f64,
    batch: usize,
    peak_mb: Option<f64>,
    /// Launches of GPU kernels and read-backs of one step.
    traffic: Traffic,
    #[serde(flatten)]
    setting: Setting,
}

pub(super) fn run(args: &Bench) -> Result<Exit> {
    let outcome = train(args)?;
    let mut lines = vec![
        work(&outcome.setting, &ui::counted(outcome.batch, "image")),
        format!("step      {:8.1} ms", outcome.step_ms),
    ];
    let launches = outcome.traffic.launched();
    if launches > 0 {
        let readbacks = outcome.traffic.readbacks;
        lines.push(format!("launches  {launches:8}"));
        lines.push(format!("read-backs{readbacks:8}"));
    }
    report(args.json, &outcome, lines, outcome.peak_mb)
}

/// The conditions of a training step.
fn subject(args: &Bench) -> Result<(NetworkConfig, FitConfig, TrainConfig)> {
    if is_given(&args.settings) {
        if args.model.weights.is_some() {
            return Err(Error::config(
                "`--weights` names a network, and so do `--config` and `--set`",
            )
            .hint("leave one of them out; steps begin with random weights either way"));
        }
        let config = Config::load(args.settings.config.as_deref(), &args.settings.set)?;
        if config.system.is_some() || config.train.teacher.is_some() {
            return Err(Error::config(
                "steps of other systems, and with a teacher, are not timed here",
            )
            .hint("`lsdc train` writes the time of every step to `metrics.jsonl`"));
        }
        let fit = config.fit.over(&FitConfig::default())?;
        return Ok((config.network(), fit, config.train));
    }
    let weights = open_weights(args.model.weights.as_deref())?;
    // Random basis functions may depend on each other.
    let fit = FitConfig {
        ridge: 1e-4,
        ..FitConfig::default()
    };
    Ok((weights.network, fit, TrainConfig::default()))
}

/// Trains a network from random weights.
fn train(args: &Bench) -> Result<Training> {
    let device = device(&args.model.device)?.autodiff();
    let (network, fit, config) = subject(args)?;
    let learned = config.protocol.crop.or(config.protocol.resize);
    let learned = learned.filter(|_| is_given(&args.settings));
    let size = args.size.or(learned).unwrap_or(Size {
        height: 228,
        width: 304,
    });
    let normalisation = Normalisation {
        input: [size.height, size.width],
        ..Normalisation::default()
    };
    let encoding = encoder_of(&network)?.map(|encoder| Encoding::new(encoder, normalisation, None));
    let sampler = SamplerConfig {
        protocol: Protocol::default(),
        augment: config.augment,
        views: 0,
        supervision: config.supervision,
        batch: config.batch,
        seed: config.seed,
    };
    let frames = Arc::new(rooms(Split::Train, size)?);
    let order = (0..config.batch).collect::<Vec<_>>();
    let samples = Sampler::new(frames, order, sampler)?
        .encoded(encoding)
        .batch(0)?;
    let batch = Batch::new(&samples, normalisation, &device)?;
    let net = network.init(config.seed, &device)?;
    let mut learner = Learner::new(net, &fit, &config);
    // Like most steps of a run.
    if config.freeze_statistics < 0.5 {
        learner = learner.freeze_statistics();
    }
    let step = |learner: Learner, number| {
        learner.step_unread(std::slice::from_ref(&batch), config.learning_rate, number)
    };
    // Losses are read as runs read them: from a GPU together, elsewhere after every step.
    let together = if is_gpu(&device.inner()) {
        args.runs
    } else {
        1
    };
    let mut times = Vec::with_capacity(args.runs);
    let (next, losses) = step(learner, 1)?;
    learner = next;
    UnreadLosses::read(vec![losses])?;
    while times.len() < args.runs {
        let mut unread = Vec::with_capacity(together);
        let started = Instant::now();
        for _ in 0..together {
            let losses;
            (learner, losses) = step(learner, times.len() + 2)?;
            unread.push(losses);
        }
        UnreadLosses::read(unread)?;
        let mean = started.elapsed() / together as u32;
        times.extend(std::iter::repeat_n(mean, together));
    }
    let (last, traffic) = counted(|| step(learner, args.runs + 2));
    last?;
    Ok(Training {
        traffic,
        step_ms: median_ms(times.into_iter())?,
        batch: config.batch,
        peak_mb: peak_memory(),
        setting: setting(args, size),
    })
}
