//! The command line: what was typed, one file per command, and all that is printed.

mod args;
mod bench;
#[cfg(feature = "train")]
mod calibrate;
mod complete;
#[cfg(feature = "train")]
mod dashboard;
mod eval;
mod exit;
#[cfg(feature = "train")]
mod experiment;
mod export;
mod fuse;
mod inspect;
mod install;
mod manual;
mod names;
mod network;
#[cfg(feature = "node")]
mod node;
mod recordings;
mod report;
#[cfg(feature = "serve")]
mod serve;
mod settings;
mod signals;
#[cfg(feature = "train")]
mod train;
mod ui;
#[cfg(feature = "serve")]
mod view;
mod weights;

use args::{Args, Command, ReportCommand};
use clap::Parser as _;
use exit::Exit;
use lsdc_eval::data::hide_caught_panics;
use lsdc_files::error::{Error, Result};
use std::process::ExitCode;

/// Runs the program on the process's arguments.
pub fn main() -> ExitCode {
    let args = Args::parse();
    hide_caught_panics();
    ui::start_log(args.verbose);
    ui::be_quiet(args.quiet);
    let failed = |error: Error| {
        ui::print_error(&error);
        Exit::from(&error)
    };
    let exit = run(args).unwrap_or_else(failed);
    let printed = ui::finish().map_or_else(failed, |()| Exit::Done);
    // An earlier failure is more informative than a failure to print.
    let exit = if exit == Exit::Done { printed } else { exit };
    ExitCode::from(exit as u8)
}

fn run(args: Args) -> Result<Exit> {
    match args.command {
        Command::Complete(args) => complete::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        #[cfg(feature = "node")]
        Command::Node(args) => node::run(&args),
        #[cfg(feature = "serve")]
        Command::Serve(args) => serve::run(&args),
        #[cfg(feature = "serve")]
        Command::View(args) => view::run(&args),
        Command::Completions(args) => Ok(manual::completions(&args)),
        Command::Man(args) => manual::man(&args),
        Command::Eval(args) => eval::run(&args),
        #[cfg(feature = "train")]
        Command::Experiment(args) => experiment::run(&args),
        Command::Report(ReportCommand::Merge(args)) => report::merge(&args),
        Command::Report(ReportCommand::Curve(args)) => report::curve(&args),
        Command::Report(ReportCommand::Training(args)) => report::training(&args),
        #[cfg(feature = "train")]
        Command::Train(args) => train::run(&args),
        Command::Weights(command) => weights::run(&command),
        #[cfg(feature = "train")]
        Command::Calibrate(args) => calibrate::run(&args),
        Command::Export(args) => export::run(&args),
        Command::Fuse(args) => fuse::run(&args),
        Command::Bench(args) => bench::run(&args),
        Command::Config(args) => {
            ui::print(&args.load()?.explained()?);
            Ok(Exit::Done)
        }
    }
}
