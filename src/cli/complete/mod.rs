//! `lsdc complete`: images and their points to dense depth.

mod frame;
mod inputs;
mod many;
mod outputs;
mod pipes;
mod summary;

use super::args::Complete;
use super::{Exit, ui};
use crate::error::Result;
use frame::Engine;
use outputs::Outputs;
use pipes::Pipes;
use summary::Summary;

pub(super) fn run(args: &Complete) -> Result<Exit> {
    let mut args = args.clone();
    let pipes = Pipes::open(&mut args)?;
    if inputs::is_one(&args) {
        one(&args, &pipes)
    } else {
        many::run(&args)
    }
}

fn one(args: &Complete, pipes: &Pipes) -> Result<Exit> {
    let job = inputs::one(args)?;
    let frame = job.load(args)?;
    let outputs = Outputs::beside(args, &job)?;
    let found = Engine::new(args, true)?.complete(&frame.rgb, &frame.points)?;
    let summary = Summary::new(&job.name, &frame, &found);
    for remark in summary.remarks() {
        ui::warn(&format!("warning: {remark}"));
    }
    outputs.write(&frame, &found, &summary)?;
    if pipes.to_stdout() {
        summary.lines().iter().for_each(|line| ui::say(line));
        return ui::pass_on(outputs.first()).map(|()| Exit::Done);
    }
    if args.json {
        ui::print(&summary.json());
        return Ok(Exit::Done);
    }
    summary.lines().iter().for_each(|line| ui::tell(line));
    ui::tell(&format!("written   {}", outputs.first().display()));
    Ok(Exit::Done)
}
