//! What the results of a frame were made from: kept below their folder, so that a later run uses only
//! those again that it would make itself.

use super::job::{Input, Job};
use super::settings::Settings;
use super::summary::Summary;
use crate::cli::args::Recorded;
use crate::cli::network::own_guide;
use lsdc_core::fit::FitConfig;
use lsdc_eval::data::write_atomically;
use lsdc_eval::predict::{Method, MonocularGuide};
use lsdc_files::error::{Error, Result};
use lsdc_weights::provenance::{self, differences};
use lsdc_weights::{weights_fit, weights_hash};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// The folder of the records, in that of the results.
const FOLDER: &str = ".lsdc";

/// Folder, below the results, of the weights of each frame of a video, from which the next frame starts.
pub(super) fn state(output: &Path, job: &Job) -> PathBuf {
    let mut path = output.join(FOLDER).join(&job.name).into_os_string();
    path.push(".weights.json");
    path.into()
}

/// The record of one frame.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Record {
    settings: Value,
    /// The files that were read.
    inputs: BTreeMap<String, Source>,
    report: Value,
}

/// An input file, or the folder of a model.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Source {
    /// Metadata of a file; while it is unchanged, the file is not read again.
    stamp: Option<Stamp>,
    /// Lower-case extension, which decides how the bytes are read.
    ending: String,
    content: String,
}

/// Size and number of a file, and when it was last written and changed: seconds and nanoseconds. The
/// first time can be set by whoever writes, the second cannot.
type Stamp = (u64, u64, [i64; 2], [i64; 2]);

/// Makes and compares the records of a run.
pub(super) struct Records {
    folder: PathBuf,
    settings: Value,
    /// A model that many frames share is read once.
    models: Mutex<BTreeMap<PathBuf, Source>>,
}

impl Records {
    /// Creates the records of a run with its folder of results.
    pub(super) fn new(settings: &Settings, output: &Path) -> Result<Self> {
        let decisive = Decisive::of(settings)?;
        // Numbers are compared as they are read back.
        let text = serde_json::to_value(&decisive)
            .and_then(|value| serde_json::from_str(&value.to_string()));
        Ok(Self {
            folder: output.join(FOLDER),
            settings: text.map_err(|e| Error::config(format!("settings of the run: {e}")))?,
            models: Mutex::default(),
        })
    }

    fn path(&self, job: &Job) -> PathBuf {
        let mut path = self.folder.join(&job.name).into_os_string();
        path.push(".json");
        path.into()
    }

    /// The record of an earlier run; nothing if there is none that can be read.
    pub(super) fn read(&self, job: &Job) -> Option<Record> {
        let text = std::fs::read_to_string(self.path(job)).ok()?;
        serde_json::from_str(&text).ok()
    }

    /// Describes the first setting or input that differs from the record, if any.
    pub(super) fn difference(
        &self,
        settings: &Settings,
        job: &Job,
        before: &Record,
    ) -> Result<Option<String>> {
        let found = differences(&before.settings, &self.settings);
        // Another method has other settings altogether.
        let method = found.iter().find(|found| found.starts_with("method:"));
        if let Some(first) = method.or(found.first()) {
            return Ok(Some(first.clone()));
        }
        for (role, input) in job.inputs(settings) {
            let path = input.path();
            let same = match before.inputs.get(role) {
                Some(source) if matches!(input, Input::Views(views) if !views.is_one_file()) => {
                    *source == self.source(&input)?
                }
                Some(source) if source.ending != ending(path) => false,
                Some(source) if source.stamp.is_some() && source.stamp == stamp(path) => true,
                Some(source) => source.content == self.source(&input)?.content,
                None => false,
            };
            if !same {
                return Ok(Some(format!("`{}` has changed", path.display())));
            }
        }
        let roles: Vec<&str> = job.inputs(settings).iter().map(|(role, _)| *role).collect();
        let gone = before
            .inputs
            .keys()
            .find(|role| !roles.contains(&role.as_str()));
        Ok(gone.map(|role| format!("it was made with an input `{role}`")))
    }

    /// Returns the input files of a frame that is about to be read.
    pub(super) fn inputs(&self, settings: &Settings, job: &Job) -> Result<Inputs> {
        let inputs = job.inputs(settings).into_iter();
        let sources = inputs.map(|(role, input)| Ok((role.to_owned(), self.source(&input)?)));
        sources.collect::<Result<_>>().map(Inputs)
    }

