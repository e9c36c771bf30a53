//! `lsdc complete`: one image and its points to dense depth.

use super::args::{Complete, Robustness};
use super::{Exit, ui};
use crate::data::{self, DepthMap};
use crate::device::device;
use crate::error::{Error, Result};
use crate::fit::{FitConfig, root_mean_square};
use crate::predict::{Completer, Completion, Method, check_sizes, complete_classic};
use crate::report::coloured;
use std::path::{Path, PathBuf};
use std::time::Instant;

const MILLIMETRE: f64 = 0.001;

pub(super) fn run(args: &Complete) -> Result<Exit> {
    let started = Instant::now();
    let rgb = data::read_rgb(&args.rgb)?;
    let sparse = read_sparse(&args.sparse, args.depth_scale)?;
    let outputs = Outputs::new(args)?;
    let read = started.elapsed();

    let (depth, completion) = match args.method {
        Method::Classic(_) if args.size.is_some() => {
            return Err(Error::config("`--size` needs method `lsdc`"));
        }
        Method::Classic(method) => (complete_classic(method, &rgb, &sparse)?, None),
        Method::Lsdc => {
            let completer =
                Completer::open(args.model.weights.as_deref(), &device(&args.model.device)?)?;
            let fit = *completer.fit_config();
            let robust = args.robust.map_or(fit.robust, Robustness::settings);
            let completer = completer.with_fit(FitConfig { robust, ..fit });
            let completer = if args.full {
                completer.with_input([sparse.height(), sparse.width()])
            } else {
                completer
            };
            check_sizes(&rgb, &sparse)?;
            let network = Instant::now();
            let bases = completer.bases(&rgb)?;
            let network = network.elapsed();
            let mut completion = completer.complete_with(&bases, &sparse, args.size)?;
            completion.timings.network = network;
            let left_out = completer.left_out(&bases, &sparse, &completion.fit)?;
            let depth = completion.depth.clone();
            (depth, Some((completion, root_mean_square(&left_out))))
        }
    };
    let writing = Instant::now();
    outputs.write(&depth)?;
    let ignored = match sparse.ignored() {
        0 => String::new(),
        count => format!(" ({count} NaN, infinite or negative values ignored)"),
    };
    ui::print(&format!("points    {}{ignored}", sparse.count()));
    if let Some((low, high)) = depth.range() {
        ui::print(&format!(
            "depth     {low:.3} to {high:.3} m, {}x{}",
            depth.width(),
            depth.height()
        ));
    }
    if let Some((completion, left_out)) = &completion {
        print_fit(completion, *left_out);
    }
    ui::print(&format!(
        "total     {} (reading {}, writing {})",
        ui::millis(started.elapsed()),
        ui::millis(read),
        ui::millis(writing.elapsed())
    ));
    ui::print(&format!("written   {}", outputs.npy.display()));
    Ok(Exit::Done)
}

fn print_fit(completion: &Completion, left_out: f64) {
    let fit = &completion.fit;
    let times = &completion.timings;
    ui::print(&format!(
        "residual  {:.4} m rms at the points, {left_out:.4} m at points left out, rank {} of {}",
        fit.rms(),
        fit.rank,
        fit.weights.len()
    ));
    ui::print(&format!(
        "time      network {}, fit {}, dense {}",
        ui::millis(times.network),
        ui::millis(times.fit),
        ui::millis(times.dense)
    ));
}

fn read_sparse(path: &Path, scale: Option<f64>) -> Result<DepthMap> {
    if scale.is_some_and(|s| !(s > 0.0 && s.is_finite())) {
        return Err(Error::config("`--depth-scale` must be above 0"));
    }
    match path.extension().and_then(|e| e.to_str()) {
        Some("png") => data::read_depth_png(path, scale.unwrap_or(MILLIMETRE)),
        _ => data::read_npy(path, scale.unwrap_or(1.0)),
    }
}

/// The three files of a result.
struct Outputs {
    npy: PathBuf,
    png: PathBuf,
    colour: PathBuf,
    force: bool,
}

impl Outputs {
    /// Names the files, and makes the folder.
    fn new(args: &Complete) -> Result<Self> {
        let folder = match (&args.output, args.rgb.parent()) {
            (Some(folder), _) => folder.clone(),
            (None, Some(parent)) => parent.to_owned(),
            (None, None) => PathBuf::new(),
        };
        if !folder.as_os_str().is_empty() {
            std::fs::create_dir_all(&folder).map_err(|e| Error::write(&folder, e))?;
        }
        let stem = args.rgb.file_stem().unwrap_or_default().to_string_lossy();
        let path = |end: &str| folder.join(format!("{stem}_{end}"));
        Ok(Self {
            npy: path("depth.npy"),
            png: path("depth.png"),
            colour: path("depth_color.png"),
            force: args.force,
        })
    }

    /// Writes all three. An existing result is replaced only by an equal one, or with `--force`.
    fn write(&self, depth: &DepthMap) -> Result<()> {
        if !self.force && self.npy.exists() {
            let same = data::read_npy(&self.npy, 1.0).is_ok_and(|old| old == *depth);
            if !same {
                return Err(Error::config(format!("`{}` exists", self.npy.display()))
                    .hint("give --force to replace it, or -o DIR to write elsewhere"));
            }
        }
        data::write_depth_png(&self.png, depth, MILLIMETRE)?;
        let (low, high) = depth.range().unwrap_or((0.0, 1.0));
        data::write_rgb(&self.colour, &coloured(depth, low, high))?;
        data::write_npy(&self.npy, depth)
    }
}
