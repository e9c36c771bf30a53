//! The parts of experiments, with results stored on disk.

use super::ExperimentContext;
use lsdc_core::Completer;
use lsdc_core::fit::{FitConfig, FitMethod, PriorKind};
use lsdc_core::network::NetworkConfig;
use lsdc_eval::data::{Dataset, GuideSource, Shard, write_atomically};
use lsdc_eval::evaluation::{Candidate, Evaluation, Journal};
use lsdc_eval::metrics::Scores;
use lsdc_eval::predict::{Guides, Method};
use lsdc_eval::report::{EvaluationReport, ExampleFrame, Failure, Heading, Panels, Section};
use lsdc_eval::sampling::{Noise, Pattern, Protocol, ProtocolPreset};
use lsdc_files::error::{Error, Result};
use lsdc_train::predict::open_completer;
use lsdc_train::training::{RunOutcome, Subject, TrainConfig, Trainer, TrainingEvent};
use lsdc_weights::provenance::{self, differences};
use lsdc_weights::weights_hash;
use serde_json::{Value, json};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A callback that receives the completed fraction of a part, before its first work and after each step; it may stop the part.
pub(super) type Progress<'a> = dyn FnMut(f64) -> ControlFlow<()> + 'a;

/// A part of an experiment.
pub(super) trait Trial {
    /// Returns its name in files.
    fn name(&self) -> &str;

    /// Returns the number of results stored by an earlier run.
    fn stored(&self) -> Result<usize>;

    /// Runs the remaining work.
    fn run(&self, progress: &mut Progress<'_>) -> Result<()>;

    /// Returns the frames that could not be measured, after it is complete.
    fn failures(&self) -> Result<Vec<Failure>> {
        Ok(Vec::new())
    }
}

/// An experiment with its parts.
pub(super) trait Study {
    /// Returns the parts.
    fn trials(&self) -> Vec<&dyn Trial>;

    /// Returns the results, after all parts are complete.
    fn section(&self) -> Result<Section>;
}

/// Returns the trials of a study that has one kind of them.
pub(super) fn as_trials<T: Trial>(trials: &[T]) -> Vec<&dyn Trial> {
    trials.iter().map(|trial| trial as &dyn Trial).collect()
}

/// An evaluation of methods on frames.
pub(super) struct Measured<'a> {
    context: &'a ExperimentContext,
    name: String,
    dataset: String,
    frames: Arc<dyn Dataset>,
    completer: Completer,
    /// Description of the weights of the completer, which identifies them exactly.
    weights: String,
    guides: Option<GuideSource>,
    candidates: Vec<(String, Candidate)>,
    protocol_name: String,
    protocol: Protocol,
    points: Pattern,
    noise: Option<Noise>,
    uncertainty: bool,
}

impl<'a> Measured<'a> {
    /// Evaluates `lsdc` on the frames, protocol and points of the context.
    pub(super) fn new(context: &'a ExperimentContext, name: impl Into<String>) -> Self {
        Self {
            context,
            name: name.into(),
            dataset: context.dataset.clone(),
            frames: context.frames.clone(),
            completer: context.completer.clone(),
            weights: context.weights.clone(),
            guides: None,
            candidates: vec![("lsdc".to_owned(), Candidate::Method(Method::Lsdc))],
            protocol_name: format!("{}: {}", context.preset.name, context.preset.source),
            protocol: context.preset.protocol,
            points: context.preset.points.clone(),
            noise: None,
            uncertainty: false,
        }
    }

    /// Sets the methods, instead of `lsdc` alone.
    pub(super) fn methods(mut self, methods: &[Method]) -> Self {
        let named = |method: &Method| (method.name().to_owned(), Candidate::Method(*method));
        self.candidates = methods.iter().map(named).collect();
        self
    }

    pub(super) fn candidates(mut self, candidates: Vec<(String, Candidate)>) -> Self {
        self.candidates = candidates;
        self
    }

