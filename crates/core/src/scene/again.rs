//! Other fits to the same image, for which the network does not run again.

use super::{Inner, Scene};
use crate::completer::Completer;
use crate::depth_guide::DepthGuide;
use crate::error::Result;
use crate::fit::{Affinities, FitConfig, Robust};
use std::sync::{Arc, Mutex, OnceLock};

impl Scene {
    /// The same scene with other settings of robustness, or none: the network does not run again.
    ///
    /// # Errors
    /// Settings that are out of range.
    ///
    /// ```
    /// # #[cfg(feature = "weights")]
    /// # fn main() -> lsdc_core::Result<()> {
    /// # use lsdc_core::settings::{Loss, Robust};
    /// # use lsdc_core::{Channels, Completer, Image, Observations, Weights};
    /// # let completer = Completer::new(&Weights::builtin_small())?;
    /// # let grey = vec![128_u8; 3 * 64 * 48];
    /// let scene = completer.scene(&Image::new(64, 48, Channels::Rgb, &grey)?)?;
    /// let mut points = Observations::new();
    /// for i in 0..50 {
    ///     let (u, v) = (37 * i % 64, 29 * i % 48);
    ///     let depth = 2.0 + u as f32 / 64.0;
    ///     points.add(f64::from(u), f64::from(v), if i == 7 { 6.0 } else { depth });
    /// }
    /// let robust = scene.with_robust(Some(Robust::new(Loss::Auto)))?;
    /// assert!(robust.complete(&points)?.point_weights()[7] < 0.1);
    /// assert_eq!(scene.complete(&points)?.point_weights()[7], 1.0);
    /// # Ok(())
    /// # }
    /// # #[cfg(not(feature = "weights"))]
    /// # fn main() {}
    /// ```
    pub fn with_robust(&self, robust: Option<Robust>) -> Result<Self> {
        let completer = &self.0.completer;
        let fit = FitConfig {
            robust,
            ..*completer.fit_config()
        };
        fit.check()?;
        let (guide, tied) = (self.0.depth_guide.clone(), self.0.tied.clone());
        Ok(self.share(completer.with_fit(fit), guide, tied))
    }

    /// The same scene with another prediction of its depth by other means, or none (see
    /// [`Completer::guided_scene`]): the network does not run again.
    #[must_use]
    pub fn with_guide(&self, guide: Option<&DepthGuide>) -> Self {
        self.share(self.0.completer.clone(), guide.cloned(), OnceLock::new())
    }

    /// The network's output of this scene, for other fits to the same image.
    fn share(
        &self,
        completer: Completer,
        depth_guide: Option<DepthGuide>,
        tied: OnceLock<Affinities>,
    ) -> Self {
        let Inner {
            basis,
            affinities,
            cosines,
            size,
            guide,
            network,
            ..
        } = &*self.0;
        Self(Arc::new(Inner {
            completer,
            basis: basis.clone(),
            affinities: affinities.clone(),
            tied,
            depth_guide,
            cosines: cosines.clone(),
            size: *size,
            guide: guide.clone(),
            combined: Mutex::default(),
            network: *network,
        }))
    }
}
