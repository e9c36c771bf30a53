//! `lsdc train`: a run folder, a bar, and stopping cleanly.

use super::args::Train;
use super::dashboard::Dashboard;
use super::{Exit, settings, ui};
use crate::config::{Config, FitSettings};
use crate::data::{Split, write_atomically};
use crate::device::devices;
use crate::error::{Cause, Error, Result};
use crate::train::{Outcome, Trainer};
use lsdc_core::fit::FitConfig;
use serde_json::json;
use std::path::{Path, PathBuf};

const SETTINGS: &str = "config.toml";

pub(super) fn run(args: &Train) -> Result<Exit> {
    let devices = devices(&args.device)?;
    let (folder, config) = match &args.resume {
        Some(folder) => (
            folder.clone(),
            Config::load(Some(&folder.join(SETTINGS)), &[])?,
        ),
        None => start(args)?,
    };
    let frames = settings::open(&config.data, Split::Train)?;
    let trainer = Trainer::new(
        &folder,
        config.network(),
        config.fit.over(&FitConfig::default())?,
        config.train.clone(),
        frames,
        &devices,
    )?;
    if args.resume.is_none() {
        prepare(&folder, &config, &args.device)?;
    }
    ui::say(&format!("run folder {}", folder.display()));
    let mut dashboard = Dashboard::new(config.train.steps);
    let outcome = trainer.run(&ui::stop_flag(), |event| dashboard.show(event))?;
    dashboard.finish();
    match outcome {
        Outcome::Finished => {
            ui::print(&format!(
                "written   {}",
                folder.join("weights.safetensors").display()
            ));
            Ok(Exit::Done)
        }
        Outcome::Stopped(step) => {
            ui::say(&format!("stopped after step {step}"));
            ui::say(&format!(
                "hint: go on with `lsdc train --resume {}`",
                folder.display()
            ));
            Ok(Exit::Interrupted)
        }
    }
}

/// The folder and settings of a new run.
fn start(args: &Train) -> Result<(PathBuf, Config)> {
    let mut config = args.settings.load()?;
    args.source.apply(&mut config.data);
    config.train.seed = args.seed.unwrap_or(config.train.seed);
    config.fit = FitSettings::all(&config.fit.over(&FitConfig::default())?)?;
    let stem = args.settings.config.as_deref().and_then(Path::file_stem);
    let name = stem.map_or("default".into(), |s| s.to_string_lossy().into_owned());
    let folder = args
        .output
        .clone()
        .unwrap_or_else(|| Path::new("runs").join(name));
    if folder.join(SETTINGS).exists() {
        return Err(
            Error::config(format!("`{}` already holds a run", folder.display()))
                .hint("go on with it by --resume DIR, or give another folder with -o DIR"),
        );
    }
    Ok((folder, config))
}

/// Writes the resolved settings and the environment of a new run.
fn prepare(folder: &Path, config: &Config, device: &str) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
    let environment = json!({
        "lsdc": env!("CARGO_PKG_VERSION"),
        "os": std::env::consts::OS,
        "architecture": std::env::consts::ARCH,
        "threads": std::thread::available_parallelism().map_or(1, usize::from),
        "device": device,
        "seed": config.train.seed,
    });
    let text = serde_json::to_string_pretty(&environment)
        .map_err(|e| Error::new(Cause::Write, "cannot encode the environment").because(e))?;
    write_atomically(&folder.join("env.json"), |out| writeln!(out, "{text}"))?;
    let settings = config.to_toml()?;
    write_atomically(&folder.join(SETTINGS), |out| {
        out.write_all(settings.as_bytes())
    })
}
