//! `lsdc weights info` of a system that the paper compares itself with.

use super::{licences, made, parsed, pretty, trained, training};
use crate::cli::ui;
use lsdc_eval::metrics::Scores;
use lsdc_files::error::Result;
use lsdc_paper::systems::SystemWeights;
use lsdc_weights::{SCORES_NOTE, TRAINING_NOTE, history, training_sets};
use serde_json::{Value, json};
use std::path::Path;

/// What weights of a system are.
pub(super) fn info(path: &Path, as_json: bool) -> Result<()> {
    let system = SystemWeights::open(path)?;
    let training = training(system.notes.get(TRAINING_NOTE))?;
    let scores: Option<Scores> = parsed(system.notes.get(SCORES_NOTE))?;
    let history = history::read(&system.notes)?;
    let trained_on = training_sets::of(&system.hash, &history, false);
    let parameters = system.parameters()?;
    if as_json {
        let value = json!({
            "parameters": parameters,
            "never_run": system.config.never_run(),
            "system": system.config,
            "normalisation": system.normalisation,
            "training": training,
            "held_out": scores,
            "licence": Value::Null,
            "trained_on": trained_on,
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
    trained(training.as_ref(), scores);
    licences(None, &trained_on);
    made(&history);
    Ok(())
}