    pub(super) fn with_candidates(
        mut self,
        candidates: impl IntoIterator<Item = (String, Candidate)>,
    ) -> Self {
        self.candidates.extend(candidates);
        self
    }

    /// Sets the guides of `lsdc`.
    pub(super) fn guides(mut self, guides: Option<GuideSource>) -> Self {
        self.guides = guides;
        self
    }

    pub(super) fn points(mut self, points: Pattern) -> Self {
        self.points = points;
        self
    }

    pub(super) fn noise(mut self, noise: Option<Noise>) -> Self {
        self.noise = noise;
        self
    }

    /// Also evaluates its standard deviations.
    pub(super) fn uncertainty(mut self) -> Self {
        self.uncertainty = true;
        self
    }

    pub(super) fn on_frames(mut self, dataset: String, frames: Arc<dyn Dataset>) -> Self {
        (self.dataset, self.frames) = (dataset, frames);
        self
    }

    pub(super) fn protocol(mut self, preset: &ProtocolPreset) -> Self {
        self.protocol_name = format!("{}: {}", preset.name, preset.source);
        self.protocol = preset.protocol;
        self.points = preset.points.clone();
        self
    }

    /// Sets a protocol of another size.
    pub(super) fn resized(mut self, protocol: Protocol, protocol_name: &str) -> Self {
        self.protocol = protocol;
        protocol_name.clone_into(&mut self.protocol_name);
        self
    }

    pub(super) fn fit(mut self, change: impl FnOnce(&mut FitConfig)) -> Self {
        let mut fit = *self.completer.fit_config();
        change(&mut fit);
        self.completer = self.completer.with_fit(fit);
        self
    }

    /// Sets the paper's fit for the same basis functions.
    pub(super) fn paper_fit(self) -> Self {
        self.fit(|fit| {
            fit.method = FitMethod::Lse;
            fit.prior = PriorKind::None;
        })
    }

    /// Sets another network than that of the context.
    pub(super) fn completer(mut self, completer: Completer, weights: String) -> Self {
        (self.completer, self.weights) = (completer, weights);
        self
    }

    fn evaluation(&self) -> Evaluation<'_> {
        Evaluation {
            frames: &*self.frames,
            candidates: self.candidates.clone(),
            completer: Some(&self.completer),
            guides: self.guides.as_ref().map(Guides::Files),
            protocol: self.protocol,
            points: self.points.clone(),
            hold_out: None,
            noise: self.noise,
            seeds: self.context.seeds.clone(),
            rules: self.context.rules,
            uncertainty: self.uncertainty,
            sigma_cut: None,
            limit: self.context.limit,
        }
    }

    fn heading(&self, evaluation: &Evaluation<'_>) -> Result<Heading> {
        let weights = format!("{}; {}", self.weights, self.completer.fit_config());
        let inputs = json!({ "weights": self.weights });
        evaluation.heading(&self.dataset, &self.protocol_name, Some(weights), inputs)
    }

    fn journal(&self, heading: &Heading) -> Result<Journal> {
        let path = self.context.trial(&self.name, "jsonl");
        Journal::open(&path, heading, &self.context.place)
    }

    fn resume(&self, progress: &mut Progress<'_>) -> Result<EvaluationReport> {
        let evaluation = self.evaluation();
        let heading = self.heading(&evaluation)?;
        let journal = self.journal(&heading)?;
        evaluation.run(heading, Shard::WHOLE, journal, |done, total| {
            progress(done as f64 / total.max(1) as f64)
        })
    }

    /// Returns the report of the evaluation.
    pub(super) fn report(&self) -> Result<EvaluationReport> {
        self.resume(&mut |_| ControlFlow::Continue(()))
    }

    /// Returns each method's name and mean scores.
    pub(super) fn means(&self) -> Result<Vec<(String, Scores)>> {
        let report = self.report()?;
        let means = report.means(None).into_iter();
        Ok(means.map(|m| (m.method.to_owned(), m.mean)).collect())
    }

    /// Returns the mean scores of the first method.
    pub(super) fn first_scores(&self) -> Result<Scores> {
        let means = self.means()?;
        means
            .first()
            .map(|(_, scores)| *scores)
            .ok_or_else(|| Error::config(format!("`{}` has measured nothing", self.name)))
    }

    /// Returns the frame with the first method's median RMSE.
    pub(super) fn median_frame(&self) -> Result<Option<(String, u64)>> {
        let report = self.report()?;
        let remarkable = report.example_frames();
        let frame = remarkable
            .iter()
            .find(|(role, ..)| *role == "median")
            .or(remarkable.first());
        Ok(frame.map(|(_, frame, seed)| ((*frame).to_owned(), *seed)))
    }

    /// Adds a picture of the frame with the median RMSE.
    pub(super) fn show(&self, section: &mut Section, caption: &str) -> Result<()> {
        self.show_named(section, "frame", caption)
    }

    /// Adds this picture under another name.
    pub(super) fn show_named(
        &self,
        section: &mut Section,
        name: &str,
        caption: &str,
    ) -> Result<()> {
        if let Some((frame, seed)) = self.median_frame()? {
            let exhibit = self.exhibit(&frame, seed)?;
            section.add_figure(name, caption, Panels::of_example(&exhibit).draw());
        }
        Ok(())
    }

    /// Returns a frame with all predictions.
    pub(super) fn exhibit(&self, frame: &str, seed: u64) -> Result<ExampleFrame> {
        self.evaluation().example("median", frame, seed)
    }
}

