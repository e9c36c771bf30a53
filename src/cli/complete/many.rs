//! Many images, whose results go into a folder.

use super::calibration::Calibration;
use super::export;
use super::failures::Failures;
use super::flow;
use super::frame::Engine;
use super::inputs;
use super::job::Job;
use super::outputs::Outputs;
use super::record::Records;
use super::settings::{Destination, Settings};
use super::summary::Summary;
use super::tally::Tally;
use super::video::{Before, Chain};
use super::views;
use crate::cli::{Exit, ui};
use lsdc_eval::data::{self, Shard};
use lsdc_eval::predict::GuideSpec;
use lsdc_files::Workspace;
use lsdc_files::error::{Error, Result};
use std::collections::HashSet;
use std::path::Path;
use std::sync::atomic::Ordering;

pub(super) fn run(settings: &Settings) -> Result<Exit> {
    let Destination::Folder(output) = &settings.destination else {
        let what = "where the results of many images go is missing";
        return Err(Error::config(what).hint("give -o DIR"));
    };
    if settings.sigma.is_some() {
        return Err(Error::config("`--sigma` is for one image")
            .hint("give lists with a fourth column, or a model of COLMAP"));
    }
    if let Some(GuideSpec::Files(source)) = &settings.guide
        && !source.path.is_dir()
    {
        return Err(Error::config("one `--guide` is for one image")
            .hint("give a folder of guides that are called as the images are"));
    }
    if settings.temporal && settings.shard != Shard::WHOLE {
        return Err(Error::config(
            "`--temporal` cannot be combined with `--shard`: a frame needs the one before",
        )
        .hint("give either of them"));
    }
    if let (true, Some(option)) = (settings.rgb.is_empty(), settings.recording.of_bags()) {
        let what = format!("`{option}` is for results in a recording");
        return Err(Error::config(what).hint("give -o FILE.mcap, or leave it out"));
    }
    if settings.temporal && settings.rgb.is_empty() {
        return Err(Error::config("`--temporal` is not for recordings")
            .hint("leave it out, or write the images to files"));
    }
    if settings.views.is_some() && settings.temporal {
        return Err(
            Error::config("`--views` cannot be combined with `--temporal`")
                .hint("give either of them: the poses, or the order of the images"),
        );
    }
    let failures = Failures::new(settings.json);
    let model = inputs::model(settings)?;
    let workspaces = export::workspaces(settings, model.as_ref(), output)?;
    let mut jobs = inputs::many(settings, model.as_ref(), output, &failures)?;
    views::attach(settings, &mut jobs)?;
    jobs.retain(|job| settings.shard.holds(&job.name.to_string_lossy()));
    let records = Records::new(settings, output)?;
    let Plan { left, there } = Plan::of(settings, &workspaces, output, jobs, &records)?;
    let folders: HashSet<&Path> = left.iter().map(|frame| frame.outputs.folder()).collect();
    for folder in folders {
        data::check_writable(folder)?;
        data::remove_leftovers(folder);
    }
    let engine = Engine::new(settings, settings.json)?;
    for workspace in &workspaces {
        workspace.create(settings.force)?;
    }
    let stop = ui::stop_flag();
    let bar = ui::bar(left.len(), "frames");
    let failures = failures.beside(&bar);

    let mut tally = Tally::new(&bar, settings.json);
    let mut chain = Chain::default();
    let mut calibration = Calibration::new(settings);
    flow::run(
        &left,
        &engine,
        (&failures, &stop),
        |frame| &frame.job.name,
        |frame| {
            // In this order: what changes in between is noticed the next time.
            let inputs = records.inputs(settings, &frame.job)?;
            Ok((inputs, frame.job.load(settings)?))
        },
        |frame, loaded, prepared| {
            let before = chain.before(frame.before.as_ref(), &loaded.rgb)?;
            let views = loaded.views.as_ref();
            let fitted = prepared.fit(&loaded.points, before.as_deref(), views)?;
            chain.go_on(frame.outputs.weights(), &loaded.rgb, &fitted);
            Ok(fitted)
        },
        |Frame { job, outputs, .. }, inputs, loaded, completed| {
            let format_data = outputs.format_data(loaded, completed)?;
            let summary = Summary::new(&job.name, loaded, completed, &format_data);
            records.forget(job)?;
            outputs.write(loaded, completed, &format_data, &summary)?;
            records.write(job, inputs, &summary)?;
            tally.add(&job.name, &summary);
            for warning in calibration.add(loaded, completed, job.recorded()) {
                tally.warn(&warning);
            }
            Ok(())
        },
    )?;
    bar.finish_and_clear();

    let (done, failed) = (tally.count(), failures.count());
    tally.print_totals(there, failed);
    export::finish(&workspaces, settings.json)?;
    if !settings.json {
        ui::tell(&format!("written   {}", output.display()));
    }
    if stop.load(Ordering::Relaxed) && done + failed < left.len() {
        ui::say("hint: the same command goes on with what is left");
        return Ok(Exit::Interrupted);
    }
    Ok(if failed > 0 {
        Exit::Partial
    } else {
        Exit::Done
    })
}

/// A frame that is left to do.
struct Frame<'a> {
    job: Job,
    outputs: Outputs<'a>,
    /// In a video, what may come before.
    before: Option<Before>,
}

/// Remaining frames, and the number of frames already done.
struct Plan<'a> {
    left: Vec<Frame<'a>>,
    there: usize,
}

impl<'a> Plan<'a> {
    /// Results that are there are used again if this run would make the same; results of other
    /// settings or inputs are an error. What has no record is made again, and replaced by nothing
    /// but an equal.
    fn of(
        settings: &'a Settings,
        workspaces: &'a [Workspace],
        output: &Path,
        jobs: Vec<Job>,
        records: &Records,
    ) -> Result<Self> {
        let mut plan = Self {
            left: Vec::new(),
            there: 0,
        };
        let mut others = Vec::new();
        let mut before = None;
        // A frame of a video depends on all before it.
        let mut unbroken = true;
        for job in jobs {
            let outputs = Outputs::below(settings, workspaces, output, &job);
            outputs.check_apart(&job)?;
            let this = outputs.weights().map(|weights| Before {
                weights: weights.to_owned(),
                image: job.image.clone(),
            });
            let keeps = !settings.force && outputs.any_exists();
            let record = keeps.then(|| records.read(&job)).flatten();
            let difference = match &record {
                Some(record) => records.difference(settings, &job, record)?,
                None => None,
            };
            match record {
                Some(_) if difference.is_some() => others.extend(difference.map(|d| (job.name, d))),
                Some(record) if outputs.exist() && unbroken => {
                    plan.there += 1;
                    if settings.json {
                        ui::print(&unchanged(record.report()).to_string());
                    }
                }
                _ => {
                    unbroken = !settings.temporal;
                    plan.left.push(Frame {
                        job,
                        outputs,
                        before: before.take(),
                    });
                }
            }
            before = this;
        }
        let Some((name, difference)) = others.first() else {
            return Ok(plan);
        };
        Err(Error::config(format!(
            "`{}` holds {} of other settings or inputs: `{}`: {difference}",
            output.display(),
            ui::counted(others.len(), "result"),
            name.display()
        ))
        .hint("give --force to make them anew, or -o DIR to write elsewhere"))
    }
}

/// JSON object of a frame that is already done.
fn unchanged(report: &serde_json::Value) -> serde_json::Value {
    let mut report = report.clone();
    report["status"] = "unchanged".into();
    report
}
