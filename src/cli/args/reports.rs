//! Arguments of `report`.

use clap::{Args as ClapArgs, Subcommand};
use std::path::PathBuf;

#[derive(Debug, Subcommand)]
pub(in crate::cli) enum ReportCommand {
    /// Merge the reports of shards, exactly, and print the merged report.
    Merge(Merge),
    /// Plot the error against the number of points, from one report per number.
    Curve(Curves),
    /// Show the training curves of one or several runs.
    Training(Runs),
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Runs {
    /// Run folders.
    #[arg(required = true)]
    pub(in crate::cli) folders: Vec<PathBuf>,
    /// Write an HTML page with the curves to this file [default: only print the table].
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
    /// Write an HTML page with the curves to this file [default: only print the table].
    #[arg(long, value_name = "FILE")]
    pub(in crate::cli) html: Option<PathBuf>,
    /// Replace an existing page.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Merge {
    /// Reports of `lsdc eval --json` on different frames, that is, the parts of --shard.
    #[arg(required = true)]
    pub(in crate::cli) files: Vec<PathBuf>,
    /// Folder for the merged report in all formats, without pictures of frames [default: only print it].
    #[arg(short, long, value_name = "DIR")]
    pub(in crate::cli) output: Option<PathBuf>,
    /// Replace existing files.
    #[arg(long)]
    pub(in crate::cli) force: bool,
}
