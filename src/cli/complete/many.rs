//! Many images: reading, network, fit and writing at the same time, each of another frame.

use super::failures::Failures;
use super::frame::{Engine, Fitted, Prepared};
use super::inputs::{self, Job, Loaded};
use super::outputs::{Outputs, check_folder};
use super::record::{Inputs, Records};
use super::summary::{Summary, left_out_of_clouds, left_out_of_points, raised};
use super::video::{Before, Chain};
use crate::cli::args::Complete;
use crate::cli::{Exit, ui};
use crate::data::{self, Shard};
use crate::error::{Cause, Error, Result};
use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use std::sync::atomic::Ordering;
use std::sync::mpsc::sync_channel;
use std::thread::ScopedJoinHandle;

/// Frames that wait between two stages.
const WAITING: usize = 2;

pub(super) fn run(args: &Complete) -> Result<Exit> {
    let output = args.output.as_deref().ok_or_else(|| {
        Error::config("where the results of many images go is missing").hint("give -o DIR")
    })?;
    check_folder(output)?;
    if args.sigma.is_some() {
        return Err(Error::config("`--sigma` is for one image")
            .hint("give lists with a fourth column, or a model of COLMAP"));
    }
    if args
        .guide
        .as_ref()
        .is_some_and(|guide| !guide.path.is_dir())
    {
        return Err(Error::config("one `--guide` is for one image")
            .hint("give a folder of guides that are called as the images are"));
    }
    if args.temporal && args.shard != Shard::WHOLE {
        return Err(Error::config(
            "`--temporal` cannot be combined with `--shard`: a frame needs the one before",
        )
        .hint("give either of them"));
    }
    let failures = Failures::new(args.json);
    let jobs = inputs::many(args, output, &failures)?;
    let records = Records::new(args, output)?;
    let Plan { left, there } = Plan::of(args, output, jobs, &records)?;
    let folders: HashSet<&Path> = left.iter().map(|frame| frame.outputs.folder()).collect();
    for folder in folders {
        data::check_writable(folder)?;
        data::remove_leftovers(folder);
    }
    let engine = Engine::new(args, args.json)?;
    let stop = ui::stop_flag();
    let bar = ui::bar(left.len(), "frames");
    let failures = failures.beside(&bar);

    let written = std::thread::scope(|scope| {
        let (send_read, read) = sync_channel::<(&Frame, Inputs, Loaded)>(WAITING);
        let (send_prepared, prepared) = sync_channel::<(&Frame, Inputs, Loaded, Prepared)>(1);
        let (send_fitted, fitted) = sync_channel::<(&Frame, Inputs, Loaded, Fitted)>(1);
        let (failures, bar, stop) = (&failures, &bar, &stop);
        let (left, engine, records) = (&left, &engine, &records);
        let reader = scope.spawn(move || {
            for frame in left {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                // In this order: what changes in between is noticed the next time.
                let inputs = records.inputs(args, &frame.job);
                match inputs.and_then(|inputs| Ok((frame, inputs, frame.job.load(args)?))) {
                    Ok(loaded) => {
                        if send_read.send(loaded).is_err() {
                            break;
                        }
                    }
                    Err(error) => failures.add(&frame.job.name, &error),
                }
            }
        });
        let network = scope.spawn(move || {
            for (frame, inputs, loaded) in read {
                match engine.prepare(&loaded) {
                    Ok(prepared) => {
                        if send_prepared
                            .send((frame, inputs, loaded, prepared))
                            .is_err()
                        {
                            break;
                        }
                    }
                    Err(error) => failures.add(&frame.job.name, &error),
                }
            }
        });
        let writer = scope.spawn(move || {
            let mut written = Written::default();
            // What holds for many frames is said once.
            let mut said = HashSet::new();
            for (Frame { job, outputs, .. }, inputs, loaded, fitted) in fitted {
                let completed = engine.finish(&loaded.rgb, &loaded.points, fitted);
                let summary = completed.and_then(|completed| {
                    let forms = outputs.forms(&loaded, &completed)?;
                    let summary = Summary::new(&job.name, &loaded, &completed, &forms);
                    records.forget(job)?;
                    outputs.write(&loaded, &completed, &forms, &summary)?;
                    records.write(job, inputs, &summary)?;
                    Ok(summary)
                });
                match summary {
                    Ok(summary) => {
                        for remark in summary.remarks() {
                            if said.insert(remark.clone()) {
                                let name = job.name.display();
                                bar.suspend(|| ui::warn(&format!("warning: {name}: {remark}")));
                            }
                        }
                        written.add(&summary);
                        bar.inc(1);
                        if args.json {
                            bar.suspend(|| ui::print(&summary.value().to_string()));
                        }
                    }
                    Err(error) => failures.add(&job.name, &error),
                }
            }
            written
        });
        let mut chain = Chain::default();
        for (frame, inputs, loaded, prepared) in prepared {
            let fitted = chain
                .before(frame.before.as_ref(), &loaded.rgb)
                .and_then(|before| prepared.fit(&loaded.points, before.as_deref()));
            match fitted {
                Ok(fitted) => {
                    chain.go_on(frame.outputs.weights(), &loaded.rgb, &fitted);
                    if send_fitted.send((frame, inputs, loaded, fitted)).is_err() {
                        break;
                    }
                }
                Err(error) => failures.add(&frame.job.name, &error),
            }
        }
        drop(send_fitted);
        let written = finished(writer);
        finished(network)?;
        finished(reader)?;
        written
    })?;
    bar.finish_and_clear();

    let (done, failed) = (written.count, failures.count());
    let counts = format!("frames    {done} completed, {there} there already, {failed} failed");
    let tell = if args.json { ui::say } else { ui::tell };
    tell(&counts);
    if let Some(points) = left_out_of_points(written.left_out_of_points) {
        tell(&format!("points    {points}"));
    }
    for (unit, count) in &written.unusual_png_units {
        tell(&format!(
            "png       {count} hold {unit} to a value: their depths do not fit in millimetres"
        ));
    }
    let lost = left_out_of_clouds(written.left_out_of_clouds);
    let lost = lost.map(|lost| format!("clouds    {lost}"));
    for line in raised(written.png_raised).into_iter().chain(lost) {
        tell(&line);
    }
    if !args.json {
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

/// What a thread returns.
fn finished<T>(thread: ScopedJoinHandle<'_, T>) -> Result<T> {
    thread.join().map_err(|_| {
        Error::new(
            Cause::Write,
            "a part of the program broke off, so that frames are missing",
        )
        .hint("the lines above say where; the same command goes on with what is left")
    })
}

/// What the writer has done.
#[derive(Default)]
struct Written {
    count: usize,
    unusual_png_units: BTreeMap<String, usize>,
    png_raised: usize,
    left_out_of_points: [usize; 3],
    left_out_of_clouds: [usize; 2],
}

impl Written {
    fn add(&mut self, summary: &Summary) {
        self.count += 1;
        if let Some(unit) = summary.unusual_png_unit() {
            *self.unusual_png_units.entry(unit.to_string()).or_default() += 1;
        }
        self.png_raised += summary.png_raised();
        let pairs = self.left_out_of_points.iter_mut();
        let pairs = pairs.zip(summary.left_out_of_points());
        pairs.for_each(|(sum, count)| *sum += count);
        let pairs = self.left_out_of_clouds.iter_mut();
        let pairs = pairs.zip(summary.left_out_of_cloud());
        pairs.for_each(|(sum, count)| *sum += count);
    }
}

/// A frame that is left to do.
struct Frame<'a> {
    job: Job,
    outputs: Outputs<'a>,
    /// In a video, what may come before.
    before: Option<Before>,
}

/// What is left to do, and how many frames are there already.
struct Plan<'a> {
    left: Vec<Frame<'a>>,
    there: usize,
}

