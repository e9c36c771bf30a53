//! Evaluation of methods on a dataset, with the same frames and points for each.

mod candidate;
mod config;
mod journal;
mod sequence;
mod timing;

pub use candidate::{Candidate, Enlargement};
pub use config::EvalConfig;
pub use journal::Journal;
pub use sequence::{PredictedFrame, SequenceScores, SequenceTask};
pub use timing::{CompletionTimes, median_ms, time, time_deviations};

use crate::data::{Dataset, Frame, GUIDE_ENDINGS, Shard};
use crate::metrics::{DepthRangeErrors, ErrorProfile, Metric, Rules, Scores, UncertaintyScores};
use crate::predict::Guides;
use crate::report::{EvaluationReport, ExampleFrame, Failure, FrameRecord, Heading, MethodOutcome};
use crate::sampling::{CompletionTask, HoldOut, Noise, Pattern, Protocol};
use candidate::PreparedFrame;
use lsdc_classic::distances;
use lsdc_core::{Completer, Quality, RANGE};
use lsdc_files::error::{Error, Result};
use lsdc_weights::provenance::{self, FileStamp};
use rayon::prelude::*;
use serde_json::{Map, Value, json};
use std::ops::ControlFlow;

/// All inputs of an evaluation.
pub struct Evaluation<'a> {
    /// The frames.
    pub frames: &'a dyn Dataset,
    /// Candidates to compare, with their names.
    pub candidates: Vec<(String, Candidate)>,
    /// The network, if a candidate needs one.
    pub completer: Option<&'a Completer>,
    /// Guides for `lsdc`.
    pub guides: Option<Guides<'a>>,
    /// Protocol: sizes and valid depths.
    pub protocol: Protocol,
    /// Pattern of sparse points.
    pub points: Pattern,
    /// Pixels held out of each frame.
    pub hold_out: Option<HoldOut>,
    /// Noise added to the points.
    pub noise: Option<Noise>,
    /// Seeds of the draws, one for each repetition.
    pub seeds: Vec<u64>,
    /// Parameters of the metrics.
    pub rules: Rules,
    /// Whether the standard deviations of `lsdc` are measured.
    pub uncertainty: bool,
    /// Largest standard deviation, as a fraction of the predicted depth, that counts as certain; `None` to count none.
    pub sigma_cut: Option<f64>,
    /// Limit of the number of frames; the first frames are used.
    pub limit: Option<usize>,
}