    /// Removes the record of a frame whose results are about to be replaced: a run that breaks off
    /// in between leaves results without a record rather than with a wrong one.
    pub(super) fn forget(&self, job: &Job) -> Result<()> {
        let path = self.path(job);
        match std::fs::remove_file(&path) {
            Err(e) if e.kind() != ErrorKind::NotFound => Err(Error::write(&path, e)),
            _ => Ok(()),
        }
    }

    /// Keeps the record of a frame whose results are written.
    pub(super) fn write(&self, job: &Job, inputs: Inputs, summary: &Summary) -> Result<()> {
        let path = self.path(job);
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        }
        let record = Record {
            settings: self.settings.clone(),
            inputs: inputs.0,
            report: summary.value(),
        };
        write_atomically(&path, |out| {
            serde_json::to_writer_pretty(&mut *out, &record)?;
            writeln!(out)
        })
    }

    fn source(&self, input: &Input<'_>) -> Result<Source> {
        let path = input.path();
        if let Input::Views(views) = input {
            let (stamp, ending) = if views.is_one_file() {
                (stamp(path), ending(path))
            } else {
                (None, String::new())
            };
            return Ok(Source {
                stamp,
                ending,
                content: views.content(),
            });
        }
        if let Input::Frame(recorded, frame) = input {
            return Ok(Source {
                stamp: stamp(path),
                ending: ending(path),
                content: recorded.content(frame)?,
            });
        }
        if !path.is_dir() {
            return Ok(Source {
                stamp: stamp(path),
                ending: ending(path),
                content: provenance::file_hash(path)?,
            });
        }
        let lock = |e: &dyn std::fmt::Display| Error::config(format!("`{}`: {e}", path.display()));
        let mut models = self.models.lock().map_err(|e| lock(&e))?;
        if let Some(model) = models.get(path) {
            return Ok(model.clone());
        }
        let model = Source {
            stamp: None,
            ending: ending(path),
            content: provenance::folder_hash(path, &["bin", "txt"])?,
        };
        models.insert(path.to_owned(), model.clone());
        Ok(model)
    }
}

/// The inputs of a frame by role.
pub(super) struct Inputs(BTreeMap<String, Source>);

impl Record {
    /// The report of the frame.
    pub(super) fn report(&self) -> &Value {
        &self.report
    }
}

#[cfg(unix)]
fn stamp(path: &Path) -> Option<Stamp> {
    use std::os::unix::fs::MetadataExt as _;
    let found = std::fs::metadata(path).ok()?;
    let written = [found.mtime(), found.mtime_nsec()];
    let changed = [found.ctime(), found.ctime_nsec()];
    let stamp = (found.len(), found.ino(), written, changed);
    found.is_file().then_some(stamp)
}

/// Without reliable metadata on this platform, files are always read again.
#[cfg(not(unix))]
fn stamp(_: &Path) -> Option<Stamp> {
    None
}

fn ending(path: &Path) -> String {
    let ending = path.extension().unwrap_or_default();
    ending.to_string_lossy().to_lowercase()
}

/// Everything but the input files that determines the results of a frame.
#[derive(Serialize)]
struct Decisive<'a> {
    numerics: Value,
    /// Hash of the weights.
    weights: Option<String>,
    fit: Option<FitConfig>,
    device: Option<&'a str>,
    /// With a recording.
    recording: Option<&'a Recorded>,
    /// The contents of the network that predicts the guide, if one does.
    #[serde(skip_serializing_if = "Option::is_none")]
    guide_network: Option<Value>,
    #[serde(flatten)]
    settings: &'a Settings,
}

impl<'a> Decisive<'a> {
    fn of(settings: &'a Settings) -> Result<Self> {
        let path = settings.model.weights.as_deref();
        let has_weights = !matches!(settings.method, Method::Classic(_));
        let fit = (settings.method == Method::Lsdc).then(|| weights_fit(path));
        let guide = settings.guide.as_ref();
        let guide_network = match MonocularGuide::open(guide)? {
            Some(network) => Some(network.made_from()),
            None if settings.method == Method::Lsdc => {
                let own = own_guide(path, &settings.model.device, guide)?;
                own.map(Value::from)
            }
            None => None,
        };
        Ok(Self {
            numerics: provenance::numerics(),
            weights: has_weights.then(|| weights_hash(path)).transpose()?,
            fit: fit.transpose()?.map(|stored| settings.fit(&stored)),
            device: has_weights.then_some(&*settings.model.device),
            recording: settings.rgb.is_empty().then_some(&settings.recording),
            guide_network,
            settings,
        })
    }
}
