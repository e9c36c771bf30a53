//! `lsdc complete`: images and their points to dense depth.

mod bag;
mod calibration;
mod failures;
mod flow;
mod formats;
mod frame;
mod inputs;
mod lines;
mod loaded;
mod many;
mod outputs;
mod pipes;
mod record;
mod recorded;
mod summary;
mod tally;
mod video;

use super::args::Complete;
use super::{Exit, ui};
use crate::process;
use frame::Engine;
use inputs::Job;
use lsdc_files::error::{Error, Result};
use lsdc_files::has_ending;
use outputs::Outputs;
use pipes::Pipes;
use std::path::Path;
use summary::Summary;

pub(super) fn run(args: &Complete) -> Result<Exit> {
    recorded::check(args)?;
    if let (true, Some(output)) = (args.rgb.is_empty(), &args.output)
        && has_ending(output, "mcap")
    {
        return bag::run(args, output);
    }
    let mut args = args.clone();
    let pipes = Pipes::open(&mut args)?;
    if !inputs::is_one(&args) {
        return many::run(&args);
    }
    process::share_heap();
    let result = inputs::one(&args).and_then(|job| one(&args, &job, &pipes));
    if let (Err(error), true) = (&result, args.json) {
        let name = args.rgb[0].file_name().unwrap_or_default();
        ui::print(&failures::failure(Path::new(name), error).to_string());
    }
    result
}

fn one(args: &Complete, job: &Job, pipes: &Pipes) -> Result<Exit> {
    if args.temporal {
        let what = "`--temporal` would change nothing: one image has none before it";
        return Err(Error::config(what).hint("give the images of the video, or leave it out"));
    }
    let outputs = Outputs::beside(args, job)?;
    outputs.check_writable()?;
    outputs.check_apart(job)?;
    let frame = job.load(args)?;
    let found = Engine::new(args, true)?.complete(&frame)?;
    let forms = outputs.forms(&frame, &found)?;
    let summary = Summary::new(&job.name, &frame, &found, &forms);
    for remark in summary.remarks() {
        ui::warn(&format!("warning: {remark}"));
    }
    outputs.write(&frame, &found, &forms, &summary)?;
    if pipes.to_stdout() {
        for line in summary.lines(None) {
            ui::say(&line);
        }
        return ui::pass_on(outputs.first()).map(|()| Exit::Done);
    }
    if args.json {
        ui::print(&summary.value().to_string());
        return Ok(Exit::Done);
    }
    for line in summary.lines(outputs.outliers()) {
        ui::tell(&line);
    }
    ui::tell(&format!("written   {}", outputs.listed()));
    Ok(Exit::Done)
}
