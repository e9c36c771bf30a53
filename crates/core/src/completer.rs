//! A trained network with the settings of the fit, ready to complete images.

use crate::ensemble::Quality;
use crate::error::{Result, SettingsError, WeightsError};
use crate::fit::{ErrorModel, FitConfig, NoisePrior, Prior};
use crate::network::{ColourAffinity, CpuNetwork, DepthHead, Encoder, EncoderSide, Network};
use crate::weights::{Calibration, Normalisation, Weights};
use lsdc_kernels::simd::Level;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::Arc;

/// A trained network with the settings of the fit: the entry point to depth completion.
///
/// Cheap to clone, and can be shared between threads. A completer turns an image into a [`Scene`](crate::Scene); a scene
/// completes any number of sets of points without running the network again.
///
/// ```
/// # #[cfg(feature = "weights")]
/// # fn main() -> lsdc_core::Result<()> {
/// use lsdc_core::{Channels, Completer, Image, Observations, Weights};
///
/// let completer = Completer::new(&Weights::builtin_small())?;
/// let (width, height) = (64, 48);
/// let grey = vec![128_u8; 3 * width * height];
/// let scene = completer.scene(&Image::new(width, height, Channels::Rgb, &grey)?)?;
///
/// // Two pixels whose depths are known, in metres.
/// let mut points = Observations::new();
/// points.add(10.0, 20.0, 2.0);
/// points.add(50.0, 30.5, 2.5);
/// let completion = scene.complete(&points)?;
/// let depth = completion.depth()?;
/// assert_eq!((depth.width(), depth.height()), (width, height));
/// assert!((depth.at(10, 20) - 2.0).abs() < 0.2);
/// # Ok(())
/// # }
/// # #[cfg(not(feature = "weights"))]
/// # fn main() {}
/// ```
#[derive(Clone)]
pub struct Completer {
    network: Arc<dyn Network>,
    head: HeadPlace,
    normalisation: Normalisation,
    fit: FitConfig,
    prior: Option<Arc<Prior>>,
    /// Calibration factor from the standard deviations of the fit to those of the errors, used without a distribution of
    /// errors.
    deviation: f64,
    /// The distribution of the errors of the joint fit.
    errors: Option<ErrorModel>,
    quality: Quality,
    pool: Option<Arc<ThreadPool>>,
}

/// Where the depth head of the network's encoder runs, whose prediction guides scenes without another guide.
#[derive(Clone)]
pub(crate) enum HeadPlace {
    /// Nowhere: there is none, or it is not used.
    Nowhere,
    /// On the device of the network, which returns its prediction.
    Device,
    /// On the CPU, from the features that the network returns.
    Cpu(Arc<DepthHead>),
}

/// Starts a thread pool, with one thread per core if `threads` is 0.
///
/// # Errors
/// More than 4096 threads; threads that cannot be started.
#[doc(hidden)]
pub fn thread_pool(threads: usize) -> Result<Arc<ThreadPool>> {
    const MOST: usize = 4096;
    if threads > MOST {
        let what = format!("a pool has at most {MOST} threads, not {threads}");
        return Err(SettingsError::new(what).into());
    }
    let pool = ThreadPoolBuilder::new().num_threads(threads);
    let pool = pool.thread_name(|i| format!("lsdc-{i}")).build();
    let failed = |error| SettingsError::new(format!("no pool of {threads} threads: {error}"));
    Ok(Arc::new(pool.map_err(failed)?))
}

/// Builder of a [`Completer`].
///
/// ```
/// # #[cfg(feature = "weights")]
/// # fn main() -> lsdc_core::Result<()> {
/// use lsdc_core::settings::{FitConfig, Loss, Robust};
/// use lsdc_core::{Completer, Weights};
///
/// let weights = Weights::builtin_small();
/// let recorded = weights.fit()?.unwrap_or_default();
/// let completer = Completer::builder(&weights)
///     .fit(FitConfig { robust: Some(Robust::new(Loss::Cauchy)), ..recorded })
///     .threads(2)
///     .build()?;
/// assert_eq!(completer.fit_config().robust.map(|robust| robust.loss), Some(Loss::Cauchy));
/// # Ok(())
/// # }
/// # #[cfg(not(feature = "weights"))]
/// # fn main() {}
/// ```
#[derive(Clone, Debug)]
#[must_use]
pub struct CompleterBuilder<'a> {
    weights: &'a Weights,
    encoder: Option<Arc<Encoder>>,
    network: Option<Arc<dyn Network>>,
    fit: Option<FitConfig>,
    working_size: Option<(usize, usize)>,
    pool: Option<Arc<ThreadPool>>,
    threads: Option<usize>,
}

