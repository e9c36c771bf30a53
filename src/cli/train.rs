//! `lsdc train`: a run folder, a bar, and stopping cleanly.

use super::args::{Settings, Train};
use super::dashboard::Dashboard;
use super::{Exit, settings, ui};
use crate::config::Config;
use lsdc_core::fit::FitConfig;
use lsdc_eval::data::{Shard, write_atomically};
use lsdc_eval::fit_settings::FitSettings;
use lsdc_eval::predict::Method;
use lsdc_files::error::{Error, Result};
use lsdc_paper::systems::{SystemConfig, trainer};
use lsdc_train::device::devices;
use lsdc_train::training::{HeldOutUnit, RunOutcome, Subject, Trainer};
use lsdc_weights::provenance::differences;
use serde_json::{Value, json};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

const SETTINGS: &str = "config.toml";
const DATA: &str = "data.json";

pub(super) fn run(args: &Train) -> Result<Exit> {
    let devices = devices(&args.device)?;
    let (folder, config) = match &args.resume {
        Some(folder) => (folder.clone(), resumed(&folder.join(SETTINGS))?),
        None => start(args)?,
    };
    let frames = settings::open_all(&config.data)?;
    let mut data = lsdc_eval::data::frames_record(&frames);
    if let Some(teacher) = &config.train.teacher {
        data["teacher"] = teacher.identity()?;
    }
    if args.resume.is_some() {
        check_data(&folder.join(DATA), &data)?;
    }
    let run = Run {
        args,
        folder,
        config: &config,
        data,
    };
    let train = config.train.clone();
    if let Some(system) = config.system.clone() {
        let words = begins(&system);
        let trainer = trainer(&run.folder, system, train, frames, &devices)?;
        if args.resume.is_none() {
            ui::say(&words);
        }
        return run.go(&trainer);
    }
    let fit = config.fit.over(&FitConfig::default())?;
    let network = config.network();
    run.go(&Trainer::new(
        &run.folder,
        network,
        fit,
        train,
        frames,
        &devices,
    )?)
}

/// A run folder with its settings, and what is known of its frames.
struct Run<'a> {
    args: &'a Train,
    folder: PathBuf,
    config: &'a Config,
    data: Value,
}

impl Run<'_> {
    fn go<S: Subject>(&self, trainer: &Trainer<S>) -> Result<Exit> {
        let (args, folder) = (self.args, &self.folder);
        if args.prepare {
            return prepare(trainer, args.shard.unwrap_or(Shard::WHOLE));
        }
        if args.resume.is_none() {
            // A run that cannot begin leaves no folder.
            trainer.check_start()?;
            create(folder, self.config, &args.device)?;
            write_json(&folder.join(DATA), &self.data)?;
        }
        ui::say(&format!("run folder {}", folder.display()));
        let mut dashboard = Dashboard::new(self.config.train.steps);
        let outcome = trainer.run(&ui::stop_flag(), |event| dashboard.show(event))?;
        dashboard.finish();
        match outcome {
            RunOutcome::Finished => {
                ui::print(&format!("written   {}", trainer.weights_path().display()));
                Ok(Exit::Done)
            }
            RunOutcome::Stopped(step) => {
                ui::say(&format!("stopped after step {step}"));
                ui::say(&format!(
                    "hint: go on with `lsdc train --resume {}`",
                    folder.display()
                ));
                Ok(Exit::Interrupted)
            }
        }
    }
}

/// The settings of a run that was begun before.
fn resumed(path: &Path) -> Result<Config> {
    let mut config = Config::load(Some(path), &[])?;
    let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
    if !text.contains("held_out_by") {
        // Before there was a choice, frames were held out.
        config.train.held_out_by = HeldOutUnit::Frames;
    }
    Ok(config)
}