impl Trial for Measured<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn stored(&self) -> Result<usize> {
        let heading = self.heading(&self.evaluation())?;
        Ok(self.journal(&heading)?.len())
    }

    fn run(&self, progress: &mut Progress<'_>) -> Result<()> {
        self.resume(progress).map(|_| ())
    }

    fn failures(&self) -> Result<Vec<Failure>> {
        Ok(self.report()?.failures().to_vec())
    }
}

/// A network that is trained and then evaluated.
pub(super) struct TrainedNetwork<'a> {
    context: &'a ExperimentContext,
    name: String,
    pub(super) network: NetworkConfig,
    frames: Arc<dyn Dataset>,
}

/// Number of evaluations on held-out frames during training, evenly spaced.
pub(super) const EPOCHS: usize = 8;

/// Approximate time of evaluating a frame, relative to a training step.
const FRAME: f64 = 0.2;

impl<'a> TrainedNetwork<'a> {
    pub(super) fn new(
        context: &'a ExperimentContext,
        name: impl Into<String>,
        network: NetworkConfig,
        frames: Arc<dyn Dataset>,
    ) -> Self {
        Self {
            context,
            name: name.into(),
            network,
            frames,
        }
    }

    /// Returns the folder of the run.
    pub(super) fn folder(&self) -> PathBuf {
        self.context.runs().join(&self.name)
    }

    fn weights(&self) -> PathBuf {
        self.folder().join("weights.safetensors")
    }

    fn train(&self, progress: &mut dyn FnMut(usize) -> ControlFlow<()>) -> Result<RunOutcome> {
        let trainer = Trainer::new(
            &self.folder(),
            self.network.clone(),
            self.context.recipe.fit,
            self.config(),
            self.frames.clone(),
            std::slice::from_ref(&self.context.device.0),
        )?;
        train(&trainer, progress)
    }

    fn config(&self) -> TrainConfig {
        let train = &self.context.recipe.train;
        TrainConfig {
            measure_every: train.steps.div_ceil(EPOCHS),
            // The plain fit: no prior over weights is learned.
            calibrate: false,
            ..train.clone()
        }
    }

    /// Rejects resuming or evaluating a training with other settings.
    fn check_recipe(&self) -> Result<()> {
        let folder = self.folder();
        let config = self.config();
        let start = config.start.as_deref();
        let start = start.map(|path| weights_hash(Some(path))).transpose()?;
        let fit = &self.context.recipe.fit;
        let recipe = json!({
            "numerics": provenance::numerics(),
            "network": self.network,
            "fit": fit,
            // Start weights are identified by their contents, independent of their location.
            "training": TrainConfig { start: None, ..config },
            "start": start,
            "frames": lsdc_eval::data::frames_record(&*self.frames),
            "place": self.context.place,
        });
        check_or_write_recipe(&folder, &recipe)
    }

