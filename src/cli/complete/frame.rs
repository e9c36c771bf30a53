//! The completion of one frame, with its diagnostics.

use super::loaded::Loaded as Frame;
use super::settings::Settings;
use super::views::FrameViews;
use crate::cli::args::{Format, Model};
use crate::cli::network::{
    at_quality, name_of_own_guide, open_guide, open_guided_completer, open_system, own_guide,
};
use crate::process;
use image::RgbImage;
use lsdc_core::fit::{FitConfig, FitMethod, PriorKind};
use lsdc_core::{Completer, Completion, FitError, Outlier, Quality, Scene, ViewsReport};
use lsdc_eval::data::{self, DepthMap, Sparse, Unit};
use lsdc_eval::predict::{
    Classic, DepthCompleter, GuideSpec, Method, MonocularGuide, complete_classic, guided_scene,
};
use lsdc_files::error::{Error, Result};
use lsdc_files::{DeviationLimits, MOST_TESTED, clamped_pixels};
use serde::Serialize;
use std::fmt::Write as _;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Completes frames with the settings of a run.
pub(super) struct Engine<'a> {
    settings: &'a Settings,
    method: Loaded,
    /// The network that predicts guides, if one does.
    monocular: Option<MonocularGuide>,
    /// The depth head that guides scenes without another guide, if one does.
    own_guide: Option<String>,
    /// Whether diagnostics are reported.
    explains: bool,
    counts_outliers: bool,
}

/// Images in flight on a GPU: one being computed, one waiting, and one whose results the CPU reads.
const IMAGES_ON_GPU: usize = 3;

enum Loaded {
    Trained(Box<Completer>),
    Whole(Whole),
}

/// A method that reads image and points together.
#[derive(Clone)]
pub(super) enum Whole {
    /// A method without training.
    Untrained(Classic),
    /// A system that the paper compares itself with.
    System(Arc<dyn DepthCompleter>),
}

impl Whole {
    fn complete(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
        match self {
            Self::Untrained(method) => complete_classic(*method, rgb, sparse),
            Self::System(system) => system.depth(rgb, sparse),
        }
    }
}

/// A frame whose image the network has seen.
pub(super) enum Prepared {
    /// With the time of predicting the guide, if that was done.
    Trained(Scene, Option<Duration>),
    Whole(Whole),
}

/// A frame that is fitted to its points.
pub(super) enum Fitted {
    /// With the same time, and what became of the points of other images.
    Trained(Completion, Option<Duration>, Option<ViewsReport>),
    Whole(Whole),
}

/// A completed frame.
pub(super) struct Completed {
    pub(super) depth: DepthMap,
    /// Number of pixels limited because they are far outside the range of the points.
    pub(super) clamped: usize,
    /// With `--max-sigma` or `--max-relative-sigma`.
    pub(super) left_empty: Option<LeftEmpty>,
    /// The map before, if pixels were left empty.
    filled: Option<DepthMap>,
    pub(super) quality: Quality,
    pub(super) encoder_side: Option<usize>,
    /// The network that predicted the guide, if one did.
    pub(super) guide: Option<String>,
    /// Time of its prediction.
    pub(super) guide_time: Option<Duration>,
    /// With `--views`, the report on the points of other images.
    pub(super) views: Option<ViewsReport>,
    pub(super) diagnostics: Option<Diagnostics>,
}

impl Completed {
    /// The map before pixels were left empty. Flying pixels are detected in it, because an empty pixel is no edge.
    pub(super) fn filled(&self) -> &DepthMap {
        self.filled.as_ref().unwrap_or(&self.depth)
    }

    /// The standard deviations of the depths, if they were computed.
    pub(super) fn deviations(&self) -> Option<&DepthMap> {
        self.diagnostics.as_ref()?.deviations.as_ref()
    }
}

