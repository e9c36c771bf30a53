//! Training of a system by the experiment, with its budget.

use crate::experiment::trial::{Progress, Trial, check_or_write_recipe, train};
use crate::experiment::{ExperimentContext, SystemRecipe};
use crate::systems::{Predictor, trainer};
use lsdc_eval::data::Dataset;
use lsdc_files::error::Result;
use lsdc_train::training::{RunOutcome, TrainConfig};
use lsdc_weights::TRAINING_NOTE;
use lsdc_weights::provenance;
use serde::Deserialize;
use serde_json::json;
use std::fmt::{Display, Formatter};
use std::path::PathBuf;
use std::sync::Arc;

/// The budget of a training.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct Budget {
    steps: usize,
    batch: usize,
}

impl Budget {
    pub(super) fn of(train: &TrainConfig) -> Self {
        Self {
            steps: train.steps,
            batch: train.batch,
        }
    }

    /// Reads the budget from the notes of given weights, if they have one.
    pub(super) fn noted_in(predictor: &Predictor) -> Option<Self> {
        let note = predictor.trained().notes.get(TRAINING_NOTE)?;
        serde_json::from_str(note).ok()
    }
}

impl Display for Budget {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} steps of {} images", self.steps, self.batch)
    }
}

/// A system trained by the experiment.
pub(super) struct TrainedSystem<'a> {
    context: &'a ExperimentContext,
    pub(super) recipe: &'a SystemRecipe,
    name: String,
    frames: Arc<dyn Dataset>,
}

impl<'a> TrainedSystem<'a> {
    pub(super) fn new(
        context: &'a ExperimentContext,
        recipe: &'a SystemRecipe,
        frames: Arc<dyn Dataset>,
    ) -> Self {
        Self {
            context,
            recipe,
            name: format!("systems-{}", recipe.name),
            frames,
        }
    }

    pub(super) fn budget(&self) -> Budget {
        Budget::of(&self.recipe.train)
    }

    /// Returns the predictor; `None` before its weights exist.
    pub(super) fn predictor(&self) -> Result<Option<Predictor>> {
        let weights = self.weights();
        if !weights.exists() {
            return Ok(None);
        }
        Predictor::open(&weights, &self.context.device.0).map(Some)
    }

    fn folder(&self) -> PathBuf {
        self.context.runs().join(&self.name)
    }

    fn weights(&self) -> PathBuf {
        self.folder().join("weights.safetensors")
    }

    fn check_recipe(&self) -> Result<()> {
        check_or_write_recipe(
            &self.folder(),
            &json!({
                "numerics": provenance::numerics(),
                "system": self.recipe.system,
                "training": self.recipe.train,
                "frames": lsdc_eval::data::frames_record(&*self.frames),
                "place": self.context.place,
            }),
        )
    }
}

impl Trial for TrainedSystem<'_> {
    fn name(&self) -> &str {
        &self.name
    }

    fn stored(&self) -> Result<usize> {
        if !self.weights().exists() {
            return Ok(0);
        }
        self.check_recipe().map(|()| 1)
    }

    fn run(&self, progress: &mut Progress<'_>) -> Result<()> {
        self.check_recipe()?;
        if self.weights().exists() {
            let _ = progress(1.0);
            return Ok(());
        }
        let recipe = self.recipe;
        let steps = recipe.train.steps as f64;
        let trainer = trainer(
            &self.folder(),
            recipe.system.clone(),
            recipe.train.clone(),
            self.frames.clone(),
            std::slice::from_ref(&self.context.device.0),
        )?;
        let outcome = train(&trainer, &mut |step| progress(step as f64 / steps))?;
        if outcome == RunOutcome::Finished {
            let _ = progress(1.0);
        }
        Ok(())
    }
}