/// Computes what the run keeps in files.
fn prepare<S: Subject>(trainer: &Trainer<S>, shard: Shard) -> Result<Exit> {
    let bar = ui::bar(0, "frames");
    let done = trainer.prepare(shard, &ui::stop_flag(), |done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    if done {
        return Ok(Exit::Done);
    }
    ui::say("hint: the same command goes on where this one stopped");
    Ok(Exit::Interrupted)
}

/// Describes what a system starts from.
fn begins(system: &SystemConfig) -> String {
    let source = system.kind().source();
    match system.pretrained() {
        Some(path) => format!("{source}; the encoder starts from `{}`", path.display()),
        None => format!("{source}; all weights start at random"),
    }
}

/// The settings, which must be of the method that is asked for.
fn configured(args: &Train) -> Result<(Option<PathBuf>, Config)> {
    let mut file = args.settings.config.clone();
    if let (Some(Method::System(kind)), None) = (args.method, &file) {
        file = Some(PathBuf::from(format!("{}.toml", kind.name())));
    }
    let config = Settings {
        config: file.clone(),
        set: args.settings.set.clone(),
    }
    .load()?;
    let found = config.system.as_ref();
    let found = found.map_or(Method::Lsdc, |system| Method::System(system.kind()));
    match args.method.filter(|method| *method != found) {
        None => Ok((file, config)),
        Some(method) => Err(Error::config(format!(
            "the configuration is of {}, not of {}",
            found.name(),
            method.name()
        ))
        .hint("leave `--method` or `--config` out")),
    }
}

/// The folder and settings of a new run.
fn start(args: &Train) -> Result<(PathBuf, Config)> {
    let (file, mut config) = configured(args)?;
    args.source.apply(&mut config.data);
    config.train.seed = args.seed.unwrap_or(config.train.seed);
    config.fit = FitSettings::all(&config.fit.over(&FitConfig::default())?)?;
    let stem = file.as_deref().and_then(Path::file_stem);
    let name = stem.map_or("default".into(), |s| s.to_string_lossy().into_owned());
    let folder = args
        .output
        .clone()
        .unwrap_or_else(|| Path::new("runs").join(name));
    if !args.prepare && folder.join(SETTINGS).exists() {
        return Err(
            Error::config(format!("`{}` already holds a run", folder.display()))
                .hint("go on with it by --resume DIR, or give another folder with -o DIR"),
        );
    }
    Ok((folder, config))
}

/// Checks that a run goes on with the frames that it began with.
fn check_data(path: &Path, data: &Value) -> Result<()> {
    let text = match std::fs::read_to_string(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => {
            ui::warn(&format!(
                "warning: `{}` is missing: whether the run began with these frames is not known",
                path.display()
            ));
            return write_json(path, data);
        }
        text => text.map_err(|e| Error::read(path, e))?,
    };
    let before =
        serde_json::from_str(&text).map_err(|e| Error::format(path, "is damaged").because(e))?;
    let found = differences(&before, data);
    if found.is_empty() {
        return Ok(());
    }
    Err(Error::config(format!(
        "`{}` belongs to a run on other data: {}",
        path.display(),
        found.join("; ")
    ))
    .hint("bring back the frames that it began with, or begin another run: -o DIR"))
}

fn write_json(path: &Path, value: &Value) -> Result<()> {
    write_atomically(path, |out| writeln!(out, "{value:#}"))
}

/// Writes the resolved settings and the environment of a new run.
fn create(folder: &Path, config: &Config, device: &str) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
    let environment = json!({
        "lsdc": env!("CARGO_PKG_VERSION"),
        "os": std::env::consts::OS,
        "architecture": std::env::consts::ARCH,
        "threads": std::thread::available_parallelism().map_or(1, usize::from),
        "device": device,
        "seed": config.train.seed,
    });
    write_json(&folder.join("env.json"), &environment)?;
    let settings = config.to_toml()?;
    write_atomically(&folder.join(SETTINGS), |out| {
        out.write_all(settings.as_bytes())
    })
}
