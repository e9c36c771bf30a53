//! `lsdc calibrate`: what training learns after its last step, for weights that exist.

use super::args::Calibrate;
use super::{Exit, settings, ui};
use lsdc_core::Weights;
use lsdc_core::fit::Lambda;
use lsdc_eval::data::{DataConfig, Dataset, DatasetKind, Split, check_output, write_atomically};
use lsdc_eval::sampling::{Interpolation, Protocol, ProtocolPreset};
use lsdc_files::error::{Error, Result};
use lsdc_train::device::device;
use lsdc_train::training::{self, HeldOutUnit, Scenes, TrainConfig};
use lsdc_weights::TRAINING_NOTE;
use lsdc_weights::history::{self, HistoryEntry};
use lsdc_weights::{Precision, head_hash, open_weights, to_bytes};
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
    let mut data = dataset(args)?;
    args.source.apply(&mut data);
    let frames = settings::open(&data, Split::Train)?;
    let record = lsdc_eval::data::frames_record(frames.as_ref());
    let keeps_prior = !args.only_errors && training::keeps_prior(&weights, frames.as_ref())?;
    if keeps_prior {
        ui::say(&format!(
            "the prior of the weights stays: {} frames are too few to learn one of {} basis functions",
            frames.len(),
            weights.network.bases
        ));
    }
    // The protocol of a training is for its own frames, and for datasets that it belongs to.
    let own = keeps_prior || matches!(data.dataset, DatasetKind::Scans | DatasetKind::Folder);
    if own && !was_trained_on(&weights, &record)? {
        config.protocol = own_protocol(frames.as_ref(), &weights)?;
        if keeps_prior {
            config.held_out = 0;
        }
        ui::say(&format!(
            "no training of the weights was on exactly these {} frames: all count as unseen; {}",
            frames.len(),
            config.protocol
        ));
    }
    let started = Instant::now();
    let bar = ui::bar(frames.len(), "frames");
    let device = device(&args.model.device)?;
    let progress = |done: usize, total: usize| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    };
    let scenes = Scenes::of(frames.as_ref(), config.scenes.as_deref())?;
    let head = head_hash(&weights.network)?;
    if head.is_none() && weights.network.extractor.encoder > 0 {
        ui::say(
            "warning: the depth head of the encoder is not installed, so errors are learned without the guide that \
             `lsdc complete` uses where it is (`lsdc weights get anything`)",
        );
    }
    let learned = if args.only_errors {
        let all: Vec<usize> = (0..frames.len()).collect();
        let frames = frames.as_ref();
        Some(training::learn_errors(
            &mut weights,
            frames,
            &all,
            &scenes,
            &config,
            &device,
            progress,
        )?)
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
        data: record,
        seconds: started.elapsed().as_secs_f64(),
        ..history::changed(by, args.model.weights.as_deref(), &weights)?
    };
    // The training settings that calibration uses.
    made.settings["seed"] = json!(config.seed);
    made.settings["held_out"] = json!(config.held_out);
    made.settings["scenes"] = json!(config.scenes);
    made.settings["protocol"] = json!(config.protocol);
    made.settings["depth_head"] = json!(head);
    history::add(&mut weights.notes, [made])?;
    let bytes = to_bytes(&weights, Precision::Half)?;
    write_atomically(&args.output, |out| out.write_all(&bytes))?;
    if let Some(learned) = learned.as_ref().filter(|learned| learned.halved > 0) {
        ui::say(&format!(
            "half of the depths of {} of {} frames were given, which are fewer than {}",
            learned.halved,
            learned.frames,
            training::NUMBERS[training::NUMBERS.len() - 1]
        ));
    }
    if let Some(held) = learned.and_then(|learned| learned.coverage) {
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

/// The dataset of the settings, which may name nothing else by `--set`.
fn dataset(args: &Calibrate) -> Result<DataConfig> {
    let settings = args.settings.load()?;
    let other = args
        .settings
        .set
        .iter()
        .find(|set| !set.starts_with("data."));
    if let Some(other) = other {
        return Err(Error::config(format!(
            "`{other}` is no setting of the dataset, which is all that calibrating reads"
        ))
        .hint("its other settings are those of the training of the weights"));
    }
    if let Some(config) = &args.settings.config {
        ui::say(&format!("`{}`: only its dataset is read", config.display()));
    }
    Ok(settings.data)
}

/// Whether weights were trained on the frames of this record and no others, in some run.
fn was_trained_on(weights: &Weights, record: &Value) -> Result<bool> {
    let history = history::read(&weights.notes)?;
    let mut runs = history.iter().filter(|entry| entry.command == "train");
    Ok(runs.any(|run| run.data == *record))
}

/// The protocol of frames that weights were not trained on: that of their dataset, at the number of pixels that the
/// network reads, in the shape of each frame.
fn own_protocol(frames: &dyn Dataset, weights: &Weights) -> Result<Protocol> {
    let protocol = ProtocolPreset::named(frames.protocol())?.protocol;
    if protocol.resize.or(protocol.crop).is_some() {
        return Ok(protocol);
    }
    let [height, width] = weights.normalisation.input;
    Ok(Protocol {
        mask: true,
        pixels: Some(height * width),
        depth_resize: Interpolation::NearestMeasured,
        ..protocol
    })
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
    use lsdc_eval::data::Frame;

    /// Frames of any content, as laser scans are measured.
    struct Measured(&'static str);

    impl Dataset for Measured {
        fn description(&self) -> String {
            "frames".into()
        }

        fn protocol(&self) -> &'static str {
            self.0
        }

        fn len(&self) -> usize {
            1
        }

        fn id(&self, _: usize) -> String {
            "a".into()
        }

        fn load(&self, _: usize) -> Result<Frame> {
            Err(Error::config("there are names only"))
        }
    }

    #[test]
    fn own_frames_keep_their_shape_and_lose_hidden_returns() {
        let weights = Weights::builtin();
        let of = |name| own_protocol(&Measured(name), &weights).unwrap();
        // 228x304 pixels.
        assert_eq!(of("scans").pixels, Some(69_312));
        assert!(of("scans").occlusion.is_some() && of("full").occlusion.is_none());
        assert_eq!(of("full").depth_resize, Interpolation::NearestMeasured);
        assert_eq!(of("nyu"), Protocol::nyu());
    }

    #[test]
    fn frames_are_known_by_the_record_of_the_training() {
        let mut weights = Weights::builtin_small();
        let record = lsdc_eval::data::frames_record(&Measured("scans"));
        assert!(!was_trained_on(&weights, &record).unwrap());
        let run = HistoryEntry {
            data: record.clone(),
            ..HistoryEntry::now("train")
        };
        history::add(&mut weights.notes, [run]).unwrap();
        assert!(was_trained_on(&weights, &record).unwrap());
    }

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
