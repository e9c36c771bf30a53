//! Folders of images: reading, completing and writing at the same time, frame after frame.

use super::frame::{Completed, Engine};
use super::outputs::Outputs;
use crate::cli::args::Complete;
use crate::cli::{Exit, ui};
use crate::data::{self, Colmap, Sparse, View};
use crate::error::{Error, Result};
use image::RgbImage;
use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::sync::mpsc::sync_channel;

/// Frames that wait between two stages.
const WAITING: usize = 2;

/// An image and where its points are.
struct Job {
    /// Path of the image below its folder.
    name: PathBuf,
    points: Points,
}

enum Points {
    File(PathBuf),
    View(View),
}

pub(super) fn run(args: &Complete) -> Result<Exit> {
    let output = args.output.as_deref().ok_or_else(|| {
        Error::config("where the results of a folder go is missing").hint("give -o DIR")
    })?;
    if args.sigma.is_some() {
        return Err(Error::config("`--sigma` is for one image")
            .hint("give lists with a fourth column, or a model of COLMAP"));
    }
    let failures = Failures::default();
    let jobs = jobs(args, output, &failures)?;
    let outputs = |name: &Path| {
        let folder = output.join(name.parent().unwrap_or(Path::new("")));
        let stem = name.file_stem().unwrap_or_default().to_string_lossy();
        Outputs::new(args, &folder, &stem)
    };
    let all = jobs.len();
    let left: Vec<Job> = jobs
        .into_iter()
        .filter(|job| args.force || !outputs(&job.name).exist())
        .collect();
    let there = all - left.len();
    let engine = Engine::new(args)?;
    let stop = ui::stop_flag();
    let bar = ui::bar(left.len(), "frames");

    let done = std::thread::scope(|scope| {
        let (send_read, read) = sync_channel::<(&Path, RgbImage, Sparse)>(WAITING);
        let (send_found, found) = sync_channel::<(&Path, Completed, Sparse)>(WAITING);
        let (failures, bar, stop, left) = (&failures, &bar, &stop, &left);
        scope.spawn(move || {
            for job in left {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                match job.load(args) {
                    Ok((rgb, points)) => {
                        if send_read.send((&job.name, rgb, points)).is_err() {
                            break;
                        }
                    }
                    Err(error) => failures.add(&job.name, &error, bar),
                }
            }
        });
        let writer = scope.spawn(move || {
            let mut done = 0;
            for (name, completed, points) in found {
                match outputs(name).write(&completed, &points.depth) {
                    Ok(()) => {
                        done += 1;
                        bar.inc(1);
                    }
                    Err(error) => failures.add(name, &error, bar),
                }
            }
            done
        });
        for (name, rgb, points) in read {
            match engine.complete(&rgb, &points) {
                Ok(completed) => {
                    if send_found.send((name, completed, points)).is_err() {
                        break;
                    }
                }
                Err(error) => failures.add(name, &error, bar),
            }
        }
        drop(send_found);
        writer.join().unwrap_or(0)
    });
    bar.finish_and_clear();

    let failed = failures.count();
    ui::print(&format!(
        "frames    {done} completed, {there} there already, {failed} failed"
    ));
    ui::print(&format!("written   {}", output.display()));
    if stop.load(Ordering::Relaxed) && done + failed < left.len() {
        ui::say("hint: the same command goes on with what is left");
        return Ok(Exit::Interrupted);
    }
    Ok(if failed > 0 {
        Exit::Partial
    } else {
        Exit::Done
    })
}

/// Frames that could not be completed.
#[derive(Default)]
struct Failures(Mutex<usize>);

impl Failures {
    fn add(&self, name: &Path, error: &Error, bar: &indicatif::ProgressBar) {
        bar.suspend(|| {
            ui::say(&format!("failed: {}", name.display()));
            ui::print_error(error);
        });
        bar.inc(1);
        if let Ok(mut count) = self.0.lock() {
            *count += 1;
        }
    }

    fn count(&self) -> usize {
        self.0.lock().map_or(0, |count| *count)
    }
}

impl Job {
    fn load(&self, args: &Complete) -> Result<(RgbImage, Sparse)> {
        let rgb = data::read_rgb(&args.rgb.join(&self.name))?;
        let size = (rgb.width() as usize, rgb.height() as usize);
        let points = match &self.points {
            Points::File(path) => Sparse::read(path, args.depth_unit, size)?,
            Points::View(view) => Sparse::of_view(view, size)?,
        };
        Ok((rgb, points))
    }
}

/// The images of a folder, each with its points: a file of the same name, or a view of a model.
/// What has none, or no name of its own, has failed.
fn jobs(args: &Complete, output: &Path, failures: &Failures) -> Result<Vec<Job>> {
    let hidden = indicatif::ProgressBar::hidden();
    let holds = |name: &Path| args.shard.holds(&name.to_string_lossy());
    let mut jobs = Vec::new();
    let mut names = HashSet::new();
    let mut add = |name: PathBuf, points: Result<Points>| {
        let inside = name.components().all(|c| matches!(c, Component::Normal(_)));
        let points = if !inside {
            Err(Error::config("its name leads out of the folder"))
        } else if !names.insert(name.with_extension("")) {
            Err(Error::config(
                "another image has that name, but for the ending",
            ))
        } else {
            points
        };
        match points {
            Ok(points) => jobs.push(Job { name, points }),
            Err(error) => failures.add(&name, &error, &hidden),
        }
    };
    if Colmap::is_at(&args.sparse) {
        for view in Colmap::read(&args.sparse)?.views {
            let name = PathBuf::from(&view.name);
            if holds(&name) {
                add(name, Ok(Points::View(view)));
            }
        }
        return Ok(jobs);
    }
    if !args.sparse.is_dir() {
        let what = "is no folder of points and no model of COLMAP";
        return Err(Error::format(&args.sparse, what));
    }
    let images = data::images_below(&args.rgb)?;
    if images.is_empty() {
        return Err(Error::format(&args.rgb, "holds no JPEG or PNG image"));
    }
    for path in images {
        let ours = path.starts_with(output) && !args.rgb.starts_with(output);
        let name = path.strip_prefix(&args.rgb).unwrap_or(&path).to_owned();
        if ours || !holds(&name) {
            continue;
        }
        let endings = [
            "npy", "npz", "png", "tiff", "tif", "exr", "pfm", "csv", "txt",
        ]
        .into_iter();
        let mut files = endings.map(|ending| args.sparse.join(&name).with_extension(ending));
        let file = files.find(|file| file.exists() && *file != path);
        let points = file.map(Points::File).ok_or_else(|| {
            let folder = args.sparse.display();
            Error::config(format!("there are no points of that name in `{folder}`"))
        });
        add(name, points);
    }
    Ok(jobs)
}
