//! Consistency of the depths of a sequence over its views: a table of methods, numbers of points, and pose errors.
//!
//!     cargo run --release -p lsdc-eval --example views -- --rooms 4 --points 50,200,1000
//!     cargo run --release -p lsdc-eval --example views -- --seven-scenes DIR --step 5 --frames 40
//!     cargo run --release -p lsdc-eval --example views -- --rooms 1 --points 200 --write DIR
//!
//! Options: `--rooms N` procedural rooms [4], or `--seven-scenes DIR` with `--step N` [1]; `--frames N` [24]; `--size WxH` of
//! rooms [320x240]; `--motion path,object,still` of rooms [path]: a moving camera, the same with a moving object, a camera that
//! stands still; `--points N,...` [200]; `--poses exact,off:METRES:DEGREES,shuffled` [exact]; `--methods single,views,past,...`
//! [single]: each frame by its own points, with those of its neighbours, with those of earlier ones, or a method without
//! training; `--weights NAME` [default]; `--seed N` [0]; `--csv FILE`; `--write DIR` writes the sequences instead.

#![allow(clippy::print_stdout)]

use lsdc_core::{Completer, Observations, PosedView, Scene, ViewSettings, neighbours};
use lsdc_eval::data::{DepthMap, RoomPath, Sequence, seven_scenes, write_atomically};
use lsdc_eval::evaluation::{PredictedFrame, SequenceScores, SequenceTask};
use lsdc_eval::metrics::{PredictedErrors, Rules};
use lsdc_eval::predict::{Method, complete_classic, scene};
use lsdc_eval::report::{Ranking, Table};
use lsdc_eval::sampling::{Pattern, PoseError};
use lsdc_files::error::{Error, Result};
use lsdc_weights::{open_completer, weights_name};
use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;
use std::str::FromStr;