impl<'a> Plan<'a> {
    /// Results that are there are used again if this run would make the same; results of other
    /// settings or inputs are an error. What has no record is made again, and replaced by nothing
    /// but an equal.
    fn of(args: &'a Complete, output: &Path, jobs: Vec<Job>, records: &Records) -> Result<Self> {
        let mut plan = Self {
            left: Vec::new(),
            there: 0,
        };
        let mut others = Vec::new();
        let mut before = None;
        // A frame of a video depends on all before it.
        let mut unbroken = true;
        for job in jobs {
            let outputs = Outputs::below(args, output, &job)?;
            outputs.check_apart(&job)?;
            let this = outputs.weights().map(|weights| Before {
                weights: weights.to_owned(),
                image: job.image.clone(),
            });
            let keeps = !args.force && outputs.any_exists();
            let record = keeps.then(|| records.read(&job)).flatten();
            let difference = match &record {
                Some(record) => records.difference(args, &job, record)?,
                None => None,
            };
            match record {
                Some(_) if difference.is_some() => others.extend(difference.map(|d| (job.name, d))),
                Some(record) if outputs.exist() && unbroken => {
                    plan.there += 1;
                    if args.json {
                        ui::print(&unchanged(record.report()).to_string());
                    }
                }
                _ => {
                    unbroken = !args.temporal;
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
            "`{}` holds {} results of other settings or inputs: `{}`: {difference}",
            output.display(),
            others.len(),
            name.display()
        ))
        .hint("give --force to make them anew, or -o DIR to write elsewhere"))
    }
}

/// What `--json` prints of a frame that is there already.
fn unchanged(report: &serde_json::Value) -> serde_json::Value {
    let mut report = report.clone();
    report["status"] = "unchanged".into();
    report
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_panics_is_an_error() {
        let result =
            std::thread::scope(|scope| finished(scope.spawn(|| -> usize { panic!("full") })));
        assert_eq!(result.unwrap_err().cause(), Cause::Write);
        let result = std::thread::scope(|scope| finished(scope.spawn(|| 3)));
        assert_eq!(result.unwrap(), 3);
    }
}