impl<'a> CompleterBuilder<'a> {
    /// Uses these settings of the fit instead of those stored with the weights.
    pub fn fit(mut self, fit: FitConfig) -> Self {
        self.fit = Some(fit);
        self
    }

    /// Resizes images to about as many pixels as this height and width have, keeping their aspect ratio, before they enter the
    /// network, instead of to the size of the training images. More pixels take more time and resolve more edges.
    pub fn working_size(mut self, height: usize, width: usize) -> Self {
        self.working_size = Some((height, width));
        self
    }

    /// Uses a separate thread pool, with one thread per core if `threads` is 0. By default, work runs on the caller's pool: the
    /// global one of `rayon`, or the one in which the call was installed.
    pub fn threads(mut self, threads: usize) -> Self {
        self.threads = Some(threads);
        self.pool = None;
        self
    }

    /// Uses a shared thread pool.
    pub fn thread_pool(mut self, pool: Arc<ThreadPool>) -> Self {
        self.pool = Some(pool);
        self.threads = None;
        self
    }

    /// Sets the pretrained encoder that the network was trained with, if any.
    #[doc(hidden)]
    pub fn encoder(mut self, encoder: Arc<Encoder>) -> Self {
        self.encoder = Some(encoder);
        self
    }

    /// Uses another implementation of the network, for example on another device.
    #[doc(hidden)]
    pub fn network(mut self, network: Arc<dyn Network>) -> Self {
        self.network = Some(network);
        self
    }

    /// Builds the completer.
    ///
    /// # Errors
    /// Weights that do not match their network, settings that are out of range, threads that cannot be started, or an
    /// environment variable `LSDC_SIMD` that names an instruction set that this processor does not have.
    pub fn build(self) -> Result<Completer> {
        let level = Level::selected()
            .map_err(|error| SettingsError::new(error.to_string()).with_hint(error.hint()))?;
        let pool = match (self.pool, self.threads) {
            (Some(pool), _) => Some(pool),
            (None, None) => None,
            (None, Some(threads)) => Some(thread_pool(threads)?),
        };
        let weights: &'a Weights = self.weights;
        let encoder = self.encoder;
        let prepare = || {
            let tensors = &weights.tensors;
            CpuNetwork::new(&weights.network, tensors, encoder, level)
        };
        let network: Arc<dyn Network> = match (self.network, &pool) {
            (Some(network), _) => network,
            // Workspaces are allocated per thread of the pool.
            (None, Some(pool)) => Arc::new(pool.install(prepare)?),
            (None, None) => Arc::new(prepare()?),
        };
        let (prior, deviation, errors) = match weights.prior()? {
            None => (None, 1.0, None),
            Some((prior, calibration)) => {
                let Calibration {
                    deviation, errors, ..
                } = calibration;
                (Some(Arc::new(prior)), deviation, errors)
            }
        };
        let mut normalisation = weights.normalisation;
        if let Some((height, width)) = self.working_size {
            normalisation.input = [height, width];
        }
        normalisation.check()?;
        let fit = match self.fit {
            Some(fit) => fit,
            None => weights.fit()?.unwrap_or_default(),
        };
        fit.check()?;
        Ok(Completer {
            head: if network.has_depth_head() {
                HeadPlace::Device
            } else {
                HeadPlace::Nowhere
            },
            network,
            normalisation,
            fit,
            prior,
            deviation,
            errors,
            quality: Quality::default(),
            pool,
        })
    }
}

impl std::fmt::Debug for Completer {
    /// Omits the weights, of which there are millions.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Completer")
            .field("fit", &self.fit)
            .field("normalisation", &self.normalisation)
            .finish_non_exhaustive()
    }
}

impl Completer {
    /// A completer with the settings stored with the weights.
    ///
    /// # Errors
    /// Weights that do not match their network.
    pub fn new(weights: &Weights) -> Result<Self> {
        Self::builder(weights).build()
    }

