//! `lsdc export`: frames of a dataset as files, for other programs.

use super::args::Export;
use super::names::Names;
use super::{Exit, settings, ui};
use image::RgbImage;
use lsdc_eval::data::{would_replace, write_npy, write_rgb};
use lsdc_eval::evaluation::Evaluation;
use lsdc_eval::metrics::Rules;
use lsdc_eval::sampling::{CompletionTask, ProtocolPreset};
use lsdc_files::error::{Error, Result};
use std::path::{Path, PathBuf};

pub(super) fn run(args: &Export) -> Result<Exit> {
    let mut config = args.settings.load()?;
    args.source.apply(&mut config.data);
    let eval = &config.eval;
    let name = args.protocol.as_deref().or(eval.preset.as_deref());
    let frames = settings::open(&config.data, args.split)?;
    let preset = ProtocolPreset::named(name.unwrap_or(frames.protocol()))?;
    let points = args.points.as_ref().or(eval.points.as_ref());
    let evaluation = Evaluation {
        frames: &*frames,
        candidates: Vec::new(),
        completer: None,
        guides: None,
        protocol: eval.protocol.unwrap_or(preset.protocol),
        points: points.unwrap_or(&preset.points).clone(),
        hold_out: args.hold_out.or(eval.hold_out),
        noise: args.noise.or(eval.noise),
        seeds: vec![args.seed],
        rules: Rules::default(),
        uncertainty: false,
        sigma_cut: None,
        limit: args.limit,
    };
    let indices = match args.index {
        None => 0..evaluation.total(),
        Some(index) if index < frames.len() => index..index + 1,
        Some(index) => {
            return Err(Error::config(format!(
                "there is no frame {index}: the split has {}",
                frames.len()
            )));
        }
    };
    let count = indices.len();
    let bar = ui::bar(count, "frames");
    let mut names = Names::default();
    for index in indices {
        names.add(&frames.id(index))?;
        let files = Files::of(&args.output, &frames.id(index));
        files.check(args.force)?;
        let frame = evaluation.frame(index)?;
        files.write(&frame.rgb, &evaluation.task(&frame, args.seed)?)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    ui::print(&format!("frames    {count} of {}", frames.description()));
    ui::print(&format!("steps     {}", evaluation.protocol));
    ui::print(&format!(
        "points    {}, seed {}",
        evaluation.points, args.seed
    ));
    if let Some(law) = evaluation.hold_out {
        ui::print(&format!("held out  {law}"));
    }
    ui::print(&format!("written   {}", args.output.display()));
    Ok(Exit::Done)
}

/// The files of a frame, as `--dataset marigold` reads them.
struct Files {
    rgb: PathBuf,
    sparse: PathBuf,
    truth: PathBuf,
}

impl Files {
    fn of(folder: &Path, frame: &str) -> Self {
        Self {
            rgb: folder.join("rgb").join(format!("{frame}.png")),
            sparse: folder.join("sparse").join(format!("{frame}.npy")),
            truth: folder.join("gt").join(format!("{frame}.npy")),
        }
    }

    fn all(&self) -> [&PathBuf; 3] {
        [&self.rgb, &self.sparse, &self.truth]
    }

    fn check(&self, force: bool) -> Result<()> {
        match self
            .all()
            .into_iter()
            .find(|path| !force && would_replace(path))
        {
            None => Ok(()),
            Some(path) => Err(Error::config(format!("`{}` exists", path.display()))
                .hint("give --force to replace it, or another folder")),
        }
    }

    fn write(&self, rgb: &RgbImage, task: &CompletionTask) -> Result<()> {
        for path in self.all() {
            if let Some(parent) = path.parent() {
                std::fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
            }
        }
        write_rgb(&self.rgb, rgb)?;
        write_npy(&self.truth, &task.truth)?;
        write_npy(&self.sparse, &task.sparse)
    }
}
