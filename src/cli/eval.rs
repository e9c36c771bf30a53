//! `lsdc eval`: methods side by side on a dataset.

use super::args::{Eval, Model};
use super::names::Names;
use super::network::{
    at_quality, name_of_own_guide, open_guide, open_guided_completer, open_system, own_guide,
    system_candidates,
};
use super::{Exit, settings, ui};
use lsdc_core::fit::FitMethod;
use lsdc_core::{Completer, Quality};
use lsdc_eval::data::{DataConfig, check_output, write_atomically, write_npy};
use lsdc_eval::evaluation::{Candidate, Evaluation, Journal};
use lsdc_eval::fit_settings::FitSettings;
use lsdc_eval::predict::{GuideSpec, Guides, Method};
use lsdc_eval::report::{EvaluationReport, ExampleFrame, Heading};
use lsdc_eval::sampling::ProtocolPreset;
use lsdc_files::error::{Error, Result};
use lsdc_weights::{weights_hash, weights_name};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

const JOURNAL: &str = "journal.jsonl";

pub(super) fn run(args: &Eval) -> Result<Exit> {
    let mut config = args.settings.load()?;
    args.source.apply(&mut config.data);
    args.apply(&mut config.eval);
    config.eval.check()?;
    let folder = args.folder();
    let outputs = Outputs::of(args, folder.as_deref())?;
    let eval = &config.eval;
    let frames = settings::open(&config.data, args.draws.split)?;
    let preset = ProtocolPreset::named(eval.preset.as_deref().unwrap_or(frames.protocol()))?;
    let mut protocol = eval.protocol.unwrap_or(preset.protocol);
    if let Some(depth_resize) = args.depth_resize {
        protocol.depth_resize = depth_resize;
    }
    let candidates = candidates(args, &eval.methods)?;
    let network = candidates
        .iter()
        .any(|(_, c)| matches!(c, Candidate::Method(Method::Lsdc)))
        .then(|| network(args, &config.fit))
        .transpose()?;
    let is_changed = args.fit.quality != Quality::Standard || args.fit.encoder.side.is_some();
    if network.is_none() && is_changed {
        let what =
            "`--quality` and `--encoder-side` would change nothing: they are for the method `lsdc`";
        return Err(Error::config(what).hint("add `--method lsdc`, or leave it out"));
    }
    check_guides(args, network.as_ref().map(|(completer, _)| completer))?;
    let own_guide = match &network {
        Some((completer, _)) if completer.has_depth_head() => {
            let Model { weights, device } = &args.model;
            own_guide(weights.as_deref(), device, args.guide.as_ref())?
        }
        _ => None,
    };
    let guide = args.guide.clone();
    let guide = guide.map(|guide| guide.with_head(args.head)).transpose()?;
    let monocular = open_guide(guide.as_ref(), &args.model.device)?;
    let guides = match (&guide, &monocular) {
        (Some(GuideSpec::Files(source)), _) => Some(Guides::Files(source)),
        (_, monocular) => monocular.as_ref().map(Guides::Predicted),
    };
    let evaluation = Evaluation {
        frames: &*frames,
        candidates,
        completer: network.as_ref().map(|(completer, _)| completer),
        guides,
        protocol,
        points: eval.points.clone().unwrap_or(preset.points),
        hold_out: eval.hold_out,
        noise: eval.noise,
        seeds: eval.draws(),
        rules: eval.rules,
        uncertainty: args.uncertainty,
        sigma_cut: args.uncertainty.then_some(eval.sigma_cut),
        limit: eval.limit,
    };
    let name = format!("{} {}", config.data.dataset.name(), args.draws.split.name());
    let followed = if eval.protocol.is_some() {
        "of the configuration".to_owned()
    } else {
        format!("{}: {}", preset.name, preset.source)
    };
    let guided = match (&evaluation.guides, &own_guide) {
        (None, None) => String::new(),
        (None, Some(own)) => format!(", guided by the {}", name_of_own_guide(own)),
        (Some(guides), _) => format!(", beside guides {guides}"),
    };
    let measured = if args.uncertainty {
        ", with its standard deviations"
    } else {
        ""
    };
    let weights = network
        .as_ref()
        .map(|(_, name)| format!("{name}{guided}{measured}"));
    let weights_file = args.model.weights.as_deref();
    let contents = network.as_ref().map(|_| weights_hash(weights_file));
    let mut inputs = json!({
        "data": DataConfig { root: None, ..config.data.clone() },
        "split": args.draws.split,
        "weights": contents.transpose()?,
    });
    if let Some(own) = &own_guide {
        inputs["depth_head"] = json!(own);
    }
    let heading = evaluation.heading(&name, &followed, weights, inputs)?;
    let computes = |(_, candidate): &(String, Candidate)| {
        matches!(
            candidate,
            Candidate::Method(Method::Lsdc) | Candidate::System { .. }
        )
    };
    let on_device = evaluation.candidates.iter().any(computes);
    let place = json!({
        "folder": settings::folder(&config.data),
        "device": on_device.then_some(&args.model.device),
    });
    let journal = match &folder {
        None => Journal::disabled(),
        Some(folder) => journal(folder, &heading, &place, args.force)?,
    };
    if !journal.is_empty() {
        ui::say(&format!(
            "{} results of an earlier run are used again; --force measures them anew",
            journal.len()
        ));
    }
    let stop = ui::stop_flag();
    let bar = ui::bar(frames.len(), "frames");
    let report = evaluation.run(heading, args.shard, journal, |done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
        ui::unless(&stop)
    })?;
    bar.finish_and_clear();

    ui::print(&report.to_string());
    for failure in report.failures() {
        ui::say(&format!(
            "frame `{}` failed: {}",
            failure.frame, failure.error
        ));
    }
    if stop.load(Ordering::Relaxed) {
        return Ok(Exit::Interrupted);
    }
    let exhibits = match &outputs.html {
        None => Vec::new(),
        Some(_) => exhibits(&evaluation, &report)?,
    };
    outputs.write(&report, &exhibits)?;
    if let Some(folder) = &args.save {
        save(&evaluation, &report, folder)?;
    }
    Ok(if report.failures().is_empty() {
        Exit::Done
    } else {
        Exit::Partial
    })
}

