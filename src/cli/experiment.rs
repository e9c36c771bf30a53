//! `lsdc experiment`: the paper's experiments, a bar, and going on where they stopped.

use super::args::{Chosen, Experiments};
use super::network::systems;
use super::{Exit, settings, ui};
use crate::config::Config;
use lsdc_core::fit::{FitConfig, FitMethod};
use lsdc_eval::data::{DataConfig, DatasetKind, Split};
use lsdc_eval::report::write_page;
use lsdc_eval::sampling::ProtocolPreset;
use lsdc_files::error::Result;
use lsdc_paper::experiment::{
    self, Experiment, ExperimentContext, ExperimentEvent, Recipe, SystemRecipe,
};
use lsdc_train::device::device;
use lsdc_train::predict::completer;
use lsdc_train::training::TrainConfig;
use lsdc_weights::{open_weights, weights_name};
use serde_json::json;
use std::path::Path;
use std::time::{Duration, Instant};

/// The recipe of the ablation, unless another is given.
const RECIPE: &str = "nyu-half.toml";

pub(super) fn run(args: &Experiments) -> Result<Exit> {
    let context = context(args)?;
    if args.force {
        experiment::remove_results(&context.folder)?;
    }
    let stop = ui::stop_flag();
    let bar = ui::bar(1, "s");
    let mut announced = None;
    let experiments = Chosen::experiments(&args.names);
    let sections = experiment::run(&experiments, &context, |event| {
        match event {
            ExperimentEvent::Resumed(count) => {
                bar.suspend(|| {
                    ui::say(&format!("{count} results of an earlier run are used again"));
                });
            }
            ExperimentEvent::Estimating { done, total, trial } => {
                bar.set_length(total as u64);
                bar.set_position(done as u64);
                bar.set_message(format!("trying {trial}"));
            }
            ExperimentEvent::Estimated(time) => {
                announced = Some((Instant::now(), time));
                bar.suspend(|| ui::say(&format!("this takes about {}", words(time))));
                bar.set_length(time.as_secs());
                bar.reset_eta();
            }
            ExperimentEvent::Progress { done, total, trial } => {
                bar.set_length(total.as_secs().max(1));
                bar.set_position(done.as_secs());
                bar.set_message(trial.to_owned());
            }
        }
        ui::unless(&stop)
    })?;
    bar.finish_and_clear();
    let Some(sections) = sections else {
        ui::say("hint: the same command goes on where it stopped");
        return Ok(Exit::Interrupted);
    };
    let page = context.folder.join(page(&experiments));
    write_page(&page, "Experiments", &sections)?;
    for section in &sections {
        ui::print(&section.to_string());
        ui::print("");
    }
    if let Some((start, time)) = announced {
        let took = words(start.elapsed());
        ui::say(&format!("took {took}, announced {}", words(time)));
    }
    ui::tell(&format!("written   {}", page.display()));
    Ok(
        if sections.iter().all(|section| section.failures.is_empty()) {
            Exit::Done
        } else {
            Exit::Partial
        },
    )
}

/// The page's file: one of fewer experiments does not take the place of that of all.
fn page(experiments: &[Experiment]) -> String {
    if experiments == Experiment::ALL {
        return "index.html".to_owned();
    }
    let names: Vec<&str> = experiments.iter().map(|e| e.name()).collect();
    format!("{}.html", names.join("-"))
}

/// The systems that the paper compares itself with, and steering kernels of our network, as their configurations say but
/// for what they have in common with the other trainings of the experiment: frames, steps, images.
const SYSTEMS: [&str; 4] = ["s2d.toml", "cspn.toml", "lsk.toml", "lsk-ours.toml"];

fn system_recipes(shared: &TrainConfig) -> Result<Vec<SystemRecipe>> {
    let mut recipes = Vec::new();
    for file in SYSTEMS {
        let Config {
            system: Some(system),
            train,
            ..
        } = Config::load(Some(Path::new(file)), &[])?
        else {
            continue;
        };
        recipes.push(SystemRecipe {
            name: file.trim_end_matches(".toml").to_owned(),
            system,
            train: TrainConfig {
                steps: shared.steps,
                batch: shared.batch,
                seed: shared.seed,
                workers: shared.workers,
                save_every: shared.save_every,
                measure_every: shared.steps,
                held_out: shared.held_out,
                protocol: shared.protocol,
                augment: shared.augment,
                ..train
            },
        });
    }
    Ok(recipes)
}

/// Duration of the trial from which the total time is estimated.
const TRIAL: Duration = Duration::from_secs(1);

fn context(args: &Experiments) -> Result<ExperimentContext> {
    let path = args.settings.config.as_deref().unwrap_or(Path::new(RECIPE));
    let mut config = Config::load(Some(path), &args.settings.set)?;
    args.source.apply(&mut config.data);
    let eval = &mut config.eval;
    args.draws.apply(eval);
    eval.check()?;
    config.train.steps = args.steps;
    config.train.check()?;
    let frames = settings::open(&config.data, args.draws.split)?;
    let mut preset = ProtocolPreset::named(eval.preset.as_deref().unwrap_or(frames.protocol()))?;
    preset.protocol = eval.protocol.unwrap_or(preset.protocol);
    preset.points = eval.points.clone().unwrap_or(preset.points);
    let weights = args.model.weights.as_deref();
    let device_of_all = device(&args.model.device)?;
    let opened = open_weights(weights)?;
    let diode = args.diode.clone().map(|root| {
        let data = DataConfig {
            dataset: DatasetKind::Diode,
            root: Some(root),
            ..config.data.clone()
        };
        settings::open(&data, Split::Val)
    });
    let mut fit = config.fit.over(&FitConfig::default())?;
    fit.method = FitMethod::Lse;
    let data = config.data.clone();
    Ok(ExperimentContext {
        folder: args.output.clone(),
        dataset: format!("{} {}", config.data.dataset.name(), args.draws.split.name()),
        frames,
        preset,
        rules: config.eval.rules,
        limit: config.eval.limit,
        seeds: config.eval.draws(),
        completer: completer(&opened, &device_of_all)?,
        weights: weights_name(weights)?,
        network: opened.network,
        guides: args.guide.clone(),
        predictions: args.predictions.clone(),
        systems: systems(&args.system, &device_of_all)?,
        diode: diode.transpose()?,
        recipe: Recipe {
            systems: system_recipes(&config.train)?,
            network: config.network(),
            fit,
            train: config.train,
            frames: Box::new(move || settings::open(&data, Split::Train)),
        },
        place: json!({
            "data": config.data,
            "folder": settings::folder(&config.data),
            "split": args.draws.split,
            "diode": args.diode.as_deref().map(settings::absolute),
            "device": args.model.device,
        }),
        device: (device_of_all, args.model.device.clone()),
        probe_time: TRIAL,
    })
}

/// A duration for people.
fn words(time: Duration) -> String {
    let seconds = time.as_secs_f64();
    match time.as_secs() {
        0..180 => format!("{seconds:.0} s"),
        180..5400 => format!("{:.0} min", seconds / 60.0),
        _ => format!("{:.1} h", seconds / 3600.0),
    }
}
