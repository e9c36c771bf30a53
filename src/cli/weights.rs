//! `lsdc weights`: what weights there are, what they are, and in which precision.

use super::args::{Convert, WeightsCommand};
use super::{Exit, install, ui};
use crate::data::{check_output, write_atomically};
use crate::error::{Error, Result};
use crate::history::{self, Made};
use crate::metrics::{Metric, Scores};
use crate::model::{AdapterConfig, to_bytes};
use crate::predict::{embedded, open_weights, weights_name};
use crate::systems::{Trained, is_system};
use crate::train::{SCORES_NOTE, TRAINING_NOTE, TrainConfig};
use lsdc_weights::{KNOWN, Store, how_to_install};
use serde_json::{Value, json};
use std::path::Path;

pub(super) fn run(command: &WeightsCommand) -> Result<Exit> {
    match command {
        WeightsCommand::List { print_folder: true } => {
            ui::print(&Store::open()?.folder().display().to_string());
        }
        WeightsCommand::List { .. } => list()?,
        #[cfg(feature = "download")]
        WeightsCommand::Get(args) => install::get(args)?,
        WeightsCommand::Add(args) => install::add(args)?,
        WeightsCommand::Info { file, json } => info(file.as_deref(), *json)?,
        WeightsCommand::Convert(args) => convert(args)?,
    }
    Ok(Exit::Done)
}

/// A line of each: name, size, licence, where it is, what it is.
fn list() -> Result<()> {
    let line = |name: &str, bytes: u64, licence: &str, place: &str, about: &str| {
        let megabytes = format!("{:.1} MB", bytes as f64 / 1e6);
        ui::print(&format!(
            "{name:<9} {megabytes:<8} {licence:<18} {place:<14} {about}"
        ));
    };
    let on_encoder = |name: &str| KNOWN.iter().any(|known| known.weights == name);
    for weights in embedded()
        .iter()
        .filter(|weights| !on_encoder(weights.name))
    {
        let bytes = weights.bytes.len() as u64;
        let (licence, about) = (weights.licence, weights.about);
        line(weights.name, bytes, licence, "built in", about);
    }
    let store = Store::open()?;
    let mut remarks = Vec::new();
    for known in &KNOWN {
        let path = store.path(known);
        let place = match store.load(known) {
            Ok(_) => {
                remarks.push(format!("`{}` is in {}", known.weights, path.display()));
                "installed"
            }
            Err(_) if !path.exists() => {
                remarks.push(how_to_install(known));
                "not installed"
            }
            Err(error) => {
                remarks.push(error.with_causes());
                "damaged"
            }
        };
        let about = format!("on {}; {}", known.name, known.cost);
        line(known.weights, known.bytes(), known.licence, place, &about);
    }
    for remark in remarks {
        ui::say(&remark);
    }
    Ok(())
}

pub(super) fn info(file: Option<&Path>, as_json: bool) -> Result<()> {
    if let Some(path) = file
        && std::fs::read(path).is_ok_and(|bytes| is_system(&bytes))
    {
        return info_of_system(path, as_json);
    }
    let weights = open_weights(file)?;
    let fit = weights.fit()?.unwrap_or_default();
    let calibration = weights.prior()?.map(|(_, calibration)| calibration);
    let notes = &weights.notes;
    let training: Option<TrainConfig> = parsed(notes.get(TRAINING_NOTE))?;
    let scores: Option<Scores> = parsed(notes.get(SCORES_NOTE))?;
    let history = history::of(notes)?;
    if as_json {
        let value = json!({
            "parameters": weights.parameters(),
            "network": weights.network,
            "normalisation": weights.normalisation,
            "fit": fit,
            "calibration": calibration,
            "training": training,
            "held_out": scores,
            "history": history,
        });
        ui::print(&pretty(&value)?);
        return Ok(());
    }
    let [height, width] = weights.normalisation.input;
    let network = &weights.network;
    ui::print(&format!("weights    {}", weights_name(file)?));
    ui::print(&format!(
        "network    {} parameters, {} basis functions{}",
        weights.parameters(),
        network.bases,
        if network.affinities > 0 {
            ", learned affinities"
        } else {
            ""
        }
    ));
    if let Some(AdapterConfig { blocks, rank }) = network.adapters {
        ui::print(&format!(
            "encoder    changed in its last blocks ({blocks}), by adapters of rank {rank}"
        ));
    }
    ui::print(&format!("input      {width}x{height}"));
    ui::print(&format!("fit        {fit}"));
    trained(training, scores);
    made(&history);
    Ok(())
}

