//! Many images: reading, network, fit and writing at the same time, each of another frame.

use super::frame::{Engine, Seen, Weighed};
use super::inputs::{self, Job, Loaded};
use super::outputs::{Outputs, read_weights};
use super::summary::Summary;
use crate::cli::args::Complete;
use crate::cli::{Exit, ui};
use crate::data;
use crate::error::{Error, Result};
use crate::eval::Shard;
use image::{RgbImage, imageops};
use indicatif::ProgressBar;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::Ordering;
use std::sync::mpsc::sync_channel;

/// Frames that wait between two stages.
const WAITING: usize = 2;

pub(super) fn run(args: &Complete) -> Result<Exit> {
    let output = args.output.as_deref().ok_or_else(|| {
        Error::config("where the results of many images go is missing").hint("give -o DIR")
    })?;
    if args.sigma.is_some() {
        return Err(Error::config("`--sigma` is for one image")
            .hint("give lists with a fourth column, or a model of COLMAP"));
    }
    if args.temporal && args.shard != Shard::WHOLE {
        return Err(Error::config("a part of the frames is no video")
            .hint("give either `--temporal` or `--shard`"));
    }
    let failures = Failures::default();
    let jobs = inputs::many(args, output, &failures)?;
    let mut left = Vec::new();
    let mut there = 0;
    let mut before = None;
    for job in jobs {
        let outputs = Outputs::below(args, output, &job)?;
        let this = outputs.weights().map(|weights| Before {
            weights: weights.to_owned(),
            image: job.image.clone(),
        });
        if !args.force && outputs.exist() {
            there += 1;
        } else {
            left.push(Frame {
                job,
                outputs,
                before: before.take(),
            });
        }
        before = this;
    }
    let folders: HashSet<&Path> = left.iter().map(|frame| frame.outputs.folder()).collect();
    folders.into_iter().for_each(data::remove_leftovers);
    let engine = Engine::new(args, args.json)?;
    let stop = ui::stop_flag();
    let bar = ui::bar(left.len(), "frames");
    let failures = failures.beside(&bar);

    let done = std::thread::scope(|scope| {
        let (send_read, read) = sync_channel::<(&Frame, Loaded)>(WAITING);
        let (send_seen, seen) = sync_channel::<(&Frame, Loaded, Seen<'_>)>(1);
        let (send_weighed, weighed) = sync_channel::<(&Frame, Loaded, Weighed<'_>)>(1);
        let (failures, bar, stop, left, engine) = (&failures, &bar, &stop, &left, &engine);
        scope.spawn(move || {
            for frame in left {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                match frame.job.load(args) {
                    Ok(loaded) => {
                        if send_read.send((frame, loaded)).is_err() {
                            break;
                        }
                    }
                    Err(error) => failures.add(&frame.job.name, &error),
                }
            }
        });
        scope.spawn(move || {
            for (frame, loaded) in read {
                match engine.see(&loaded.rgb, &loaded.points) {
                    Ok(seen) => {
                        if send_seen.send((frame, loaded, seen)).is_err() {
                            break;
                        }
                    }
                    Err(error) => failures.add(&frame.job.name, &error),
                }
            }
        });
        let writer = scope.spawn(move || {
            let mut done = 0;
            // What holds for many frames is said once.
            let mut said = HashSet::new();
            for (Frame { job, outputs, .. }, loaded, weighed) in weighed {
                let completed = engine.dense(&loaded.rgb, &loaded.points, weighed);
                let written = completed.and_then(|completed| {
                    let summary = Summary::new(&job.name, &loaded, &completed);
                    outputs.write(&loaded, &completed, &summary)?;
                    Ok(summary)
                });
                match written {
                    Ok(summary) => {
                        for remark in summary.remarks() {
                            if said.insert(remark.clone()) {
                                let name = job.name.display();
                                bar.suspend(|| ui::warn(&format!("warning: {name}: {remark}")));
                            }
                        }
                        done += 1;
                        bar.inc(1);
                        if args.json {
                            bar.suspend(|| ui::print(&summary.json()));
                        }
                    }
                    Err(error) => failures.add(&job.name, &error),
                }
            }
            done
        });
        let mut chain = Chain::default();
        for (frame, loaded, seen) in seen {
            let weighed = chain
                .before(frame, &loaded.rgb)
                .and_then(|before| seen.weigh(&loaded.points, before.as_deref()));
            match weighed {
                Ok(weighed) => {
                    chain.go_on(frame, &loaded.rgb, &weighed);
                    if send_weighed.send((frame, loaded, weighed)).is_err() {
                        break;
                    }
                }
                Err(error) => failures.add(&frame.job.name, &error),
            }
        }
        drop(send_weighed);
        writer.join().unwrap_or(0)
    });
    bar.finish_and_clear();

    let failed = failures.count();
    let counts = format!("frames    {done} completed, {there} there already, {failed} failed");
    if args.json {
        ui::say(&counts);
    } else {
        ui::tell(&counts);
        ui::tell(&format!("written   {}", output.display()));
    }
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

/// What is left to do.
struct Frame<'a> {
    job: Job,
    outputs: Outputs<'a>,
    /// In a video, what may come before.
    before: Option<Before>,
}

/// Where the weights of a frame are, and its image.
struct Before {
    weights: PathBuf,
    image: PathBuf,
}

/// The frame that was completed last.
#[derive(Default)]
struct Chain(Option<Last>);

struct Last {
    path: PathBuf,
    weights: Vec<f64>,
    look: RgbImage,
}

impl Chain {
    /// The weights of the frame before this one, in memory or of an earlier run; none if it failed,
    /// or if the scene is another.
    fn before(&self, frame: &Frame<'_>, rgb: &RgbImage) -> Result<Option<Vec<f64>>> {
        let Some(before) = &frame.before else {
            return Ok(None);
        };
        let read;
        let last = match &self.0 {
            Some(last) if last.path == before.weights => last,
            _ if before.weights.exists() => {
                read = Last {
                    path: before.weights.clone(),
                    weights: read_weights(&before.weights)?,
                    look: look(&data::read_rgb(&before.image)?),
                };
                &read
            }
            _ => return Ok(None),
        };
        Ok(same_scene(&last.look, &look(rgb)).then(|| last.weights.clone()))
    }

    fn go_on(&mut self, frame: &Frame<'_>, rgb: &RgbImage, weighed: &Weighed<'_>) {
        let found = frame.outputs.weights().zip(weighed.weights());
        self.0 = found.map(|(path, weights)| Last {
            path: path.to_owned(),
            weights: weights.to_owned(),
            look: look(rgb),
        });
    }
}

/// An image at a glance.
fn look(rgb: &RgbImage) -> RgbImage {
    imageops::thumbnail(rgb, 32, 24)
}

/// Whether a video goes on between two images, rather than cuts.
fn same_scene(a: &RgbImage, b: &RgbImage) -> bool {
    /// Levels of 255 by which pixels differ, on average; frames of rooms seconds apart differ by 15
    /// to 80.
    const DIFFERENT: f64 = 15.0;
    let pairs = a.iter().zip(b.iter());
    let off: f64 = pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    off / (a.len().max(1) as f64) < DIFFERENT
}

/// Frames that could not be completed: said at once, counted for the end.
#[derive(Default)]
pub(super) struct Failures {
    count: Mutex<usize>,
    bar: Option<ProgressBar>,
}

impl Failures {
    /// Goes on beside a bar, which steps with every failure.
    fn beside(self, bar: &ProgressBar) -> Self {
        Self {
            bar: Some(bar.clone()),
            ..self
        }
    }

    pub(super) fn add(&self, name: &Path, error: &Error) {
        let say = || ui::print_failure(name, error);
        if let Some(bar) = &self.bar {
            bar.suspend(say);
            bar.inc(1);
        } else {
            say();
        }
        if let Ok(mut count) = self.count.lock() {
            *count += 1;
        }
    }

    fn count(&self) -> usize {
        self.count.lock().map_or(0, |count| *count)
    }
}