impl Evaluation<'_> {
    /// Returns the heading of the report. `dataset`, `protocol_text` (the protocol) and `weights` are descriptions for readers.
    /// [`Heading::made_from`] records everything that the numbers depend on: numerics, protocol, points, frames, methods with
    /// all settings of the fit, predictions by their contents, and `inputs`, which the caller provides: the settings of the
    /// dataset and the weights by their contents.
    ///
    /// # Errors
    /// A folder of predictions or points cannot be read, or predictions do not distinguish several draws.
    pub fn heading(
        &self,
        dataset: &str,
        protocol_text: &str,
        weights: Option<String>,
        inputs: Value,
    ) -> Result<Heading> {
        // All fields are named, so that none is omitted from the record.
        let Self {
            frames,
            candidates,
            completer,
            guides,
            protocol,
            points,
            hold_out,
            noise,
            seeds,
            rules,
            uncertainty,
            sigma_cut,
            limit: _,
        } = self;
        let mut methods = Map::new();
        for (name, candidate) in candidates {
            candidate.check_draws(name, seeds)?;
            methods.insert(name.clone(), candidate.made_from()?);
        }
        let point_files = match points {
            Pattern::Files(folder) => Some(provenance::folder_hash(folder, &["npy", "png"])?),
            _ => None,
        };
        let guides = guides.map(|guides| match guides {
            Guides::Files(source) => {
                let contents = provenance::folder_hash(&source.path, &GUIDE_ENDINGS)?;
                Ok::<_, Error>(json!([format!("{:?}", source.kind), contents]))
            }
            Guides::Predicted(network) => Ok(network.made_from()),
        });
        let ids: Vec<_> = (0..self.total()).map(|i| frames.id(i)).collect();
        let mut made_from = json!({
            "numerics": provenance::numerics(),
            "inputs": inputs,
            "frames": format!("{:016x}", lsdc_rng::hash(&ids)),
            "protocol": protocol,
            "points": points,
            "point_files": point_files,
            "noise": noise,
            "guides": guides.transpose()?,
            "methods": methods,
            "fit": completer.map(Completer::fit_config),
            "uncertainty": uncertainty,
        });
        // Recorded only if used, so that older results stay valid.
        let quality = completer.map(Completer::quality);
        if let Some(quality) = quality.filter(|quality| *quality != Quality::Standard) {
            made_from["quality"] = json!(quality);
        }
        if let Some(law) = hold_out {
            made_from["hold_out"] = json!(law);
        }
        if let Some(cut) = sigma_cut {
            made_from["sigma_cut"] = json!(cut);
        }
        Ok(Heading {
            made_from,
            dataset: dataset.to_owned(),
            found: frames.description(),
            protocol: protocol_text.to_owned(),
            steps: protocol.to_string(),
            points: points.to_string(),
            hold_out: hold_out.map(|law| law.to_string()),
            noise: noise.map(|noise| noise.to_string()),
            seeds: seeds.clone(),
            methods: candidates.iter().map(|(name, _)| name.clone()).collect(),
            weights,
            limits: format!("predictions of lsdc within {RANGE} x the range of the points"),
            rules: *rules,
            sigma_cut: *sigma_cut,
            frames: self.total(),
        })
    }

    /// Returns the number of frames.
    pub fn total(&self) -> usize {
        self.frames.len().min(self.limit.unwrap_or(usize::MAX))
    }

    /// Measures the frames of `shard` that are not in the journal yet, and calls `progress` with the numbers of frames done and
    /// in total. `progress` may stop the run; the report then has the frames measured so far. The result does not depend on the
    /// order of work or the number of threads.
    ///
    /// Frames that cannot be read or completed are listed in the report and excluded from the means.
    ///
    /// # Errors
    /// The journal cannot be written, or holds frames whose files have changed since. If every frame failed: the first failure.
    pub fn run(
        &self,
        heading: Heading,
        shard: Shard,
        mut journal: Journal,
        mut progress: impl FnMut(usize, usize) -> ControlFlow<()>,
    ) -> Result<EvaluationReport> {
        let shard_frames: Vec<usize> = (0..self.total())
            .filter(|&i| shard.holds(&self.frames.id(i)))
            .collect();
        let mut report = EvaluationReport::new(heading).of_part(shard);
        let done = journal.take_records();
        let finished = |index: &usize| {
            let id = self.frames.id(*index);
            let has = |seed: &u64| done.contains_key(&(id.clone(), *seed));
            self.seeds.iter().all(has)
        };
        let (measured, pending): (Vec<usize>, Vec<usize>) =
            shard_frames.iter().partition(|i| finished(i));
        for index in &measured {
            for seed in &self.seeds {
                let record = &done[&(self.frames.id(*index), *seed)];
                self.check_unchanged(*index, record)?;
                report.add(record.clone())?;
            }
        }
        let mut first_error = None;
        let mut count = measured.len();
        for batch in pending.chunks(rayon::current_num_threads()) {
            if progress(count, shard_frames.len()).is_break() {
                break;
            }
            let outcomes: Vec<_> = batch.par_iter().map(|&i| self.measure(i)).collect();
            for (&index, outcome) in batch.iter().zip(outcomes) {
                match outcome {
                    Ok(records) => {
                        for record in records {
                            journal.add(&record)?;
                            report.add(record)?;
                        }
                    }
                    Err(error) => {
                        report.fail(Failure {
                            frame: self.frames.id(index),
                            error: error.with_causes(),
                        });
                        first_error.get_or_insert(error);
                    }
                }
            }
            count += batch.len();
        }
        let _ = progress(count, shard_frames.len());
        match first_error {
            Some(error) if report.frames().is_empty() => Err(error),
            _ => Ok(report),
        }
    }

    /// Returns the current stamps of the files of a frame.
    fn stamps(&self, index: usize) -> Vec<FileStamp> {
        let files = self.frames.files(index);
        files
            .iter()
            .map(|path| provenance::file_stamp(path))
            .collect()
    }

    /// Checks that the files of a frame are unchanged since it was measured.
    fn check_unchanged(&self, index: usize, record: &FrameRecord) -> Result<()> {
        let stamps = self.stamps(index);
        if stamps == record.files {
            return Ok(());
        }
        let mut pairs = stamps.iter().zip(&record.files);
        let changed = pairs.position(|(now, before)| now != before);
        let files = self.frames.files(index);
        let path = changed.and_then(|place| files.get(place));
        let what = path.map_or("it has other files".to_owned(), |path| {
            format!("`{}` has changed", path.display())
        });
        Err(Error::config(format!(
            "frame `{}` is not what was measured: {what}",
            record.frame
        ))
        .hint("choose another folder, or give --force to begin anew"))
    }

    /// Measures a frame, with one record for each seed.
    fn measure(&self, index: usize) -> Result<Vec<FrameRecord>> {
        // Stamps are read first: changes after this are detected by the next run.
        let files = self.stamps(index);
        let frame = self.frame(index)?;
        let prepared = PreparedFrame::new(self.completer, self.guides, &frame, self.uncertainty)?;
        self.seeds
            .iter()
            .map(|&seed| {
                let CompletionTask { sparse, truth } = self.task(&frame, seed)?;
                let point_distances = distances(&sparse);
                let outcomes = self
                    .candidates
                    .iter()
                    .map(|(_, candidate)| {
                        let (depth, predicted_errors) =
                            prepared.predict(candidate, &frame, &sparse, seed)?;
                        let certain = predicted_errors.as_ref().zip(self.sigma_cut);
                        let certain = certain.map(|(f, cut)| (&f.deviations, cut));
                        Ok(MethodOutcome {
                            scores: Scores::of(&depth, &truth, &self.rules)?,
                            profile: ErrorProfile::of(&depth, &truth, &point_distances),
                            ranges: DepthRangeErrors::of(&depth, &truth, certain),
                            uncertainty: predicted_errors
                                .map(|f| UncertaintyScores::of(&depth, &truth, &f)),
                        })
                    })
                    .collect::<Result<_>>()?;
                Ok(FrameRecord {
                    frame: frame.id.clone(),
                    seed,
                    points: sparse.count(),
                    place: frame.place,
                    scene: self.frames.scene(index),
                    outcomes,
                    files: files.clone(),
                })
            })
            .collect()
    }

    /// Returns the frame, its points and every prediction under a seed, for a report with pictures.
    ///
    /// # Errors
    /// No frame of this name, or one that cannot be measured.
    pub fn example(&self, role: &'static str, id: &str, seed: u64) -> Result<ExampleFrame> {
        let index = (0..self.frames.len())
            .find(|&i| self.frames.id(i) == id)
            .ok_or_else(|| Error::config(format!("there is no frame `{id}`")))?;
        let frame = self.frame(index)?;
        let CompletionTask { sparse, truth } = self.task(&frame, seed)?;
        let prepared = PreparedFrame::new(self.completer, self.guides, &frame, false)?;
        let predictions = self
            .candidates
            .iter()
            .map(|(name, candidate)| {
                let (depth, _) = prepared.predict(candidate, &frame, &sparse, seed)?;
                let scores = Scores::of(&depth, &truth, &self.rules)?;
                Ok((name.clone(), scores[Metric::Rmse], depth))
            })
            .collect::<Result<_>>()?;
        Ok(ExampleFrame {
            role,
            frame: frame.id,
            rgb: frame.rgb,
            sparse,
            truth,
            predictions,
        })
    }

    /// Returns a frame at the protocol's size.
    ///
    /// # Errors
    /// The frame cannot be read, is too small, or has no valid true depth.
    pub fn frame(&self, index: usize) -> Result<Frame> {
        let frame = self.protocol.apply(&self.frames.load(index)?)?;
        if frame.depth.count() == 0 {
            return Err(Error::shape(format!(
                "frame `{}` has no true depth that counts",
                frame.id
            )));
        }
        Ok(frame)
    }

    /// Draws the points of a frame under a seed, and the depths to score.
    ///
    /// # Errors
    /// The errors of [`CompletionTask::draw`].
    pub fn task(&self, frame: &Frame, seed: u64) -> Result<CompletionTask> {
        CompletionTask::draw(frame, &self.points, self.hold_out, self.noise, seed)
    }
}