fn main() -> ExitCode {
    match Arguments::parse().and_then(|arguments| run(&arguments)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            println!("error: {}", error.with_causes());
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<()> {
    let motions: Vec<String> = match arguments.value("seven-scenes") {
        Some(_) => vec!["sequence".to_owned()],
        None => arguments.list("motion", "path")?,
    };
    let points: Vec<Pattern> = arguments.list("points", "200")?;
    let poses: Vec<PoseError> = arguments.list("poses", "exact")?;
    let methods: Vec<String> = arguments.list("methods", "single")?;
    let seed: u64 = arguments.number("seed", 0)?;
    let weights = arguments.value("weights").map(Path::new);
    let mut rows: BTreeMap<[usize; 4], SequenceScores> = BTreeMap::new();
    let mut descriptions = Vec::new();
    let completer = open_completer(weights)?;
    for (m, motion) in motions.iter().enumerate() {
        for sequence in arguments.sequences(motion)? {
            let sequence = sequence?;
            if let Some(folder) = arguments.value("write") {
                let folder = Path::new(folder).join(format!("{motion}-{}", descriptions.len()));
                let task = SequenceTask::draw(&sequence, &points[0], poses[0], seed)?;
                sequence.write(&folder, &task.sparse)?;
                println!("{}: {}", folder.display(), sequence.description());
                descriptions.push(sequence.description().to_owned());
                continue;
            }
            descriptions.push(sequence.description().to_owned());
            let scenes = Scenes::new(&completer, &sequence)?;
            for (n, points) in points.iter().enumerate() {
                for (p, poses) in poses.iter().enumerate() {
                    let task = SequenceTask::draw(&sequence, points, *poses, seed)?;
                    let views = Scenes::views(&task)?;
                    for (k, method) in methods.iter().enumerate() {
                        if p > 0 && !sees_poses(method) {
                            continue;
                        }
                        let scores = task.measure(&Rules::default(), |index| {
                            scenes.complete(method, &views, &task.sparse[index], index)
                        })?;
                        rows.entry([m, n, p, k]).or_default().add(&scores);
                    }
                }
            }
        }
    }
    if arguments.value("write").is_some() {
        return Ok(());
    }
    let label = |[m, n, p, k]: [usize; 4]| {
        let points = String::from(points[n].clone());
        let poses = if sees_poses(&methods[k]) {
            poses[p].to_string()
        } else {
            "-".to_owned()
        };
        format!(
            "{:<8}  {points:<12}  {poses:<14}  {}",
            motions[m], methods[k]
        )
    };
    let table = Table {
        title: format!(
            "{} sequences of {} frames, seed {seed}, {}",
            descriptions.len(),
            arguments.number("frames", FRAMES)?,
            weights_name(weights)?
        ),
        row_header: format!("{:<8}  {:<12}  {:<14}  method", "motion", "points", "poses"),
        ranking: Ranking::None,
        columns: SequenceScores::columns(),
        rows: rows
            .iter()
            .map(|(key, scores)| scores.row(&label(*key)))
            .collect(),
    };
    println!("{table}");
    if let Some(path) = arguments.value("csv") {
        write_atomically(path.as_ref(), |out| out.write_all(table.csv().as_bytes()))?;
    }
    Ok(())
}

/// Returns whether a method depends on the poses.
fn sees_poses(method: &str) -> bool {
    ["views", "past"].contains(&method)
}

/// A sequence with its images, each read by the network once.
struct Scenes<'a> {
    sequence: &'a Sequence,
    scenes: Vec<Scene>,
}

impl<'a> Scenes<'a> {
    fn new(completer: &Completer, sequence: &'a Sequence) -> Result<Self> {
        let frames = sequence.frames().iter();
        let scenes: Result<_> = frames
            .map(|posed| scene(completer, &posed.frame.rgb))
            .collect();
        Ok(Self {
            sequence,
            scenes: scenes?,
        })
    }

    /// Returns the points of all frames with the poses given to methods.
    fn views(task: &SequenceTask<'_>) -> Result<Vec<PosedView>> {
        let pairs = task.cameras.iter().zip(&task.sparse);
        pairs
            .map(|(camera, sparse)| {
                let points = Observations::from_map(sparse);
                let (width, height) = (sparse.width(), sparse.height());
                Ok(PosedView::new(camera.clone(), width, height, points)?)
            })
            .collect()
    }

    fn complete(
        &self,
        method: &str,
        views: &[PosedView],
        sparse: &DepthMap,
        index: usize,
    ) -> Result<PredictedFrame> {
        let completion = match method {
            "single" => self.scenes[index].complete(views[index].observations())?,
            "views" | "past" => {
                let settings = ViewSettings {
                    only_past: method == "past",
                    ..ViewSettings::default()
                };
                let others = neighbours(views, index, &settings);
                let others: Vec<&PosedView> = others.into_iter().map(|i| &views[i]).collect();
                let own = &views[index];
                self.scenes[index]
                    .complete_with_views(own, &others, &settings)?
                    .0
            }
            name => {
                let rgb = &self.sequence.frames()[index].frame.rgb;
                let Method::Classic(classic) = name.parse()? else {
                    return Err(Error::config(format!("`{name}` needs weights of its own"))
                        .hint("methods: single, views, past, linear and others without training"));
                };
                return Ok(PredictedFrame {
                    depth: complete_classic(classic, rgb, sparse)?,
                    errors: None,
                });
            }
        };
        Ok(PredictedFrame {
            depth: completion.depth()?,
            errors: Some(PredictedErrors {
                deviations: completion.standard_deviation()?,
                freedom: completion.freedom(),
            }),
        })
    }
}

const FRAMES: usize = 24;
const OPTIONS: [&str; 13] = [
    "rooms",
    "seven-scenes",
    "step",
    "frames",
    "size",
    "motion",
    "points",
    "poses",
    "methods",
    "weights",
    "seed",
    "csv",
    "write",
];

/// Option names and values.
struct Arguments(BTreeMap<String, String>);

impl Arguments {
    fn parse() -> Result<Self> {
        let mut given = std::env::args().skip(1);
        let mut values = BTreeMap::new();
        while let Some(name) = given.next() {
            let known = name
                .strip_prefix("--")
                .filter(|name| OPTIONS.contains(name));
            let Some((known, value)) = known.zip(given.next()) else {
                return Err(Error::config(format!("`{name}` is no option with a value"))
                    .hint(format!("options: --{}", OPTIONS.join(", --"))));
            };
            values.insert(known.to_owned(), value);
        }
        Ok(Self(values))
    }

    fn value(&self, name: &str) -> Option<&str> {
        self.0.get(name).map(String::as_str)
    }

    fn number<T: FromStr>(&self, name: &str, usual: T) -> Result<T> {
        self.value(name)
            .map_or(Ok(usual), |text| parsed(name, text))
    }

    fn list<T: FromStr>(&self, name: &str, usual: &str) -> Result<Vec<T>> {
        let texts = self.value(name).unwrap_or(usual).split(',');
        texts.map(|text| parsed(name, text)).collect()
    }

    /// Returns the sequences of a motion, rendered or read one at a time.
    fn sequences(&self, motion: &str) -> Result<Box<dyn Iterator<Item = Result<Sequence>> + '_>> {
        let frames = self.number("frames", FRAMES)?;
        if let Some(folder) = self.value("seven-scenes") {
            let sequence = seven_scenes(folder.as_ref(), self.number("step", 1)?, frames);
            return Ok(Box::new(std::iter::once(sequence)));
        }
        let size = self.value("size").unwrap_or("320x240");
        let (width, height) = size.split_once('x').unwrap_or((size, ""));
        let path = RoomPath {
            seed: self.number("seed", 0)?,
            room: 0,
            frames,
            width: parsed("size", width)?,
            height: parsed("size", height)?,
            still: motion == "still",
            moving_object: motion == "object",
        };
        if !["path", "object", "still"].contains(&motion) {
            return Err(Error::config(format!("`{motion}` is no motion"))
                .hint("motions: path, object, still"));
        }
        let rooms = 0..self.number("rooms", 4)?;
        Ok(Box::new(
            rooms.map(move |room| RoomPath { room, ..path }.render()),
        ))
    }
}

fn parsed<T: FromStr>(name: &str, text: &str) -> Result<T> {
    text.parse()
        .map_err(|_| Error::config(format!("--{name}: `{text}` cannot be read")))
}