/// Pixels left without depth because their standard deviation is too large.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct LeftEmpty {
    /// Number of pixels.
    pub(super) pixels: usize,
    /// Limit of the standard deviation, in metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) max_sigma: Option<f32>,
    /// Limit of the standard deviation as a share of the depth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) max_relative_sigma: Option<f32>,
}

/// Diagnostics of a fit.
pub(super) struct Diagnostics {
    pub(super) completion: Completion,
    /// Root mean square of the leave-one-out errors.
    pub(super) leave_one_out: Option<f64>,
    /// Points that disagree with the others, worst first.
    pub(super) outliers: Option<Vec<Outlier>>,
    pub(super) deviations: Option<DepthMap>,
    /// Whether the fit limits the influence of outliers.
    pub(super) robust: bool,
    /// The time of reading out the dense depth.
    pub(super) dense: Duration,
}

impl<'a> Engine<'a> {
    /// Ready to work; `told` says whether diagnostics are printed.
    pub(super) fn new(settings: &'a Settings, told: bool) -> Result<Self> {
        let mut own = None;
        let method = match settings.method {
            Method::Classic(method) => Loaded::Whole(Whole::Untrained(method)),
            Method::System(kind) => {
                let Model { weights, device } = &settings.model;
                let system = open_system(kind, weights.as_deref(), device)?;
                Loaded::Whole(Whole::System(Arc::new(system)))
            }
            Method::Lsdc => {
                let Model { weights, device } = &settings.model;
                let guide = settings.guide.as_ref();
                let completer = open_guided_completer(weights.as_deref(), device, guide)?;
                if completer.has_depth_head() {
                    own = own_guide(weights.as_deref(), device, guide)?;
                }
                let fit = settings.fit(completer.fit_config());
                if settings.temporal {
                    check_temporal(&fit)?;
                }
                if guide.is_some_and(|guide| *guide != GuideSpec::None)
                    && fit.method == FitMethod::Field
                {
                    return Err(Error::config(
                        "`--guide` would change nothing: a field alone has no basis functions",
                    )
                    .hint("leave it out, or fit with `--fit joint` or `--fit lse`"));
                }
                let completer = completer.with_fit(fit);
                let completer = at_quality(
                    &completer,
                    settings.quality,
                    settings.encoder_side,
                    weights.as_deref(),
                )?;
                Loaded::Trained(Box::new(completer))
            }
        };
        let monocular = open_guide(settings.guide.as_ref(), &settings.model.device)?;
        let in_files = settings.writes(Format::Json);
        Ok(Self {
            settings,
            method,
            monocular,
            own_guide: own.as_deref().map(name_of_own_guide),
            explains: told || in_files || settings.outliers,
            counts_outliers: in_files || settings.json,
        })
    }

    /// Number of images in flight.
    pub(super) fn images_at_once(&self) -> usize {
        let on_gpu = self.settings.model.device.starts_with("wgpu");
        match self.method {
            Loaded::Trained(_) if on_gpu => IMAGES_ON_GPU,
            _ => 1,
        }
    }

    /// Completes a frame that no other follows.
    pub(super) fn complete(self, frame: &Frame) -> Result<Completed> {
        let prepared = self.prepare(frame)?;
        if let Loaded::Trained(completer) = &self.method {
            completer.release();
        }
        if let Some(monocular) = &self.monocular {
            monocular.release();
        }
        process::give_back_pages();
        let fitted = prepared.fit(&frame.points, None, None)?;
        self.finish(&frame.rgb, &frame.points, fitted)
    }

    /// The first part of completing a frame, which depends on its image and guide alone.
    pub(super) fn prepare(&self, frame: &Frame) -> Result<Prepared> {
        let completer = match &self.method {
            Loaded::Trained(completer) => completer,
            Loaded::Whole(method) => return Ok(Prepared::Whole(method.clone())),
        };
        let rgb = &frame.rgb;
        let started = Instant::now();
        let predicted = self.monocular.as_ref().map(|network| network.predict(rgb));
        let predicted = predicted.transpose()?;
        let guide_time = predicted.is_some().then(|| started.elapsed());
        let guide = predicted.as_ref().or(frame.guide.as_ref());
        let scene = if self.settings.full {
            let (width, height) = (rgb.width() as usize, rgb.height() as usize);
            let completer = completer.with_working_size(height, width)?;
            guided_scene(&completer, rgb, guide)
        } else {
            guided_scene(completer, rgb, guide)
        };
        scene.map(|scene| Prepared::Trained(scene, guide_time))
    }

