//! `lsdc complete`: one image and its points to dense depth.

use super::args::Complete;
use super::{Exit, ui};
use crate::data::{self, DepthMap};
use crate::device::device;
use crate::error::{Error, Result};
use crate::fit::{Fit, root_mean_square};
use crate::predict::{Completer, Method, check_sizes, complete_classic};
use crate::report::coloured;
use image::RgbImage;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const MILLIMETRE: f64 = 0.001;

/// The score above which a point is listed (Iglewicz and Hoaglin 1993).
const OUTLYING: f64 = 3.5;

pub(super) fn run(args: &Complete) -> Result<Exit> {
    let started = Instant::now();
    let rgb = data::read_rgb(&args.rgb)?;
    let sparse = read_sparse(&args.sparse, args.depth_scale)?;
    let sigma = args
        .sigma
        .as_ref()
        .map(|path| read_sparse(path, args.depth_scale));
    let sigma = sigma.transpose()?;
    let outputs = Outputs::new(args)?;
    let read = started.elapsed();
    check_sizes(&rgb, &sparse)?;

    let (depth, fitted) = match args.method {
        Method::Classic(_) if args.needs_fit() => {
            return Err(Error::config(
                "`--size`, `--sigma`, `--uncertainty` and `--outliers` need method `lsdc`",
            ));
        }
        Method::Classic(method) => (complete_classic(method, &rgb, &sparse)?, None),
        Method::Lsdc => {
            let (depth, fitted) = complete(args, &rgb, &sparse, sigma.as_ref())?;
            (depth, Some(fitted))
        }
    };
    let depth = args.preserve_input.apply(&depth, &sparse)?;
    let writing = Instant::now();
    let deviations = fitted.as_ref().and_then(|f| f.deviations.as_ref());
    let list = fitted.as_ref().filter(|_| args.outliers);
    let list = list.map(|f| outliers(&f.fit, &f.leverages, &sparse));
    outputs.write(&depth, deviations, list.as_deref())?;
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
    if let Some(fitted) = &fitted {
        fitted.print();
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

impl Complete {
    /// Whether something is asked for that only a fit has.
    fn needs_fit(&self) -> bool {
        self.size.is_some() || self.sigma.is_some() || self.uncertainty || self.outliers
    }
}

/// A fit with what is printed and written of it.
struct Fitted {
    fit: Fit,
    leverages: Vec<f64>,
    deviations: Option<DepthMap>,
    network: Duration,
    fitting: Duration,
    dense: Duration,
}

fn complete(
    args: &Complete,
    rgb: &RgbImage,
    sparse: &DepthMap,
    sigma: Option<&DepthMap>,
) -> Result<(DepthMap, Fitted)> {
    let completer = Completer::open(args.model.weights.as_deref(), &device(&args.model.device)?)?;
    let mut settings = *completer.fit_config();
    args.fit.apply(&mut settings);
    let mut completer = completer.with_fit(settings);
    if args.full {
        completer = completer.with_input([sparse.height(), sparse.width()]);
    }
    let started = Instant::now();
    let bases = completer.bases(rgb)?;
    let network = started.elapsed();
    let started = Instant::now();
    let fit = completer.fit(&bases, sparse, sigma)?;
    let fitting = started.elapsed();
    let started = Instant::now();
    let depth = completer.dense(&bases, &fit, sparse, args.size)?;
    let dense = started.elapsed();
    let deviations = args
        .uncertainty
        .then(|| completer.deviation(&bases, sparse, &fit, &depth));
    let fitted = Fitted {
        leverages: completer.leverages(&bases, sparse, &fit),
        deviations: deviations.transpose()?,
        fit,
        network,
        fitting,
        dense,
    };
    Ok((depth, fitted))
}

impl Fitted {
    fn print(&self) {
        let fit = &self.fit;
        ui::print(&format!(
            "residual  {:.4} m rms at the points, {:.4} m at points left out, rank {} of {}",
            fit.rms(),
            root_mean_square(&fit.left_out(&self.leverages)),
            fit.rank,
            fit.weights.len()
        ));
        ui::print(&format!(
            "time      network {}, fit {}, dense {}",
            ui::millis(self.network),
            ui::millis(self.fitting),
            ui::millis(self.dense)
        ));
    }
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

/// The files of a result.
struct Outputs {
    npy: PathBuf,
    png: PathBuf,
    colour: PathBuf,
    sigma: PathBuf,
    outliers: PathBuf,
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
            sigma: path("sigma.npy"),
            outliers: path("outliers.csv"),
            force: args.force,
        })
    }

    /// Writes the depth in three forms, and what was asked for beside it. An existing result is
    /// replaced only by an equal one, or with `--force`; else nothing is written.
    fn write(
        &self,
        depth: &DepthMap,
        deviations: Option<&DepthMap>,
        outliers: Option<&str>,
    ) -> Result<()> {
        let maps = [(&self.npy, Some(depth)), (&self.sigma, deviations)];
        for (path, map) in maps {
            let same = |map: &DepthMap| data::read_npy(path, 1.0).is_ok_and(|old| old == *map);
            self.replaceable(path, map.is_none_or(same))?;
        }
        let same =
            |text: &str| std::fs::read_to_string(&self.outliers).is_ok_and(|old| old == text);
        self.replaceable(&self.outliers, outliers.is_none_or(same))?;

        data::write_depth_png(&self.png, depth, MILLIMETRE)?;
        let (low, high) = depth.range().unwrap_or((0.0, 1.0));
        data::write_rgb(&self.colour, &coloured(depth, low, high))?;
        if let Some(text) = outliers {
            data::write_atomically(&self.outliers, |out| out.write_all(text.as_bytes()))?;
        }
        maps.into_iter()
            .filter_map(|(path, map)| Some((path, map?)))
            .try_for_each(|(path, map)| data::write_npy(path, map))
    }

    fn replaceable(&self, path: &Path, same: bool) -> Result<()> {
        if self.force || same || !path.exists() {
            return Ok(());
        }
        Err(Error::config(format!("`{}` exists", path.display()))
            .hint("give --force to replace it, or -o DIR to write elsewhere"))
    }
}

/// The points that do not agree with the others, as CSV, the worst first.
fn outliers(fit: &Fit, leverages: &[f64], sparse: &DepthMap) -> String {
    let left_out = fit.left_out(leverages);
    let scores = fit.scores(leverages);
    let mut lines: Vec<(f64, String)> = Vec::new();
    for (i, point) in sparse.points().enumerate() {
        if scores[i].abs() > OUTLYING {
            let others = f64::from(point.depth) - left_out[i];
            let (x, y, depth, score) = (point.x, point.y, point.depth, scores[i]);
            let weight = fit.point_weights[i];
            let line = format!("{x},{y},{depth},{others:.4},{score:.2},{weight:.4}\n");
            lines.push((-score.abs(), line));
        }
    }
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    let header = "x,y,depth,depth_by_the_others,score,weight\n";
    lines
        .into_iter()
        .fold(header.to_owned(), |text, (_, line)| text + &line)
}
