//! Folders of results, as `lsdc complete` and `lsdc eval --save` write them.

use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The results of one method, or of one run.
#[derive(Clone, Debug, Default)]
pub(crate) struct GalleryRun {
    pub(super) name: String,
    /// By their names, in which `/` leads to folders.
    pub(super) frames: BTreeMap<String, GalleryFrame>,
}

/// The files of a frame.
#[derive(Clone, Debug, Default)]
pub(crate) struct GalleryFrame {
    pub(super) image: Option<PathBuf>,
    pub(super) colours: Option<PathBuf>,
    pub(super) depth: Option<PathBuf>,
    pub(super) deviation: Option<PathBuf>,
    /// Metres, and what kind of error it is.
    pub(super) error: Option<(f64, &'static str)>,
    pub(super) failure: Option<String>,
}

/// Endings of depth maps after the name of their frame, most precise format first.
const DEPTHS: [&str; 6] = [
    "_depth.npy",
    "_depth.npz",
    "_depth.exr",
    "_depth.tiff",
    "_depth.pfm",
    "_depth.png",
];
const COLOURS: &str = "_depth_color.png";
const DEVIATION: &str = "_sigma.npy";
/// The folder of what results were made from.
const RECORDS: &str = ".lsdc";
/// Files of a folder that are looked at.
const MOST: usize = 100_000;

/// The runs in a folder.
pub(super) fn runs(folder: &Path) -> Vec<GalleryRun> {
    let evaluated = evaluated(folder);
    if evaluated.is_empty() {
        vec![completed(folder)]
    } else {
        evaluated
    }
}

fn name(path: &Path) -> String {
    let name = path.canonicalize().ok();
    let name = name.as_deref().unwrap_or(path).file_name();
    name.unwrap_or_default().to_string_lossy().into_owned()
}

/// Results of `lsdc complete`.
fn completed(folder: &Path) -> GalleryRun {
    let files = files(folder);
    let mut frames: BTreeMap<String, GalleryFrame> = BTreeMap::new();
    let mut add = |ending: &str, set: fn(&mut GalleryFrame, &Path)| {
        for (id, path) in &files {
            if let Some(stem) = id.strip_suffix(ending) {
                set(frames.entry(stem.to_owned()).or_default(), path);
            }
        }
    };
    for ending in DEPTHS {
        add(ending, |frame, path| {
            frame.depth.get_or_insert_with(|| path.to_owned());
        });
    }
    add(COLOURS, |frame, path| frame.colours = Some(path.to_owned()));
    add(DEVIATION, |frame, path| {
        frame.deviation = Some(path.to_owned());
    });
    for (id, frame) in &mut frames {
        frame.image = image(folder, id);
    }
    add_records(folder, &mut frames);
    GalleryRun {
        name: name(folder),
        frames,
    }
}

/// The image of a frame, if it lies beside the results.
fn image(folder: &Path, id: &str) -> Option<PathBuf> {
    let endings = ["jpg", "jpeg", "png", "webp"].into_iter();
    let mut paths = endings.map(|ending| folder.join(format!("{id}.{ending}")));
    paths.find(|path| path.is_file())
}

/// Adds the leave-one-out errors of the records.
fn add_records(folder: &Path, frames: &mut BTreeMap<String, GalleryFrame>) {
    let records = folder.join(RECORDS);
    for (id, path) in files(&records) {
        // Named after the image: `left/0001.png.json`.
        let stem = id.strip_suffix(".json").and_then(|id| id.rsplit_once('.'));
        let Some((stem, _)) = stem else { continue };
        let Some(record) = read_json(&path) else {
            continue;
        };
        let frame = frames.entry(stem.to_owned()).or_default();
        let error = record["report"]["fit"]["leave_one_out"].as_f64();
        frame.error = error.map(|error| (error, "leave-one-out"));
        if frame.depth.is_none() && frame.colours.is_none() {
            frame.failure = Some("its results are missing".to_owned());
        }
    }
}

/// Results of `lsdc eval --save`: `METHOD/seedN/FRAME.npy`.
fn evaluated(folder: &Path) -> Vec<GalleryRun> {
    let mut runs: BTreeMap<String, GalleryRun> = BTreeMap::new();
    let parts = |id: &str| {
        let (method, rest) = id.split_once("/seed")?;
        let (seed, frame) = rest.split_once('/')?;
        let frame = frame.strip_suffix(".npy")?;
        let seed: u64 = seed.parse().ok()?;
        Some((method.to_owned(), seed, frame.to_owned()))
    };
    let report = [folder.join("report.json"), folder.join("../report.json")];
    let report = report.iter().find_map(|path| read_json(path));
    let errors = report.as_ref().map(errors).unwrap_or_default();
    for (id, path) in files(folder) {
        let Some((method, seed, frame)) = parts(&id) else {
            continue;
        };
        let error = errors.get(&(method.clone(), seed, frame.clone()));
        let run = runs.entry(method.clone()).or_default();
        run.name = method;
        let frame = run.frames.entry(format!("seed{seed}/{frame}")).or_default();
        frame.depth = Some(path);
        frame.error = error.map(|error| (*error, "RMSE"));
    }
    for (name, why) in report.iter().flat_map(failures) {
        for run in runs.values_mut() {
            let frame = run.frames.entry(name.clone()).or_default();
            frame.failure = Some(why.clone());
        }
    }
    runs.into_values().collect()
}

/// The root mean square errors of a report, by method, seed and frame.
fn errors(report: &Value) -> BTreeMap<(String, u64, String), f64> {
    let lines = report["frames"].as_array().into_iter().flatten();
    let mut errors = BTreeMap::new();
    for line in lines {
        let (Some(frame), Some(seed)) = (line["frame"].as_str(), line["seed"].as_u64()) else {
            continue;
        };
        for (method, scores) in line["scores"].as_object().into_iter().flatten() {
            if let Some(error) = scores["rmse"].as_f64() {
                errors.insert((method.clone(), seed, frame.to_owned()), error);
            }
        }
    }
    errors
}

/// The frames of a report that failed, and why.
fn failures(report: &Value) -> Vec<(String, String)> {
    let failures = report["failures"].as_array().into_iter().flatten();
    let failures = failures.filter_map(|failure| {
        let frame = failure["frame"].as_str()?;
        let why = failure["error"]
            .as_str()
            .unwrap_or("it could not be completed");
        Some((frame.to_owned(), why.to_owned()))
    });
    failures.collect()
}

fn read_json(path: &Path) -> Option<Value> {
    serde_json::from_slice(&std::fs::read(path).ok()?).ok()
}

/// The files in a folder and below it, but for hidden folders, with their names from there.
fn files(folder: &Path) -> Vec<(String, PathBuf)> {
    let (mut found, mut folders) = (Vec::new(), vec![(String::new(), folder.to_owned())]);
    while let Some((above, folder)) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let Ok(kind) = entry.file_type() else {
                continue;
            };
            if kind.is_dir() && !name.starts_with('.') {
                folders.push((format!("{above}{name}/"), entry.path()));
            } else if kind.is_file() && found.len() < MOST {
                found.push((format!("{above}{name}"), entry.path()));
            }
        }
    }
    found
}