    /// The last part, for which no other frame waits.
    pub(super) fn finish(
        &self,
        rgb: &RgbImage,
        points: &Sparse,
        fitted: Fitted,
    ) -> Result<Completed> {
        let is_guided = match &fitted {
            Fitted::Trained(completion, ..) => completion.scene().is_guided(),
            Fitted::Whole(_) => false,
        };
        let (mut guide_time, mut views) = (None, None);
        let (depth, clamped, diagnostics) = match fitted {
            Fitted::Trained(completion, time, report) => {
                (guide_time, views) = (time, report);
                self.read_out(completion, points.points.len())?
            }
            Fitted::Whole(method) => (method.complete(rgb, &points.map()?)?, 0, None),
        };
        let size = (rgb.width() as usize, rgb.height() as usize);
        let preserve = self.settings.preserve_input;
        let mut depth = preserve.apply(depth, &points.points, size)?;
        let (mut left_empty, mut filled) = (None, None);
        let deviations = diagnostics
            .as_ref()
            .and_then(|found| found.deviations.as_ref());
        let limits = self.settings.limits();
        if let (true, Some(deviations)) = (limits.is_any(), deviations) {
            let (sure, pixels) = data::without_uncertain(depth.clone(), deviations, &limits)?;
            if sure.count() == 0 {
                return Err(none_left(&depth, deviations, &limits, points.unit));
            }
            left_empty = Some(LeftEmpty {
                pixels,
                max_sigma: limits.absolute,
                max_relative_sigma: limits.relative,
            });
            filled = Some(std::mem::replace(&mut depth, sure));
        }
        Ok(Completed {
            depth,
            clamped,
            left_empty,
            filled,
            quality: self.settings.quality,
            encoder_side: self.settings.encoder_side,
            guide: match &self.monocular {
                Some(network) => Some(network.to_string()),
                None => self.own_guide.clone().filter(|_| is_guided),
            },
            guide_time,
            views,
            diagnostics,
        })
    }

    /// Whether the fit limits the influence of outliers.
    fn is_robust(&self) -> bool {
        match &self.method {
            Loaded::Trained(completer) => completer.fit_config().robust.is_some(),
            Loaded::Whole(_) => false,
        }
    }

    /// The map of a fit, and its diagnostics: `own` observations are those of the image, others follow.
    fn read_out(
        &self,
        completion: Completion,
        own: usize,
    ) -> Result<(DepthMap, usize, Option<Diagnostics>)> {
        let started = Instant::now();
        let depth = match self.settings.size {
            None => completion.depth()?,
            Some(size) => completion.depth_at(size.width, size.height)?,
        };
        let dense = started.elapsed();
        let clamped = clamped_pixels(&completion, &depth);
        let robust = self.is_robust();
        // The error to expect is that of the inliers.
        let judges = self.settings.outliers
            || self.explains && robust
            || self.counts_outliers && completion.report().used <= MOST_TESTED;
        let outliers = judges.then(|| completion.outliers()).transpose()?;
        let outliers = outliers.map(|mut found| {
            found.retain(|outlier| outlier.index < own);
            found
        });
        let settings = self.settings;
        let needed = settings.uncertainty || settings.limits().is_any();
        let (width, height) = (depth.width(), depth.height());
        let deviations = || completion.standard_deviation_at(width, height);
        let deviations = if needed {
            Some(deviations())
        } else if settings.limits_of_surfaces().is_any() {
            // Too few points have no standard deviations: nothing is left out.
            match deviations() {
                Err(lsdc_core::Error::Fit(FitError::TooFewPoints(_))) => None,
                found => Some(found),
            }
        } else {
            None
        };
        let diagnostics = Diagnostics {
            leave_one_out: (self.explains.then(|| completion.leave_one_out_error())).flatten(),
            outliers,
            deviations: deviations.transpose()?,
            robust,
            completion,
            dense,
        };
        Ok((depth, clamped, Some(diagnostics)))
    }
}

