//! Parameters and times (Fang et al., table 5).

use super::tables::{column, row};
use super::trial::{Progress, Trial, as_trials};
use super::{ExperimentContext, Study, published};
use crate::systems::Predictor;
use burn::module::Module as _;
use lsdc_core::Completer;
use lsdc_core::network::NetworkConfig;
use lsdc_core::weights::Normalisation;
use lsdc_eval::data::{Dataset as _, DepthMap, Frame, Rooms, RoomsConfig, Split, write_atomically};
use lsdc_eval::evaluation::{CompletionTimes, median_ms, time};
use lsdc_eval::predict::complete_classic;
use lsdc_eval::report::{Ranking, Section, Table};
use lsdc_eval::sampling::{Pattern, Size};
use lsdc_files::error::{Error, Result};
use lsdc_train::model::{InitNetwork as _, parameter_count, weights_of};
use lsdc_train::predict;
use lsdc_weights::provenance::{self, differences};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::Instant;

pub(super) const POINTS: usize = 500;
const RUNS: usize = 5;
pub(super) const SIZES: [Size; 2] = [
    Size {
        height: 228,
        width: 304,
    },
    Size {
        height: 480,
        width: 640,
    },
];

/// Returns a frame of a procedural room, for timing.
fn room(size: Size) -> Result<Frame> {
    let config = RoomsConfig {
        width: size.width,
        height: size.height,
        ..RoomsConfig::default()
    };
    Rooms::new(Split::Val, &config)?.load(0)
}

/// A timing measurement, run once.
pub(super) struct Timed<'a> {
    pub(super) context: &'a ExperimentContext,
    pub(super) name: String,
    /// Label that identifies the subject and settings that are not in the context.
    pub(super) label: String,
    pub(super) subject: TimedSubject,
    pub(super) size: Size,
}

#[derive(Clone)]
pub(super) enum TimedSubject {
    /// The network of the context, and whether it is run at full resolution.
    Ours { full: bool },
    /// Another network.
    Other(Box<Completer>),
    /// The paper's network with random weights, and the paper's fit.
    Paper,
    /// A method without training.
    Classic(lsdc_eval::predict::Classic),
    /// A trained system for comparison.
    System(Predictor),
}

/// Times of a trial, as stored on disk.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct StoredTimes {
    /// Record of the inputs: numerics, weights, device, fit, label and threads.
    of: Value,
    times: CompletionTimes,
    /// Number of trained parameters, and multiply-adds at this size.
    parameters: Option<usize>,
    multiply_adds: Option<u64>,
}

impl Timed<'_> {
    fn path(&self) -> PathBuf {
        self.context.trial(&self.name, "json")
    }

    fn of(&self) -> Value {
        json!({
            "numerics": provenance::numerics(),
            "weights": self.context.weights,
            "device": self.context.device.1,
            "fit": self.context.completer.fit_config(),
            "label": self.label,
            "threads": rayon::current_num_threads(),
        })
    }

    /// Returns the total time in milliseconds.
    pub(super) fn total(&self) -> Result<f64> {
        Ok(self.times()?.times.total_ms)
    }

    fn times(&self) -> Result<StoredTimes> {
        let path = self.path();
        let bytes = std::fs::read(&path).map_err(|e| Error::read(&path, e))?;
        let stored: StoredTimes =
            serde_json::from_slice(&bytes).map_err(|e| Error::read(&path, e.into()))?;
        let now = serde_json::from_str(&self.of().to_string()).unwrap_or_default();
        match differences(&stored.of, &now).first() {
            None => Ok(stored),
            Some(first) => Err(Error::config(format!(
                "`{}` has times of something else: {first}",
                path.display()
            ))
            .hint("choose another folder, or give --force to begin anew")),
        }
    }

    fn measure(&self) -> Result<StoredTimes> {
        let frame = room(self.size)?;
        let points = Pattern::Exactly(POINTS);
        let sparse = points.draw(&frame, 0)?;
        let device = &self.context.device.0;
        let size = (self.size.height, self.size.width);
        let timed = |completer: &Completer| time(completer, &frame, &points, RUNS);
        let (times, parameters, multiply_adds) = match &self.subject {
            &TimedSubject::Ours { full } => {
                let mut completer = self.context.completer.clone();
                let net = self.context.network.init(0, device)?;
                // Larger images are resized to this size before the network.
                let mut input = SIZES[0];
                if full {
                    completer = completer.with_working_size(size.0, size.1)?;
                    input = self.size;
                }
                let adds = net.multiply_adds((input.height, input.width));
                (timed(&completer)?, Some(parameter_count(&net)), Some(adds))
            }
            TimedSubject::Other(completer) => (timed(completer)?, None, None),
            TimedSubject::Paper => {
                let config = NetworkConfig::paper();
                let net = config.init(0, device)?.valid();
                let normalisation = Normalisation {
                    input: [size.0, size.1],
                    ..Normalisation::default()
                };
                let (parameters, adds) = (parameter_count(&net), net.multiply_adds(size));
                let weights = weights_of(&net, config, normalisation);
                let completer = predict::completer(&weights, device)?;
                (timed(&completer)?, Some(parameters), Some(adds))
            }
            &TimedSubject::Classic(method) => {
                let whole = || complete_classic(method, &frame.rgb, &sparse);
                (time_whole(whole)?, None, None)
            }
            TimedSubject::System(predictor) => {
                let whole = || predictor.complete(&frame.rgb, &sparse);
                let parameters = parameter_count(predictor.net());
                (time_whole(whole)?, Some(parameters), None)
            }
        };
        Ok(StoredTimes {
            of: self.of(),
            times,
            parameters,
            multiply_adds,
        })
    }
}

