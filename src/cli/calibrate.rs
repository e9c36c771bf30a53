//! `lsdc calibrate`: what training learns after its last step, for weights that exist.

use super::args::Calibrate;
use super::{Exit, settings, ui};
use crate::data::{DataConfig, Split, write_atomically};
use crate::device::device;
use crate::error::{Error, Result};
use crate::fit::Lambda;
use crate::predict::{open_weights, record_fit, recorded_fit};
use crate::train::{self, TRAINING_NOTE, TrainConfig};

pub(super) fn run(args: &Calibrate) -> Result<Exit> {
    if args.output.exists() && !args.force {
        return Err(Error::config(format!("`{}` exists", args.output.display()))
            .hint("give --force to replace it"));
    }
    let mut weights = open_weights(args.model.weights.as_deref())?;
    let mut fit = recorded_fit(&weights)?.unwrap_or_default();
    if let Some(named) = args.fit_method {
        fit.method = named.method;
        fit.lambda = Lambda::Evidence;
    }
    fit.joint.waves = args.waves.unwrap_or(fit.joint.waves);
    fit.check()?;
    record_fit(&mut weights, &fit)?;
    let config: TrainConfig = match weights.record.notes.get(TRAINING_NOTE) {
        None => TrainConfig::default(),
        Some(json) => serde_json::from_str(json).map_err(|e| {
            Error::weights("the `training` record of the weights cannot be read").because(e)
        })?,
    };
    let mut data = DataConfig::default();
    args.source.apply(&mut data);
    let frames = settings::open(&data, Split::Train)?;
    let bar = ui::bar(frames.len(), "frames");
    let device = device(&args.model.device)?;
    train::calibrate(
        &mut weights,
        frames.as_ref(),
        &config,
        &device,
        |done, total| {
            bar.set_length(total as u64);
            bar.set_position(done as u64);
        },
    )?;
    bar.finish_and_clear();
    let bytes = weights.to_bytes()?;
    write_atomically(&args.output, |out| out.write_all(&bytes))?;
    ui::print(&format!("written   {}", args.output.display()));
    Ok(Exit::Done)
}