    /// Returns whether the trained weights exist.
    pub(super) fn is_trained(&self) -> bool {
        self.weights().exists()
    }

    /// Evaluates the trained network on the context's frames.
    pub(super) fn measured(&self) -> Result<Measured<'a>> {
        self.measured_as(&self.name)
    }

    /// Evaluates the trained network under another name.
    pub(super) fn measured_as(&self, name: &str) -> Result<Measured<'a>> {
        let weights = self.weights();
        let completer = open_completer(Some(&weights), &self.context.device.0)?;
        let label = format!("trained, {}", weights_hash(Some(&weights))?);
        Ok(Measured::new(self.context, name).completer(completer, label))
    }
}

/// Trains until all steps are complete, or `progress`, which receives their number, stops the training.
pub(super) fn train<S: Subject>(
    trainer: &Trainer<S>,
    progress: &mut dyn FnMut(usize) -> ControlFlow<()>,
) -> Result<RunOutcome> {
    let stop = AtomicBool::new(false);
    trainer.run(&stop, |event| {
        if let TrainingEvent::Step { step, .. } = event
            && progress(*step).is_break()
        {
            stop.store(true, Ordering::Relaxed);
        }
    })
}

/// Writes the recipe of a training to its folder; rejects a folder with another recipe.
pub(super) fn check_or_write_recipe(folder: &Path, recipe: &Value) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
    let path = folder.join("recipe.json");
    match std::fs::read_to_string(&path) {
        Ok(there) => {
            // Numbers are compared after a round trip.
            let read = |text: &str| serde_json::from_str(text).unwrap_or_default();
            let differences = differences(&read(&there), &read(&recipe.to_string()));
            match differences.first() {
                None => Ok(()),
                Some(first) => Err(Error::config(format!(
                    "`{}` belongs to a training by other settings: {first}",
                    path.display()
                ))
                .hint("choose another folder, or give --force to begin anew")),
            }
        }
        Err(_) => write_atomically(&path, |out| write!(out, "{recipe}")),
    }
}

impl Trial for TrainedNetwork<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn stored(&self) -> Result<usize> {
        if !self.weights().exists() {
            return Ok(0);
        }
        self.check_recipe()?;
        Ok(1 + self.measured()?.stored()?)
    }

    fn run(&self, progress: &mut Progress<'_>) -> Result<()> {
        let steps = self.context.recipe.train.steps as f64;
        let frames = self
            .context
            .frames
            .len()
            .min(self.context.limit.unwrap_or(usize::MAX));
        let measuring = FRAME * frames as f64;
        self.check_recipe()?;
        if !self.weights().exists() {
            let mut share = |step: usize| progress(step as f64 / (steps + measuring));
            if let RunOutcome::Stopped(_) = self.train(&mut share)? {
                return Ok(());
            }
        }
        self.measured()?
            .run(&mut |share| progress((steps + measuring * share) / (steps + measuring)))
    }

    fn failures(&self) -> Result<Vec<Failure>> {
        self.measured()?.failures()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiment::tests::context;

    #[test]
    fn weights_to_start_from_are_told_apart_by_their_contents() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("start"), b"one").unwrap();
        std::fs::write(at("copy"), b"one").unwrap();
        let kept = |start: &str| {
            let mut context = context(folder.path());
            context.recipe.train.start = Some(at(start));
            let frames = (context.recipe.frames)().unwrap();
            let network = context.recipe.network.clone();
            TrainedNetwork::new(&context, "a", network, frames).check_recipe()
        };
        kept("start").unwrap();
        kept("copy").unwrap();
        std::fs::write(at("start"), b"two").unwrap();
        let error = kept("start").unwrap_err();
        assert!(error.to_string().contains("start: "), "{error}");
    }
}