/// What weights were made from, the oldest first.
fn made(history: &[Made]) {
    for line in history::lines(history) {
        ui::print(&format!("made       {line}"));
    }
}

/// How weights were trained, and what they reached.
fn trained(training: Option<TrainConfig>, scores: Option<Scores>) {
    if let Some(training) = training {
        let TrainConfig {
            steps, batch, seed, ..
        } = training;
        let rate = training.learning_rate;
        ui::print(&format!(
            "training   {steps} steps of {batch} images, peak learning rate {rate}, seed {seed}"
        ));
    }
    if let Some(scores) = scores {
        ui::print(&format!(
            "held out   RMSE {:.4} m, REL {:.4} at 500 points, on frames kept out of training",
            scores[Metric::Rmse],
            scores[Metric::Rel]
        ));
    }
}

/// The same of a system that the paper compares itself with.
fn info_of_system(path: &Path, as_json: bool) -> Result<()> {
    let system = Trained::open(path)?;
    let training: Option<TrainConfig> = parsed(system.notes.get(TRAINING_NOTE))?;
    let scores: Option<Scores> = parsed(system.notes.get(SCORES_NOTE))?;
    let history = history::of(&system.notes)?;
    let parameters = system.parameters()?;
    if as_json {
        let value = json!({
            "parameters": parameters,
            "never_run": system.config.never_run(),
            "system": system.config,
            "normalisation": system.normalisation,
            "training": training,
            "held_out": scores,
            "history": history,
        });
        ui::print(&pretty(&value)?);
        return Ok(());
    }
    let [height, width] = system.normalisation.input;
    let kind = system.config.kind();
    ui::print(&format!("weights    `{}`, {}", path.display(), system.hash));
    ui::print(&format!("system     {}: {}", kind.name(), kind.source()));
    let more = match system.config.never_run() {
        0 => String::new(),
        more => format!("; the authors' program makes {more} more and never runs them"),
    };
    ui::print(&format!("network    {parameters} parameters{more}"));
    ui::print(&format!("input      {width}x{height}"));
    let start = match system.config.pretrained() {
        Some(path) => format!("the encoder from `{}`", path.display()),
        None => "all weights at random".to_owned(),
    };
    ui::print(&format!("start      {start}"));
    trained(training, scores);
    made(&history);
    Ok(())
}

fn parsed<T: serde::de::DeserializeOwned>(note: Option<&String>) -> Result<Option<T>> {
    let parse = |json: &String| {
        serde_json::from_str(json)
            .map_err(|e| Error::weights("a record of the weights cannot be read").because(e))
    };
    note.map(parse).transpose()
}

fn pretty(value: &Value) -> Result<String> {
    serde_json::to_string_pretty(value)
        .map_err(|e| Error::weights("the record cannot be written as JSON").because(e))
}

fn convert(args: &Convert) -> Result<()> {
    check_output(&args.output, args.force)?;
    let mut weights = open_weights(Some(&args.input))?;
    let by = format!("weights convert --precision {}", args.precision.name());
    let made = history::changed(&by, Some(&args.input), &weights)?;
    history::add(&mut weights.notes, [made])?;
    let bytes = to_bytes(&weights, args.precision)?;
    write_atomically(&args.output, |out| out.write_all(&bytes))?;
    ui::print(&format!(
        "written   {}, {:.1} MB",
        args.output.display(),
        bytes.len() as f64 / 1e6
    ));
    Ok(())
}
