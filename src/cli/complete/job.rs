//! One image to complete, and where its points, guide and neighbours are.

use super::loaded::Loaded;
use super::recorded::Recorded;
use super::settings::Settings;
use super::views::FrameViewsSource;
use lsdc_core::DepthGuide;
use lsdc_eval::data::{self, Camera, DepthReadOptions, Orientation, Sparse, UprightImage, View};
use lsdc_eval::predict::GuideSpec;
use lsdc_files::error::{Error, Result};
use lsdc_recordings::SyncedFrame;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// An image and where its points are.
pub(super) struct Job {
    pub(super) image: PathBuf,
    /// Name of its results: a path below the folder of results.
    pub(super) name: PathBuf,
    pub(super) points: Points,
    pub(super) guide: Option<PathBuf>,
    /// With `--views`, the source of its neighbours.
    pub(super) views: Option<FrameViewsSource>,
}

pub(super) enum Points {
    File(PathBuf),
    View(Box<View>),
    /// Image and points are messages of a recording.
    Recorded(Arc<Recorded>, Box<SyncedFrame>),
}

/// An input of a frame.
pub(super) enum Input<'a> {
    /// A file, or the folder of a model.
    File(&'a Path),
    /// Messages of a recording.
    Frame(&'a Recorded, &'a SyncedFrame),
    /// Points and poses of other images.
    Views(&'a FrameViewsSource),
}

impl Input<'_> {
    /// Path of the input.
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Frame(recorded, _) => recorded.path(),
            Self::Views(views) => views.source(),
        }
    }
}

impl Job {
    /// Returns its inputs with their roles; the files of a model count as one folder.
    pub(super) fn inputs<'a>(&'a self, settings: &'a Settings) -> Vec<(&'static str, Input<'a>)> {
        let points = match &self.points {
            Points::File(path) => Input::File(path),
            Points::View(_) => Input::File(&settings.sparse),
            Points::Recorded(recorded, frame) => Input::Frame(recorded, frame),
        };
        let alone = matches!(points, Input::Frame(..));
        let image = (!alone).then_some(("image", Input::File(&self.image)));
        let points = (if alone { "recording" } else { "points" }, points);
        let guide = self
            .guide
            .as_deref()
            .map(|guide| ("guide", Input::File(guide)));
        let views = self.views.as_ref();
        let views = views.map(|views| ("views", Input::Views(views)));
        let all = image.into_iter().chain([points]).chain(guide);
        all.chain(views).collect()
    }

    /// The image of a model, if it is one.
    pub(super) fn view(&self) -> Option<&View> {
        match &self.points {
            Points::View(view) => Some(view),
            Points::File(_) | Points::Recorded(..) => None,
        }
    }

    /// The frame of a recording, if it is one.
    pub(super) fn recorded(&self) -> Option<(&Recorded, &SyncedFrame)> {
        match &self.points {
            Points::Recorded(recorded, frame) => Some((recorded, frame)),
            Points::File(_) | Points::View(_) => None,
        }
    }

    /// The recording that it is of, if it is of one.
    pub(super) fn recording(&self) -> Option<&Arc<Recorded>> {
        match &self.points {
            Points::Recorded(recorded, _) => Some(recorded),
            Points::File(_) | Points::View(_) => None,
        }
    }

    pub(super) fn load(&self, settings: &Settings) -> Result<Loaded> {
        let started = Instant::now();
        let mut loaded = match &self.points {
            Points::Recorded(recorded, frame) => recorded.load(frame)?.1,
            Points::File(_) | Points::View(_) => self.load_files(settings)?,
        };
        if let (Some(GuideSpec::Files(source)), Some(file)) = (&settings.guide, &self.guide) {
            let (guide, read) = source.read(file)?;
            let size = (loaded.rgb.width() as usize, loaded.rgb.height() as usize);
            let read = read.iter().map(|doubt| format!("of the guide: {doubt}"));
            let warnings = warnings(&guide, size).into_iter().chain(read);
            loaded.points.remarks.extend(warnings);
            loaded.guide = Some(guide);
        }
        loaded.views = self.views.as_ref().and_then(FrameViewsSource::find);
        loaded.reading = started.elapsed();
        loaded.with_options(settings)
    }

    fn load_files(&self, settings: &Settings) -> Result<Loaded> {
        let UprightImage {
            rgb,
            orientation: image,
            warnings,
        } = data::read_upright(&self.image)?;
        let (camera, mut points) = self.points_in(settings, image)?;
        points
            .remarks
            .extend(warnings.iter().map(ToString::to_string));
        Ok(Loaded {
            rgb,
            points,
            unplaced: 0,
            skewed: false,
            camera,
            guide: None,
            noise: None,
            views: None,
            reading: Duration::ZERO,
        })
    }

    /// The points of files in an image of this size, and its camera, if that is known.
    pub(super) fn points_in(
        &self,
        settings: &Settings,
        image: Orientation,
    ) -> Result<(Option<Camera>, Sparse)> {
        let mut assumed = Vec::new();
        let camera = match (&settings.camera, &self.points) {
            (Some(camera), _) => {
                let (camera, remark) = camera.for_image(&image)?;
                assumed.extend(remark.into_iter().chain(camera.warnings()));
                Some(camera)
            }
            (None, Points::View(view)) => view.camera_of(&image, settings.depth_unit)?,
            (None, _) => None,
        };
        let mut points = match &self.points {
            Points::File(path) => {
                let how = DepthReadOptions {
                    unit: settings.depth_unit,
                    kind: settings.depth_kind,
                };
                Sparse::read_as(path, how, camera.as_ref(), image)?
            }
            Points::View(view) => Sparse::of_view(view, image, settings.depth_unit)?,
            Points::Recorded(..) => return Err(Error::config("a message is in no file")),
        };
        if let Some(path) = &settings.sigma {
            points = points.with_sigma(path, image)?;
        }
        points.remarks.extend(assumed);
        Ok((camera, points))
    }

    /// The camera of the image at its place in the model, if it is of one.
    pub(super) fn camera_in_model(
        &self,
        settings: &Settings,
        image: &Orientation,
    ) -> Result<Option<Camera>> {
        match &self.points {
            Points::View(view) => view.camera_of(image, settings.depth_unit),
            Points::File(_) | Points::Recorded(..) => Ok(None),
        }
    }
}

/// Returns warnings about a guide for an image of (width, height).
fn warnings(guide: &DepthGuide, (width, height): (usize, usize)) -> Vec<String> {
    /// Many networks round the sides to multiples of 14 or 32.
    const UNLIKE: f64 = 1.1;
    let mut warnings = Vec::new();
    let aspect = |width: usize, height: usize| width as f64 / height as f64;
    let ratio = aspect(guide.width(), guide.height()) / aspect(width, height);
    if !(UNLIKE.recip()..=UNLIKE).contains(&ratio) {
        warnings.push(format!(
            "the guide is {}x{} but the image {width}x{height}: it is stretched to cover the image",
            guide.width(),
            guide.height()
        ));
    }
    let (missing, pixels) = (guide.missing(), guide.width() * guide.height());
    if missing > 0 {
        warnings.push(format!(
            "{missing} of the {pixels} pixels of the guide hold no prediction; gaps were filled from their sides"
        ));
    }
    warnings
}
