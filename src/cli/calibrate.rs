//! `lsdc calibrate`: what training learns after its last step, for weights that exist.

use super::args::Calibrate;
use super::{Exit, settings, ui};
use crate::data::{DataConfig, Split, write_atomically};
use crate::device::device;
use crate::error::{Error, Result};
use crate::history::{self, Made};
use crate::model::{Precision, to_bytes};
use crate::predict::open_weights;
use crate::provenance;
use crate::train::{self, TRAINING_NOTE, TrainConfig};
use lsdc_core::fit::Lambda;
use serde_json::json;
use std::time::Instant;

pub(super) fn run(args: &Calibrate) -> Result<Exit> {
    if args.output.exists() && !args.force {
        return Err(Error::config(format!("`{}` exists", args.output.display()))
            .hint("give --force to replace it"));
    }
    let mut weights = open_weights(args.model.weights.as_deref())?;
    if !args.only_errors {
        let mut fit = weights.fit()?.unwrap_or_default();
        if let Some(named) = args.fit_method {
            fit.method = named.method;
            fit.lambda = Lambda::Evidence;
        }
        fit.joint.cosines = args.cosines.unwrap_or(fit.joint.cosines);
        fit.check()?;
        weights.record_fit(&fit);
    }
    let config: TrainConfig = match weights.notes.get(TRAINING_NOTE) {
        None => TrainConfig::default(),
        Some(json) => serde_json::from_str(json).map_err(|e| {
            Error::weights("the `training` record of the weights cannot be read").because(e)
        })?,
    };
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
    let held = if args.only_errors {
        let all: Vec<usize> = (0..frames.len()).collect();
        let frames = frames.as_ref();
        train::learn_errors(&mut weights, frames, &all, &config, &device, progress)?.held
    } else {
        train::calibrate(&mut weights, frames.as_ref(), &config, &device, progress)?
    };
    bar.finish_and_clear();
    let by = if args.only_errors {
        "calibrate --only-errors"
    } else {
        "calibrate"
    };
    let mut made = Made {
        data: provenance::frames(frames.as_ref()),
        seconds: started.elapsed().as_secs_f64(),
        ..history::changed(by, args.model.weights.as_deref(), &weights)?
    };
    // What calibrating takes from the settings of a training.
    made.settings["seed"] = json!(config.seed);
    made.settings["held_out"] = json!(config.held_out);
    made.settings["protocol"] = json!(config.protocol);
    history::add(&mut weights.notes, [made])?;
    let bytes = to_bytes(&weights, Precision::Half)?;
    write_atomically(&args.output, |out| out.write_all(&bytes))?;
    if let Some(held) = held {
        for (number, (one, two)) in train::NUMBERS.iter().zip(held) {
            ui::print(&format!(
                "{number:>5} points: intervals of 68.3 % hold {:.1} % of errors in scenes left out, those of \
                 95.4 % {:.1} %",
                100.0 * one,
                100.0 * two
            ));
        }
    }
    ui::print(&format!("written   {}", args.output.display()));
    Ok(Exit::Done)
}