/// The network with its fit, and what names both in reports.
fn network(args: &Eval, settings: &FitSettings) -> Result<(Completer, String)> {
    let weights = args.model.weights.as_deref();
    let completer = open_guided_completer(weights, &args.model.device, args.guide.as_ref())?;
    let mut fit = settings.over(completer.fit_config())?;
    args.fit.apply(&mut fit);
    let (quality, side) = (args.fit.quality, args.fit.encoder.side);
    let completer = at_quality(&completer.with_fit(fit), quality, side, weights)?;
    let quality = match completer.quality() {
        Quality::Standard => "",
        Quality::Best => "; quality best",
    };
    let (name, fit) = (weights_name(weights)?, completer.fit_config());
    let side = side.map_or(String::new(), |side| format!("; encoder side {side}"));
    let name = format!("{name}; {fit}{quality}{side}");
    Ok((completer, name))
}

/// Checks that guides change something, and are there for every frame.
fn check_guides(args: &Eval, completer: Option<&Completer>) -> Result<()> {
    let spec = match &args.guide {
        None | Some(GuideSpec::None) => return Ok(()),
        Some(spec) => spec,
    };
    let method = completer.map(|completer| completer.fit_config().method);
    if method.is_none_or(|method| method == FitMethod::Field) {
        return Err(Error::config(
            "`--guide` would change nothing: it becomes basis functions of the method `lsdc`, which a field alone \
             does not have",
        ));
    }
    match spec {
        GuideSpec::Files(source) if !source.path.is_dir() => Err(Error::config(format!(
            "`{}` is no folder of guides",
            source.path.display()
        ))
        .hint("guides are called as the frames are, such as FRAME.npy")),
        GuideSpec::None | GuideSpec::Files(_) | GuideSpec::DepthAnything(_) => Ok(()),
    }
}

fn journal(folder: &Path, heading: &Heading, place: &Value, anew: bool) -> Result<Journal> {
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
    let path = folder.join(JOURNAL);
    if anew {
        Journal::clear(&path)?;
    }
    Journal::open(&path, heading, place)
}

