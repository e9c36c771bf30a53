//! What is typed to look at files, and to learn the program by heart.

use super::values::typed;
use super::{Settings, Source};
use crate::data::Unit;
use clap::Args as ClapArgs;
use clap_complete::Shell;
use std::path::PathBuf;

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Inspect {
    /// Images, depth maps, tables of points, clouds, cameras, weights, folders of a model of COLMAP.
    #[arg(required_unless_present = "dataset")]
    pub(in crate::cli) files: Vec<PathBuf>,
    /// Unit of stored depths, as in `complete` [default: mm for integers, m for other numbers].
    #[arg(long, value_parser = typed::<Unit>, value_name = "UNIT")]
    pub(in crate::cli) depth_unit: Option<Unit>,
    /// Draw depth maps on the terminal, in colours.
    #[arg(long)]
    pub(in crate::cli) show: bool,
    /// Draw the basis functions of an image into this file (.svg or .png), by --weights.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["json", "show"])]
    pub(in crate::cli) bases: Option<PathBuf>,
    /// Weights for --bases, as `lsdc complete` takes them.
    #[arg(long, value_name = "FILE", requires = "bases")]
    pub(in crate::cli) weights: Option<PathBuf>,
    /// Replace an existing file.
    #[arg(long, requires = "bases")]
    pub(in crate::cli) force: bool,
    /// Print one JSON object to a file.
    #[arg(long)]
    pub(in crate::cli) json: bool,
    #[command(flatten)]
    pub(in crate::cli) settings: Settings,
    #[command(flatten)]
    pub(in crate::cli) source: Source,
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Completions {
    /// The shell that is to complete what is typed.
    #[arg(value_enum)]
    pub(in crate::cli) shell: Shell,
}

#[derive(Debug, ClapArgs)]
pub(in crate::cli) struct Manual {
    /// Folder for the pages, one to a command.
    #[arg(short, long, value_name = "DIR")]
    pub(in crate::cli) output: PathBuf,
}
