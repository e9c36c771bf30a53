//! What is typed to join and show reports.

use clap::{Args as ClapArgs, Subcommand};
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub(in crate::cli) enum ReportCommand {
    /// Join the reports of shards, exactly, and print the whole.
    Merge(Merge),
    /// Show the error against the number of points, from one report for each number.
    Curve(Curves),
    /// Show how training went, of one run or several side by side.
    Training(Runs),
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Runs {
    /// Run folders.
    #[arg(required = true)]
    pub(in crate::cli) folders: Vec<PathBuf>,
    /// Write a page with the curves here [default: only print the table].
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) html: Option<PathBuf>,
    /// Replace an existing page.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Curves {
    /// Reports of `lsdc eval --json` with different --points.
    #[arg(required = true)]
    pub(in crate::cli) files: Vec<PathBuf>,
    /// Write a page with the curves here [default: only print the table].
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) html: Option<PathBuf>,
    /// Replace an existing page.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Merge {
    /// Reports of `lsdc eval --json` on different frames: the parts of --shard.
    #[arg(required = true)]
    pub(in crate::cli) files: Vec<PathBuf>,
    /// Folder for the joined report in every form [default: only print it].
    #[arg(short, long, value_name = "DIR")]
    pub(in crate::cli) output: Option<PathBuf>,
    /// Replace existing files.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}