    /// A completer without a network, for scenes with a [guide](crate::DepthGuide): depth is a constant, the guide, and a field
    /// whose affinities follow from the colours of the image.
    ///
    /// # Errors
    /// Settings that are out of range.
    ///
    /// ```
    /// use lsdc_core::settings::{FitConfig, FitMethod, PriorKind};
    /// use lsdc_core::{Channels, Completer, DepthGuide, GuideKind, Image, Observations};
    ///
    /// # fn main() -> lsdc_core::Result<()> {
    /// let fit = FitConfig { method: FitMethod::Joint, prior: PriorKind::Learned, ..FitConfig::default() };
    /// let completer = Completer::without_network(fit)?;
    /// # let grey = vec![128_u8; 3 * 64 * 48];
    /// # let image = Image::new(64, 48, Channels::Rgb, &grey)?;
    /// let ramp: Vec<f32> = (0..64 * 48).map(|i| 1.0 + (i % 64) as f32).collect();
    /// let guide = DepthGuide::new(GuideKind::Depth, 64, 48, &ramp)?;
    /// let mut points = Observations::new();
    /// for i in 0..30 {
    ///     let (u, v) = (37 * i % 64, 29 * i % 48);
    ///     points.add(f64::from(u), f64::from(v), 1.0 + u as f32 / 32.0);
    /// }
    /// let depth = completer.guided_scene(&image, &guide)?.complete(&points)?.depth()?;
    /// assert!((depth.at(31, 24) - 1.969).abs() < 0.1);
    /// # Ok(())
    /// # }
    /// ```
    pub fn without_network(fit: FitConfig) -> Result<Self> {
        fit.check()?;
        let unknown = NoisePrior {
            mean: 0.0,
            deviation: None,
            equivalent_points: 0.0,
        };
        Ok(Self {
            network: Arc::new(ColourAffinity),
            head: HeadPlace::Nowhere,
            normalisation: Normalisation::default(),
            fit,
            prior: Some(Arc::new(Prior::new(&[1.0], &[0.0], unknown)?)),
            deviation: 1.0,
            errors: None,
            quality: Quality::default(),
            pool: None,
        })
    }

