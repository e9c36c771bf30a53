//! Arguments of `inspect`, `completions` and `man`.

use super::values::typed;
use super::{Settings, Source};
use clap::Args as ClapArgs;
use clap_complete::Shell;
use lsdc_eval::data::Unit;
use std::path::PathBuf;

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Inspect {
    /// Images, depth maps, point tables, point clouds, camera files, weights files, COLMAP model folders, recordings
    /// (MCAP, or rosbag2's db3, or the folder of a bag).
    #[arg(required_unless_present = "dataset")]
    pub(in crate::cli) files: Vec<PathBuf>,
    /// Unit of the stored depths, as for `complete` [default: mm for integers, m for other numbers].
    #[arg(long, value_parser = typed::<Unit>, value_name = "UNIT")]
    pub(in crate::cli) depth_unit: Option<Unit>,
    /// Show depth maps in the terminal, in colour.
    #[arg(long)]
    pub(in crate::cli) show: bool,
    /// Plot the basis functions of an image to this file (.svg or .png), with the weights of --weights.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["json", "show"])]
    pub(in crate::cli) bases: Option<PathBuf>,
    /// Weights for --bases, given as for `lsdc complete`.
    #[arg(long, value_name = "FILE", requires = "bases")]
    pub(in crate::cli) weights: Option<PathBuf>,
    /// Replace an existing file.
    #[arg(long, requires = "bases")]
    pub(in crate::cli) force: bool,
    /// Print one JSON object per file.
    #[arg(long)]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) settings: Settings,
    #[command(flatten)]
    pub(in crate::cli) source: Source,
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Completions {
    /// The shell to write the completion script for.
    #[arg(value_enum)]
    pub(in crate::cli) shell: Shell,
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Manual {
    /// Folder for the pages, one per command.
    #[arg(short, long, value_name = "DIR")]
    pub(in crate::cli) output: PathBuf,
}
