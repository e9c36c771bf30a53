//! The systems that are compared.

use super::training::{Budget, TrainedSystem};
use crate::experiment::trial::TrainedNetwork;
use crate::experiment::{ExperimentContext, published};
use crate::systems::{Predictor, SystemConfig};
use lsdc_files::error::Result;

/// Name of our method.
pub(super) const OURS: &str = "lsdc";
/// Name of our network with the same training as the systems.
pub(super) const SAME_BUDGET: &str = "lsdc, same budget";

/// A system in the comparison.
pub(super) enum ComparedSystem<'a> {
    /// A system with existing weights.
    Given(String, Predictor),
    /// A system trained by the experiment.
    Trained(TrainedSystem<'a>),
}

impl ComparedSystem<'_> {
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Given(name, _) => name,
            Self::Trained(trial) => &trial.recipe.name,
        }
    }

    pub(super) fn config(&self) -> &SystemConfig {
        match self {
            Self::Given(_, predictor) => &predictor.trained().config,
            Self::Trained(trial) => &trial.recipe.system,
        }
    }

    /// Returns the predictor; `None` before its weights exist.
    pub(super) fn predictor(&self) -> Result<Option<Predictor>> {
        match self {
            Self::Given(_, predictor) => Ok(Some(predictor.clone())),
            Self::Trained(trial) => trial.predictor(),
        }
    }

    /// Describes its training.
    pub(super) fn training(&self) -> String {
        match self {
            Self::Trained(trial) => trial.budget().to_string(),
            Self::Given(_, predictor) => match Budget::noted_in(predictor) {
                Some(budget) => format!("given, {budget}"),
                None => "given, trained elsewhere".to_owned(),
            },
        }
    }

    /// Returns its published results.
    pub(super) fn published(&self) -> Option<&'static published::PublishedSystem> {
        let kind = self.config().kind();
        published::SYSTEMS.iter().find(|system| system.kind == kind)
    }
}

/// All systems, and our network with the same training.
pub(super) struct ComparedSystems<'a> {
    pub(super) context: &'a ExperimentContext,
    pub(super) systems: Vec<ComparedSystem<'a>>,
    pub(super) same_budget: Option<TrainedNetwork<'a>>,
}

impl<'a> ComparedSystems<'a> {
    /// Uses the given systems, or those of the recipe, with our network trained alike.
    pub(super) fn new(context: &'a ExperimentContext) -> Result<Self> {
        if !context.systems.is_empty() {
            let given = context.systems.iter().cloned();
            return Ok(Self {
                context,
                systems: given
                    .map(|(name, predictor)| ComparedSystem::Given(name, predictor))
                    .collect(),
                same_budget: None,
            });
        }
        let frames = (context.recipe.frames)()?;
        let recipes = context.recipe.systems.iter();
        let trained = recipes.map(|recipe| TrainedSystem::new(context, recipe, frames.clone()));
        let systems = trained.map(ComparedSystem::Trained).collect();
        let network = context.recipe.network.clone();
        Ok(Self {
            context,
            systems,
            same_budget: Some(TrainedNetwork::new(
                context,
                "systems-lsdc",
                network,
                frames,
            )),
        })
    }

    /// Returns all predictors by name; `None` before all weights exist.
    pub(super) fn predictors(&self) -> Result<Option<Vec<(String, Predictor)>>> {
        if self
            .same_budget
            .as_ref()
            .is_some_and(|same| !same.is_trained())
        {
            return Ok(None);
        }
        let all = self.systems.iter().map(|system| {
            let predictor = system.predictor()?;
            Ok(predictor.map(|predictor| (system.name().to_owned(), predictor)))
        });
        all.collect()
    }
}
