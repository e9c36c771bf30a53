//! `lsdc weights`: what weights there are, what they are, in which precision, and as ONNX.

#[cfg(feature = "train")]
mod system;

use super::args::{Convert, ExportNetwork, WeightsCommand};
use super::{Exit, install, ui};
use lsdc_eval::data::{check_output, write_atomically};
use lsdc_eval::metrics::{Metric, Scores};
use lsdc_files::error::{Error, Result};
use lsdc_weights::history::{self, HistoryEntry};
use lsdc_weights::is_system;
use lsdc_weights::training_sets::{self, HEAD_LICENCE, HEAD_TENSOR, TrainingSet};
use lsdc_weights::{KNOWN, Store, how_to_install};
use lsdc_weights::{OPSET, to_bytes, to_onnx};
use lsdc_weights::{SCORES_NOTE, TRAINING_NOTE};
use lsdc_weights::{embedded, named, open_weights, weights_hash, weights_name};
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
        WeightsCommand::Export(args) => export(args)?,
    }
    Ok(Exit::Done)
}

/// A line of each: name, size, licence, where it is, what it is; below, what it was trained on.
fn list() -> Result<()> {
    let line = |name: &str, bytes: u64, licence: &str, place: &str, about: &str| {
        let megabytes = format!("{:.1} MB", bytes as f64 / 1e6);
        ui::print(&format!(
            "{name:<9} {megabytes:<8} {licence:<18} {place:<14} {about}"
        ));
    };
    let trained_on = |what: &str, name: &str| {
        let data = training_sets::summary(&training_sets::named(name));
        ui::print(&format!("          {what}trained on {data}"));
    };
    let on_encoder = |name: &str| KNOWN.iter().any(|known| known.weights == name);
    for weights in embedded()
        .iter()
        .filter(|weights| !on_encoder(weights.name))
    {
        let bytes = weights.bytes.len() as u64;
        let (licence, about) = (weights.licence, weights.about);
        line(weights.name, bytes, licence, "built in", about);
        trained_on("", weights.name);
    }
    let store = Store::open()?;
    let mut remarks = Vec::new();
    for known in &KNOWN {
        let path = store.path(known);
        let place = match store.load(known) {
            Ok(_) => {
                remarks.push(format!("`{}` is in {}", known.weights, path.display()));
                if !store.has_head(known) {
                    remarks.push(install::NO_HEAD.to_owned());
                }
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
        let about = format!("on {}; {}", known.name, known.extra_time);
        line(known.weights, known.bytes(), known.licence, place, &about);
        let licence = named(known.weights).map_or("not stated", |weights| weights.licence);
        trained_on(&format!("the weights, {licence}, "), known.weights);
        if known.head.is_some() {
            let what = format!("the learned tensor of the depth head, {HEAD_LICENCE}, ");
            trained_on(&what, HEAD_TENSOR);
        }
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
        #[cfg(feature = "train")]
        return system::info(path, as_json);
        #[cfg(not(feature = "train"))]
        return Err(super::network::needs_training(Error::weights(format!(
            "`{}` holds a system that this build cannot use",
            path.display()
        ))));
    }
    let weights = open_weights(file)?;
    let fit = weights.fit()?.unwrap_or_default();
    let calibration = weights.prior()?.map(|(_, calibration)| calibration);
    let notes = &weights.notes;
    let training = training(notes.get(TRAINING_NOTE))?;
    let scores: Option<Scores> = parsed(notes.get(SCORES_NOTE))?;
    let history = history::read(notes)?;
    let contents = weights_hash(file)?;
    let licence = training_sets::licence_of(&contents);
    let needs_encoder = weights.network.extractor.encoder > 0;
    let trained_on = training_sets::of(&contents, &history, needs_encoder);
    if as_json {
        let value = json!({
            "parameters": weights.parameters(),
            "network": weights.network,
            "normalisation": weights.normalisation,
            "fit": fit,
            "calibration": calibration,
            "training": training,
            "held_out": scores,
            "licence": licence,
            "trained_on": trained_on,
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
    ui::print(&format!("input      {width}x{height}"));
    ui::print(&format!("fit        {fit}"));
    trained(training.as_ref(), scores);
    licences(licence, &trained_on);
    made(&history);
    Ok(())
}

/// The licence of weights, and those of the data that they were trained on.
fn licences(licence: Option<&str>, trained_on: &[TrainingSet]) {
    ui::print(&format!("licence    {}", licence.unwrap_or("not stated")));
    if trained_on.is_empty() {
        ui::print("data       not recorded");
    }
    for set in trained_on {
        ui::print(&format!("data       {set}"));
    }
}

/// Prints the history of weights, oldest entry first.
fn made(history: &[HistoryEntry]) {
    for line in history::lines(history) {
        ui::print(&format!("made       {line}"));
    }
}

/// Prints the training settings and the errors on held-out frames.
fn trained(training: Option<&Value>, scores: Option<Scores>) {
    if let Some(training) = training {
        ui::print(&format!(
            "training   {} steps of {} images, peak learning rate {}, seed {}",
            training["steps"],
            training["batch"],
            training["learning_rate"].as_f64().unwrap_or_default(),
            training["seed"]
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

/// The settings of a training, where this build knows them with what a file leaves open.
fn training(note: Option<&String>) -> Result<Option<Value>> {
    #[cfg(feature = "train")]
    type Training = lsdc_train::training::TrainConfig;
    #[cfg(not(feature = "train"))]
    type Training = Value;
    let training: Option<Training> = parsed(note)?;
    Ok(training.map(|training| json!(training)))
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
    written(&args.output, &bytes)
}

fn export(args: &ExportNetwork) -> Result<()> {
    check_output(&args.onnx, args.force)?;
    let weights = open_weights(Some(&args.input))?;
    let origin = weights_name(Some(&args.input))?;
    let bytes = to_onnx(&weights, &origin)?;
    ui::say(&format!("opset {OPSET}, f32; weights {origin}"));
    written(&args.onnx, &bytes)
}

fn written(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically(path, |out| out.write_all(bytes))?;
    ui::print(&format!(
        "written   {}, {:.1} MB",
        path.display(),
        bytes.len() as f64 / 1e6
    ));
    Ok(())
}