    /// A builder for a completer with other settings.
    pub fn builder(weights: &Weights) -> CompleterBuilder<'_> {
        CompleterBuilder {
            weights,
            encoder: None,
            network: None,
            fit: None,
            working_size: None,
            pool: None,
            threads: None,
        }
    }

    /// The settings of the fit.
    pub fn fit_config(&self) -> &FitConfig {
        &self.fit
    }

    /// The same completer with other settings of the fit, which are checked when a scene is made; the network
    /// is shared.
    #[must_use]
    pub fn with_fit(&self, fit: FitConfig) -> Self {
        Self {
            fit,
            ..self.clone()
        }
    }

    /// The same completer with another working size (see [`CompleterBuilder::working_size`]).
    ///
    /// # Errors
    /// An implausible size.
    pub fn with_working_size(&self, height: usize, width: usize) -> Result<Self> {
        let normalisation = Normalisation {
            input: [height, width],
            ..self.normalisation
        };
        normalisation.check()?;
        Ok(Self {
            normalisation,
            ..self.clone()
        })
    }

    /// The same completer with scenes of another quality, which is [`Quality::Standard`] otherwise.
    ///
    /// Without a network, the mirror image has the mirrored depths, up to rounding and ties: [`Quality::Best`] then doubles the
    /// run time without benefit.
    ///
    /// ```
    /// # #[cfg(feature = "weights")]
    /// # fn main() -> lsdc_core::Result<()> {
    /// # use lsdc_core::{Channels, Completer, Image, Observations, Quality, Weights};
    /// # let completer = Completer::new(&Weights::builtin_small())?;
    /// # let rgb: Vec<u8> = (0..3 * 64 * 48).map(|i| (i / 7 % 251) as u8).collect();
    /// # let image = Image::new(64, 48, Channels::Rgb, &rgb)?;
    /// # let mut points = Observations::new();
    /// # (0..30).for_each(|i| points.add(f64::from(37 * i % 64), f64::from(29 * i % 48), 2.0));
    /// let scene = completer.with_quality(Quality::Best).scene(&image)?;
    /// let depth = scene.complete(&points)?.depth()?;
    /// # assert!((depth.at(31, 24) - 2.0).abs() < 0.2);
    /// # Ok(())
    /// # }
    /// # #[cfg(not(feature = "weights"))]
    /// # fn main() {}
    /// ```
    #[must_use]
    pub fn with_quality(&self, quality: Quality) -> Self {
        Self {
            quality,
            ..self.clone()
        }
    }

    /// The same completer whose pretrained encoder reads images of another size: of as many pixels as one of 4:3 with this
    /// shorter side, 252 to 518 pixels. It is 336 otherwise, as in training. Larger images take more time and resolve smaller
    /// things, mainly outdoors; standard deviations are calibrated for 336.
    ///
    /// # Errors
    /// A side out of range, or a network without an encoder or on a device without a choice.
    pub fn with_encoder_side(&self, side: usize) -> Result<Self> {
        let network = self.network.with_encoder_side(EncoderSide::new(side)?);
        let network = network.ok_or_else(|| {
            let what = "the network has no encoder whose images could have another size";
            SettingsError::new(what.to_owned()).with_hint("the weights `anything` have one")
        })?;
        Ok(Self {
            network,
            ..self.clone()
        })
    }

    /// The same completer, with scenes guided by the prediction of a depth head unless another guide is given. The head reads
    /// the features that the network computes with its encoder, so the encoder does not run a second time. An image for which
    /// the head predicts a constant, such as an image of one colour, has no guide.
    ///
    /// # Errors
    /// The network has no encoder, or not the one that the head was made for.
    #[doc(hidden)]
    pub fn with_depth_head(&self, head: Arc<DepthHead>) -> Result<Self> {
        let encoder = self.network.published_encoder().ok_or_else(|| {
            let what = "a depth head for a network without the encoder it was published with";
            WeightsError::Unsupported(what)
        })?;
        head.check(encoder)?;
        Ok(Self {
            head: HeadPlace::Cpu(head),
            ..self.clone()
        })
    }

    /// The same completer without a depth head: scenes have only the guides that are given.
    #[must_use]
    pub fn without_depth_head(&self) -> Self {
        Self {
            head: HeadPlace::Nowhere,
            ..self.clone()
        }
    }

    /// Whether scenes without another guide are guided by the depth head of the network's encoder.
    pub fn has_depth_head(&self) -> bool {
        !matches!(self.head, HeadPlace::Nowhere)
    }

    /// Whether the network returns the features of an unmodified published encoder, for [`Self::with_depth_head`].
    #[doc(hidden)]
    pub fn can_have_depth_head(&self) -> bool {
        self.network.published_encoder().is_some()
    }

    /// The quality of scenes.
    pub fn quality(&self) -> Quality {
        self.quality
    }

    /// The same completer with another prior over the weights and uncalibrated standard deviations.
    #[doc(hidden)]
    #[must_use]
    pub fn with_prior(&self, prior: Prior) -> Self {
        Self {
            prior: Some(Arc::new(prior)),
            deviation: 1.0,
            errors: None,
            ..self.clone()
        }
    }

    /// Frees cached memory: that of the network, and the workspaces of fits, which all completers of the process share (up to a
    /// gigabyte after large images). Call it after the last completion is dropped; later completions allocate again.
    pub fn release(&self) {
        self.network.release();
        if let HeadPlace::Cpu(head) = &self.head {
            head.release();
        }
        crate::field::release();
    }

    pub(crate) fn network(&self) -> &dyn Network {
        &*self.network
    }

    pub(crate) fn head(&self) -> &HeadPlace {
        &self.head
    }

    pub(crate) fn normalisation(&self) -> &Normalisation {
        &self.normalisation
    }

    pub(crate) fn prior(&self) -> Option<&Prior> {
        self.prior.as_deref()
    }

    pub(crate) fn deviation(&self) -> f64 {
        self.deviation
    }

    /// The distribution of the errors of the joint fit, if it is known.
    pub(crate) fn errors(&self) -> Option<&ErrorModel> {
        self.errors.as_ref()
    }

    /// Runs `work` on the pool of this completer.
    pub(crate) fn run<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match &self.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
}