/// Returns the median time over all runs of a method without stages.
fn time_whole(complete: impl Fn() -> Result<DepthMap>) -> Result<CompletionTimes> {
    let mut times = Vec::new();
    for _ in 0..RUNS {
        let started = Instant::now();
        complete()?;
        times.push(started.elapsed());
    }
    Ok(CompletionTimes {
        network_ms: 0.0,
        fit_ms: 0.0,
        field_ms: 0.0,
        solve_ms: 0.0,
        dense_ms: 0.0,
        total_ms: median_ms(times.into_iter())?,
    })
}

impl Trial for Timed<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn stored(&self) -> Result<usize> {
        if !self.path().exists() {
            return Ok(0);
        }
        self.times().map(|_| 1)
    }

    /// Takes a few seconds and cannot be interrupted.
    fn run(&self, progress: &mut Progress<'_>) -> Result<()> {
        let path = self.path();
        if !path.exists() {
            let times = serde_json::to_vec(&self.measure()?);
            let times = times.map_err(|e| Error::write(&path, e.into()))?;
            write_atomically(&path, |out| out.write_all(&times))?;
        }
        let _ = progress(1.0);
        Ok(())
    }
}

pub(super) struct Cost<'a> {
    context: &'a ExperimentContext,
    trials: Vec<Timed<'a>>,
}

impl<'a> Cost<'a> {
    pub(super) fn new(context: &'a ExperimentContext) -> Self {
        let mut trials = Vec::new();
        for size in SIZES {
            let mut subjects = vec![
                ("lsdc".to_owned(), TimedSubject::Ours { full: false }),
                (
                    "the paper's network and fit".to_owned(),
                    TimedSubject::Paper,
                ),
            ];
            if size != SIZES[0] {
                let all = (
                    "lsdc, network at this size".to_owned(),
                    TimedSubject::Ours { full: true },
                );
                subjects.insert(1, all);
            }
            for method in super::benchmark::BASELINES {
                if let lsdc_eval::predict::Method::Classic(classic) = method {
                    subjects.push((method.name().to_owned(), TimedSubject::Classic(classic)));
                }
            }
            for (number, (label, subject)) in subjects.into_iter().enumerate() {
                trials.push(Timed {
                    context,
                    name: format!("cost-{}-{number}", size.width),
                    label,
                    subject,
                    size,
                });
            }
        }
        Self { context, trials }
    }
}

impl Study for Cost<'_> {
    fn trials(&self) -> Vec<&dyn Trial> {
        as_trials(&self.trials)
    }

    fn section(&self) -> Result<Section> {
        let mut section = Section::new("cost", "Parameters and times (table 5)");
        section.about.push(format!(
            "Device {}, {} threads; {POINTS} points; median of {RUNS} runs from an image in memory to \
             depth in memory, taken when the experiment first ran. {}.",
            self.context.device.1,
            rayon::current_num_threads(),
            self.context.weights
        ));
        section.about.push(
            "GFLOP: two to each multiplication with a weight. `lsdc` reduces larger images to its \
             training size before the network; the paper's network has random weights, which cost the \
             same. Memory: `lsdc bench` says it for a process of its own."
                .into(),
        );
        for size in SIZES {
            let mut rows = Vec::new();
            for trial in self.trials.iter().filter(|trial| trial.size == size) {
                let StoredTimes {
                    times,
                    parameters,
                    multiply_adds,
                    ..
                } = trial.times()?;
                let staged = parameters.is_some();
                let values = [
                    parameters.map(|n| n as f64 / 1e6),
                    multiply_adds.map(|n| 2.0 * n as f64 / 1e9),
                    staged.then_some(times.network_ms),
                    staged.then_some(times.fit_ms),
                    staged.then_some(times.dense_ms),
                    Some(times.total_ms),
                ];
                rows.push(row(&trial.label, values));
            }
            if size == SIZES[0] {
                for (name, parameters, total) in published::TABLE_5 {
                    let values = vec![Some(parameters), None, None, None, None, Some(total)];
                    rows.push(published::row(name, values));
                }
            }
            section.tables.push(Table {
                title: format!("Cost of a frame of {}x{}", size.width, size.height),
                row_header: "method".into(),
                ranking: Ranking::None,
                columns: vec![
                    column("parameters", "M", 2),
                    column("compute", "GFLOP", 1),
                    column("network", "ms", 1),
                    column("fit", "ms", 1),
                    column("dense", "ms", 1),
                    column("total", "ms", 1),
                ],
                rows,
            });
        }
        section.notes = published::notes(&published::TABLE_5_NOTES);
        let bars = lsdc_eval::report::Bars {
            title: "Time of a frame of 304x228",
            unit: "ms",
            parts: &["network", "fit", "dense", "all"],
            rows: self.bars()?,
        };
        section.add_figure(
            "times",
            "Time by stage; methods without stages in one piece.",
            bars.draw(),
        );
        Ok(section)
    }
}

impl Cost<'_> {
    fn bars(&self) -> Result<Vec<(String, Vec<f64>)>> {
        let small = self.trials.iter().filter(|trial| trial.size == SIZES[0]);
        small
            .map(|trial| {
                let StoredTimes {
                    times, parameters, ..
                } = trial.times()?;
                let parts = match parameters {
                    Some(_) => vec![times.network_ms, times.fit_ms, times.dense_ms, 0.0],
                    None => vec![0.0, 0.0, 0.0, times.total_ms],
                };
                Ok((trial.label.clone(), parts))
            })
            .collect()
    }
}
