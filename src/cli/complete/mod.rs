//! `lsdc complete`: images and their points to dense depth.

mod bag;
mod calibration;
mod export;
mod failures;
mod flow;
mod frame;
mod images;
mod inputs;
mod job;
mod lines;
mod loaded;
mod many;
mod outputs;
mod pipes;
mod record;
mod recorded;
mod settings;
mod summary;
mod tally;
mod video;
mod views;

use super::args::Complete;
use super::{Exit, ui};
use crate::process;
use frame::Engine;
use job::Job;
use lsdc_files::error::Result;
use lsdc_files::has_ending;
use outputs::Outputs;
use pipes::Pipes;
use settings::{Settings, is_one};
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
    if !is_one(&args.rgb) {
        return many::run(&Settings::of_files(args)?);
    }
    process::share_heap();
    let (image, json) = (args.rgb[0].clone(), args.json);
    let result = Settings::of_files(args).and_then(|settings| {
        let job = inputs::one(&settings)?;
        one(&settings, &job, &pipes)
    });
    if let (Err(error), true) = (&result, json) {
        let name = image.file_name().unwrap_or_default();
        ui::print(&failures::failure(Path::new(name), error).to_string());
    }
    result
}

fn one(settings: &Settings, job: &Job, pipes: &Pipes) -> Result<Exit> {
    let outputs = Outputs::beside(settings, job);
    outputs.check_writable()?;
    outputs.check_apart(job)?;
    let frame = job.load(settings)?;
    let found = Engine::new(settings, true)?.complete(&frame)?;
    // Before the memory of pictures and files.
    process::give_back_pages();
    let format_data = outputs.format_data(&frame, &found)?;
    let summary = Summary::new(&job.name, &frame, &found, &format_data);
    for remark in summary.remarks() {
        ui::warn(&format!("warning: {remark}"));
    }
    outputs.write(&frame, &found, &format_data, &summary)?;
    if pipes.to_stdout() {
        for line in summary.lines(None) {
            ui::say(&line);
        }
        return ui::pass_on(outputs.first()).map(|()| Exit::Done);
    }
    if settings.json {
        ui::print(&summary.value().to_string());
        return Ok(Exit::Done);
    }
    for line in summary.lines(outputs.outliers()) {
        ui::tell(&line);
    }
    ui::tell(&format!("written   {}", outputs.listed()));
    Ok(Exit::Done)
}
