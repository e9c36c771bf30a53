//! Fits to the image of a scene, from observations to a completion.

use super::Scene;
use crate::completion::Completion;
use crate::error::{FitError, Result};
use crate::fit::{BasisValues, EvaluateBasis, FitMethod, PriorKind, fit};
use crate::observations::Observations;
use crate::usable::UsableObservations;
use lsdc_kernels::clock::Instant;

/// Expected closeness of the weights to those of the previous frame, relative to those of an arbitrary image, as a ratio of
/// variances.
const CLOSER: f64 = 10.0;

impl Scene {
    /// Fits the basis functions of the image to observations of its depth.
    ///
    /// Observations outside the image, or whose depth or standard deviation is not between 1e-15 and 1e15, are skipped; the
    /// [report](Completion::report) counts them.
    ///
    /// # Errors
    /// No usable observation, or a damaged network.
    ///
    /// ```
    /// # #[cfg(feature = "weights")]
    /// # fn main() -> lsdc_core::Result<()> {
    /// # use lsdc_core::{Channels, Completer, Image, Observations, Weights};
    /// # let completer = Completer::new(&Weights::builtin_small())?;
    /// # let grey = vec![128_u8; 3 * 64 * 48];
    /// # let scene = completer.scene(&Image::new(64, 48, Channels::Rgb, &grey)?)?;
    /// // A robot that stands still: the points change, the network runs once.
    /// for depth in [2.0, 2.1, 2.2] {
    ///     let mut points = Observations::new();
    ///     points.add(32.0, 24.0, depth);
    ///     points.add(500.0, 24.0, depth);
    ///     let completion = scene.complete(&points)?;
    ///     assert_eq!((completion.report().used, completion.report().outside), (1, 1));
    ///     // One point scales a plausible map.
    ///     assert!((completion.at(&[[32.0, 24.0]])?[0] / depth - 1.0).abs() < 0.05);
    /// }
    /// # Ok(())
    /// # }
    /// # #[cfg(not(feature = "weights"))]
    /// # fn main() {}
    /// ```
    pub fn complete(&self, observations: &Observations) -> Result<Completion> {
        self.complete_with(observations, None, false)
    }

    /// Like [`Self::complete`], if no other fit to the image follows: data that only further fits need is freed, and is
    /// recomputed if one does follow.
    ///
    /// # Errors
    /// As for [`Self::complete`].
    #[doc(hidden)]
    pub fn complete_once(&self, observations: &Observations) -> Result<Completion> {
        self.complete_with(observations, None, true)
    }

    /// Like [`Self::complete`], with a prior centred on the weights of another fit, up to their scale: for the next frame of a
    /// video. `weights` are [those](Completion::weights) of the previous frame, at the same [quality](crate::Quality).
    ///
    /// # Errors
    /// As for [`Self::complete`]; weights files without a prior, or weights of other basis functions.
    pub fn complete_near(
        &self,
        observations: &Observations,
        weights: &[f64],
    ) -> Result<Completion> {
        self.complete_with(observations, Some(weights), false)
    }

    fn complete_with(
        &self,
        observations: &Observations,
        previous_weights: Option<&[f64]>,
        transient: bool,
    ) -> Result<Completion> {
        let started = Instant::now();
        let usable = UsableObservations::new(observations, self.0.size)?;
        self.fitted(usable, previous_weights, transient, started)
    }

    /// Fits usable observations, and their mirror images if there is a scene of the mirror image.
    fn fitted(
        &self,
        usable: UsableObservations,
        previous_weights: Option<&[f64]>,
        transient: bool,
        started: Instant,
    ) -> Result<Completion> {
        let inner = &*self.0;
        let mut config = *inner.completer.fit_config();
        let has_prior = config.prior == PriorKind::Learned && config.method != FitMethod::Field;
        let learned = inner.completer.prior().filter(|_| has_prior);
        if previous_weights.is_some() && learned.is_none() {
            return Err(FitError::NearWithoutPrior.into());
        }
        let (previous_weights, previous_of_mirror) = match (previous_weights, &inner.mirror) {
            (Some(weights), Some(_)) => {
                let count = inner.completer.run(|| inner.count());
                let (expected, found) = (2 * count, weights.len());
                if found != expected {
                    return Err(FitError::OtherWeights { expected, found }.into());
                }
                let (own, mirrored) = weights.split_at(count);
                (Some(own), Some(mirrored))
            }
            (weights, _) => (weights, None),
        };
        let mirror = inner.mirror.as_ref().map(|scene| {
            let mirrored = usable.mirrored(inner.size);
            scene.fitted(mirrored, previous_of_mirror, transient, Instant::now())
        });
        let mirror = mirror.transpose()?;
        let centred_on = previous_weights.zip(learned).map(|(weights, prior)| {
            config.lambda = config.lambda.times(CLOSER);
            prior.centred_on(weights, inner.guides() + inner.cosines.len())
        });
        let centred_on = centred_on.transpose()?;
        let prior = centred_on.as_ref().or(inner.completer.prior());
        // Run on a thread of the pool, to avoid waiting for the pool at each step.
        let found = inner.completer.run(|| {
            rayon::scope(|_| {
                let rows = inner.bases_at_points(&usable, config.robust.is_some());
                let affinities = inner.needed_affinities()?;
                let factorising = Instant::now();
                if let (FitMethod::Joint, Some(affinities)) = (config.method, affinities) {
                    affinities.prior(config.joint.diagonal_regularisation);
                }
                let (field, solving) = (factorising.elapsed(), Instant::now());
                let bases = rows
                    .as_deref()
                    .map_or(BasisValues::Everywhere(inner), |rows| {
                        BasisValues::Both(rows, inner)
                    });
                let points = inner.points(bases, &usable, affinities, transient);
                Ok((fit(&points, &config, prior)?, field, solving.elapsed()))
            })
        });
        let (fit, field, solve) = found.map_err(|error| match error {
            // The reasons for skipped observations are only available here.
            crate::Error::Fit(FitError::NoObservations { .. }) => usable.no_observations().into(),
            other => other,
        })?;
        let times = [inner.network, started.elapsed(), field, solve];
        Ok(Completion::new(
            self.clone(),
            fit,
            usable,
            config.method,
            times,
            mirror,
        ))
    }
}