/// Error if every pixel is too uncertain.
fn none_left(
    depth: &DepthMap,
    deviations: &DepthMap,
    limits: &DeviationLimits,
    unit: Unit,
) -> Error {
    let (least, _) = deviations.range().unwrap_or_default();
    let pairs = deviations.values().iter().zip(depth.values());
    let shares = pairs.map(|(sigma, depth)| sigma / depth);
    let least_share = shares.fold(f32::INFINITY, f32::min);
    let m = unit.of_depths();
    let absolute = limits
        .absolute
        .map(|most| format!("above {most} {m}: the least is {least} {m}"));
    let relative = limits
        .relative
        .map(|most| format!("above {most} of its depth: the least is {least_share}"));
    let all: Vec<String> = absolute.into_iter().chain(relative).collect();
    Error::config(format!(
        "every pixel has a standard deviation {}",
        all.join(", or ")
    ))
    .hint("give a larger --max-sigma or --max-relative-sigma, or leave it out")
}

/// Checks that a fit can be drawn towards the weights of the frame before.
fn check_temporal(fit: &FitConfig) -> Result<()> {
    let (method, prior) = (fit.method, fit.prior);
    if method != FitMethod::Field && prior == PriorKind::Learned {
        return Ok(());
    }
    Err(Error::config(format!(
        "`--temporal` would change nothing: it moves the learned prior over weights of basis functions, \
         but the fit is {} with prior {}",
        method.name(),
        prior.name()
    ))
    .hint("leave it out, or fit as the weights say: without --fit field and --prior"))
}

impl Prepared {
    /// The middle part: the weights, near those of the frame before or with the points of other images, if they are given.
    /// The scene is not fitted again.
    pub(super) fn fit(
        self,
        points: &Sparse,
        near: Option<&[f64]>,
        views: Option<&FrameViews>,
    ) -> Result<Fitted> {
        let (scene, time) = match self {
            Self::Trained(scene, time) => (scene, time),
            Self::Whole(method) => return Ok(Fitted::Whole(method)),
        };
        let (completion, report) = match (near, views) {
            (Some(weights), _) => (scene.complete_near(&points.points, weights)?, None),
            (None, Some(views)) => {
                let (completion, report) = views.complete(&scene)?;
                (completion, Some(report))
            }
            (None, None) => (scene.complete_once(&points.points)?, None),
        };
        Ok(Fitted::Trained(completion, time, report))
    }
}

impl Fitted {
    pub(super) fn weights(&self) -> Option<&[f64]> {
        match self {
            Self::Trained(completion, ..) => Some(completion.weights()),
            Self::Whole(_) => None,
        }
    }
}

impl Diagnostics {
    /// The outliers as CSV, the worst first.
    pub(super) fn outliers_csv(&self, points: &Sparse) -> String {
        let mut text = "u,v,depth,depth_by_the_others,score,probability,weight\n".to_owned();
        for outlier in self.outliers.iter().flatten() {
            let Some(point) = points.points.as_slice().get(outlier.index) else {
                continue;
            };
            let others = f64::from(point.depth) - outlier.error;
            let (score, probability, weight) = (outlier.score, outlier.probability, outlier.weight);
            // Writing to a string does not fail.
            let _ = writeln!(
                text,
                "{},{},{},{others:.4},{score:.2},{probability:.4},{weight:.4}",
                point.u, point.v, point.depth
            );
        }
        text
    }
}
