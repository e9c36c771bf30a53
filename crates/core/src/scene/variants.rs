//! Scenes of the same image with other settings, for which the network does not run again.

use super::{Inner, Scene, predicted_guide};
use crate::completer::Completer;
use crate::depth_guide::DepthGuide;
use crate::ensemble::Quality;
use crate::error::{Result, SettingsError};
use crate::fit::{Affinities, CosineBasis, FitConfig, FitMethod, Robust};
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
        self.with_fit(FitConfig {
            robust,
            ..*self.0.completer.fit_config()
        })
    }

    /// The same scene with other settings of the fit, without running the network again. Completions are bitwise equal to those
    /// of a scene that was made with these settings.
    ///
    /// # Errors
    /// Settings that are out of range; a field in a scene that was made for basis functions alone.
    ///
    /// ```
    /// # #[cfg(feature = "weights")]
    /// # fn main() -> lsdc_core::Result<()> {
    /// # use lsdc_core::settings::{FitConfig, FitMethod};
    /// # use lsdc_core::{Channels, Completer, Image, Observations, Weights};
    /// # let completer = Completer::new(&Weights::builtin_small())?;
    /// # let grey = vec![128_u8; 3 * 64 * 48];
    /// let scene = completer.scene(&Image::new(64, 48, Channels::Rgb, &grey)?)?;
    /// let plain = FitConfig { method: FitMethod::Lse, ..*completer.fit_config() };
    /// # let mut points = Observations::new();
    /// # points.add(10.0, 20.0, 2.0);
    /// let alone = scene.with_fit(plain)?.complete(&points)?;
    /// assert_eq!(alone.report().method, FitMethod::Lse);
    /// # Ok(())
    /// # }
    /// # #[cfg(not(feature = "weights"))]
    /// # fn main() {}
    /// ```
    pub fn with_fit(&self, fit: FitConfig) -> Result<Self> {
        fit.check()?;
        let inner = &*self.0;
        let before = inner.completer.fit_config().method;
        // Only a fit with a field keeps the interpolation of depth in a larger image.
        if fit.method.has_field() && !before.has_field() {
            let what = "this scene was made for basis functions alone, without a field";
            return Err(SettingsError::new(what)
                .with_hint("make the scene with the settings of the joint fit")
                .into());
        }
        let same = fit.method == before;
        let guided_affinities = if same {
            inner.guided_affinities.clone()
        } else {
            OnceLock::new()
        };
        let mirror = inner.mirror.as_ref();
        let mirror = mirror.map(|mirror| mirror.with_fit(fit)).transpose()?;
        let completer = inner.completer.with_fit(fit);
        let mut depth_guide = inner.depth_guide.clone();
        // No guide was predicted for a field alone, which uses none.
        if depth_guide.is_none() && before == FitMethod::Field && !same {
            let predict = || predicted_guide(&completer, &*inner.forward);
            depth_guide = completer.run(predict)?;
        }
        Ok(self.with_settings(completer, depth_guide, guided_affinities, mirror))
    }

    /// The same scene with another dense prediction of its depth by other means, or with none (see
    /// [`Completer::guided_scene`]), not even that of a [depth head](Completer::has_depth_head). The network does not run
    /// again.
    #[must_use]
    pub fn with_guide(&self, guide: Option<&DepthGuide>) -> Self {
        let completer = match guide {
            None => self.0.completer.without_depth_head(),
            Some(_) => self.0.completer.clone(),
        };
        let mirror = self.0.mirror.as_ref();
        let mirror = mirror.map(|mirror| {
            let guide = guide.map(DepthGuide::mirrored);
            mirror.with_guide(guide.as_ref())
        });
        self.with_settings(completer, guide.cloned(), OnceLock::new(), mirror)
    }

    /// Returns the same scene at [`Quality::Standard`]: completions are single fits.
    pub(crate) fn without_mirror(&self) -> Self {
        let inner = &*self.0;
        self.with_settings(
            inner.completer.with_quality(Quality::Standard),
            inner.depth_guide.clone(),
            inner.guided_affinities.clone(),
            None,
        )
    }

    /// Returns a scene with the network's output of this one, for other fits to the same image.
    fn with_settings(
        &self,
        completer: Completer,
        depth_guide: Option<DepthGuide>,
        guided_affinities: OnceLock<Affinities>,
        mirror: Option<Self>,
    ) -> Self {
        let Inner {
            forward,
            basis,
            affinities,
            size,
            upsampling,
            network,
            ..
        } = &*self.0;
        let fit = completer.fit_config();
        let cosines = CosineBasis::up_to(fit.cosines());
        let upsampling = upsampling.clone().filter(|_| fit.method.has_field());
        Self(Arc::new(Inner {
            completer,
            forward: forward.clone(),
            basis: basis.clone(),
            affinities: affinities.clone(),
            guided_affinities,
            depth_guide,
            cosines,
            size: *size,
            upsampling,
            combined: Mutex::default(),
            mirror,
            network: *network,
        }))
    }
}
