//! `lsdc calibrate`: what training learns after its last step, for weights that exist.

use super::args::Calibrate;
use super::{Exit, settings, ui};
use lsdc_core::Weights;
use lsdc_core::fit::Lambda;
use lsdc_eval::data::{DataConfig, Split, check_output, write_atomically};
use lsdc_files::error::{Error, Result};
use lsdc_train::device::device;
use lsdc_train::training::{self, HeldOutUnit, Scenes, TrainConfig};
use lsdc_weights::TRAINING_NOTE;
use lsdc_weights::history::{self, HistoryEntry};
use lsdc_weights::open_weights;

use lsdc_weights::{Precision, to_bytes};
use serde_json::{Value, json};
use std::time::Instant;

pub(super) fn run(args: &Calibrate) -> Result<Exit> {
    check_output(&args.output, args.force)?;
    let mut weights = open_weights(args.model.weights.as_deref())?;
    if !args.only_errors {
        let mut fit = weights.fit()?.unwrap_or_default();
        if let Some(method) = args.fit_method {
            fit.method = method;
            fit.lambda = Lambda::Evidence;
        }
        fit.joint.cosines = args.cosines.unwrap_or(fit.joint.cosines);
        fit.check()?;
        weights.record_fit(&fit);
    }
    let mut config = trained_by(&weights)?;
    config.scenes = args.scenes.clone().or(config.scenes);
    let mut data = DataConfig::default();
    args.source.apply(&mut data);
    let frames = settings::open(&data, Split::Train)?;
    let started = Instant::now();
    let bar = ui::bar(frames.len(), "frames");
    let device = device(&args.model.device)?;
    let progress = |done: usize, total: usize| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    };
    let scenes = Scenes::of(frames.as_ref(), config.scenes.as_deref())?;
    let held = if args.only_errors {
        let all: Vec<usize> = (0..frames.len()).collect();
        let frames = frames.as_ref();
        training::learn_errors(
            &mut weights,
            frames,
            &all,
            &scenes,
            &config,
            &device,
            progress,
        )?
        .coverage
    } else {
        training::calibrate(&mut weights, frames.as_ref(), &config, &device, progress)?
    };
    bar.finish_and_clear();
    let by = if args.only_errors {
        "calibrate --only-errors"
    } else {
        "calibrate"
    };
    let mut made = HistoryEntry {
        data: lsdc_eval::data::frames_record(frames.as_ref()),
        seconds: started.elapsed().as_secs_f64(),
        ..history::changed(by, args.model.weights.as_deref(), &weights)?
    };
    // What calibrating takes from the settings of a training.
    made.settings["seed"] = json!(config.seed);
    made.settings["held_out"] = json!(config.held_out);
    made.settings["scenes"] = json!(config.scenes);
    made.settings["protocol"] = json!(config.protocol);
    history::add(&mut weights.notes, [made])?;
    let bytes = to_bytes(&weights, Precision::Half)?;
    write_atomically(&args.output, |out| out.write_all(&bytes))?;
    if let Some(held) = held {
        for (number, (one, two)) in training::NUMBERS.iter().zip(held) {
            ui::print(&format!(
                "{number:>5} points: intervals of 68.3 % hold {:.1} % of errors in {} left out, those of \
                 95.4 % {:.1} %",
                100.0 * one,
                scenes.unit(),
                100.0 * two
            ));
        }
        if scenes.unit() == "frames" {
            ui::say(
                "hint: neighbouring frames of a video may be on both sides; name scenes by --scenes",
            );
        }
    }
    ui::print(&format!("written   {}", args.output.display()));
    Ok(Exit::Done)
}

/// The settings of the training of weights, which tell its frames from those that were held out.
fn trained_by(weights: &Weights) -> Result<TrainConfig> {
    let Some(json) = weights.notes.get(TRAINING_NOTE) else {
        return Ok(TrainConfig::default());
    };
    let read = |json: &str| {
        let mut note: Value = serde_json::from_str(json)?;
        if let Some(note) = note.as_object_mut() {
            // Before there was a choice, frames were held out.
            let frames = json!(HeldOutUnit::Frames);
            note.entry("held_out_by").or_insert(frames);
        }
        serde_json::from_value(note)
    };
    read(json).map_err(|e| {
        Error::weights("the `training` record of the weights cannot be read").because(e)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_calibrated_on_what_their_training_held_out() {
        let mut weights = Weights::builtin_small();
        let by = |weights: &Weights| trained_by(weights).unwrap().held_out_by;
        weights.notes.remove(TRAINING_NOTE);
        assert_eq!(by(&weights), HeldOutUnit::Scenes);
        for (json, expected) in [
            (r#"{"held_out":24}"#, HeldOutUnit::Frames),
            (r#"{"held_out_by":"scenes"}"#, HeldOutUnit::Scenes),
        ] {
            weights.notes.insert(TRAINING_NOTE.into(), json.into());
            assert_eq!(by(&weights), expected);
        }
    }
}