/// The methods that are asked for, the systems, and the predictions of others; with systems or predictions alone, only
/// those.
fn candidates(args: &Eval, methods: &[Method]) -> Result<Vec<(String, Candidate)>> {
    let others = args.predictions.iter().map(|(name, folder)| {
        if folder.is_dir() {
            Ok((name.clone(), Candidate::Files(folder.clone())))
        } else {
            Err(Error::config(format!(
                "there is no folder `{}`",
                folder.display()
            )))
        }
    });
    let alone = args.predictions.is_empty() && args.system.is_empty();
    let ours = methods
        .iter()
        .filter(|_| alone || !args.method.is_empty())
        .map(|method| {
            let candidate = match method {
                Method::System(kind) => {
                    let Model { weights, device } = &args.model;
                    open_system(*kind, weights.as_deref(), device)?.candidate(None)
                }
                method => Candidate::Method(*method),
            };
            Ok((method.name().to_owned(), candidate))
        });
    let systems = system_candidates(&args.system, &args.model.device)?;
    let systems = systems.into_iter().map(Ok);
    let all: Vec<(String, Candidate)> = ours.chain(systems).chain(others).collect::<Result<_>>()?;
    let mut names: Vec<&str> = all.iter().map(|(name, _)| name.as_str()).collect();
    names.sort_unstable();
    if let Some([name, _]) = names.array_windows().find(|[a, b]| a == b) {
        return Err(Error::config(format!("`{name}` is there twice"))
            .hint("give each a name of its own: --predictions NAME=DIR, --system NAME=FILE"));
    }
    if all.is_empty() {
        return Err(Error::config("there is nothing to measure").hint("give --method"));
    }
    Ok(all)
}

fn exhibits(evaluation: &Evaluation, report: &EvaluationReport) -> Result<Vec<ExampleFrame>> {
    report
        .example_frames()
        .into_iter()
        .map(|(role, frame, seed)| evaluation.example(role, frame, seed))
        .collect()
}

/// Writes every prediction as `METHOD/seedN/FRAME.npy`, as `--predictions` reads them.
fn save(evaluation: &Evaluation, report: &EvaluationReport, folder: &Path) -> Result<()> {
    let frames: BTreeSet<&str> = report.frames().keys().map(|(frame, _)| &**frame).collect();
    let mut names = Names::default();
    frames.into_iter().try_for_each(|frame| names.add(frame))?;
    for (frame, seed) in report.frames().keys() {
        let exhibit = evaluation.example("saved", frame, *seed)?;
        for (method, _, depth) in &exhibit.predictions {
            let path = folder.join(method).join(format!("seed{seed}/{frame}.npy"));
            if let Some(parent) = path.parent() {
                std::fs::create_dir_all(parent).map_err(|e| Error::write(parent, e))?;
            }
            write_npy(&path, depth)?;
        }
    }
    Ok(())
}

/// The files of a report.
#[derive(Default)]
pub(super) struct Outputs {
    text: Option<PathBuf>,
    json: Option<PathBuf>,
    csv: Option<PathBuf>,
    html: Option<PathBuf>,
}

impl Outputs {
    /// The files that are asked for; those named one by one must not exist yet. In a folder, the
    /// journal guards them.
    fn of(args: &Eval, folder: Option<&Path>) -> Result<Self> {
        let named = [&args.json, &args.csv, &args.html];
        for path in named.into_iter().flatten() {
            check_output(path, args.force)?;
        }
        if let Some(path) = args
            .save
            .as_ref()
            .filter(|path| !args.force && path.exists())
        {
            return Err(Error::config(format!("`{}` exists", path.display()))
                .hint("give --force to replace it, or another name"));
        }
        let all = folder.map(Self::folder).unwrap_or_default();
        Ok(Self {
            text: all.text,
            json: args.json.clone().or(all.json),
            csv: args.csv.clone().or(all.csv),
            html: args.html.clone().or(all.html),
        })
    }

    /// All reports in one folder.
    pub(super) fn folder(folder: &Path) -> Self {
        let path = |name: &str| Some(folder.join(name));
        Self {
            text: path("report.txt"),
            json: path("report.json"),
            csv: path("frames.csv"),
            html: path("report.html"),
        }
    }

    pub(super) fn write(&self, report: &EvaluationReport, exhibits: &[ExampleFrame]) -> Result<()> {
        if let Some(path) = &self.text {
            let text = report.to_string();
            write_atomically(path, |out| out.write_all(text.as_bytes()))?;
        }
        if let Some(path) = &self.csv {
            report.write_csv(path)?;
        }
        if let Some(path) = &self.html {
            report.write_html(path, exhibits)?;
        }
        if let Some(path) = &self.json {
            report.write_json(path)?;
        }
        Ok(())
    }
}
