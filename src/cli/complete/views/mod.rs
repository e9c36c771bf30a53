//! The measured points of other images of a sequence, which join those of each image.

mod files;
mod recorded;
mod report;

use super::job::Job;
use super::settings::Settings;
use crate::cli::ui;
use lsdc_core::{Completion, PosedView, Scene, ViewSettings, ViewsReport};
use lsdc_eval::data::{Camera, Sparse};
use lsdc_files::Poses;
use lsdc_files::error::{Error, Result};
use lsdc_recordings::SyncedFrame;
use lsdc_weights::provenance;
pub(super) use recorded::RecordedViews;
pub(super) use report::DescribedViews;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Finds the neighbours of every image with a pose, with `--views`: of files now, of a recording as its images are completed.
///
/// # Errors
/// Poses that cannot be read, or no camera for them.
pub(super) fn attach(settings: &Settings, jobs: &mut [Job]) -> Result<()> {
    let Some(poses) = &settings.views else {
        return Ok(());
    };
    let Some(recorded) = jobs.iter().find_map(Job::recording).cloned() else {
        return files::attach(settings, poses, jobs);
    };
    let views = RecordedViews::open(settings, recorded)?;
    let views = views.map(Arc::new);
    for job in jobs {
        let found = views.clone().zip(job.recorded());
        job.views = found.map(|(views, (_, frame))| FrameViewsSource::Recorded {
            views,
            frame: Box::new(frame.clone()),
        });
    }
    Ok(())
}

/// The source of an image's neighbours.
pub(super) enum FrameViewsSource {
    /// In memory.
    Known {
        /// File of the poses, or folder of the model.
        source: Arc<Path>,
        views: FrameViews,
    },
    /// Read from a recording on demand.
    Recorded {
        views: Arc<RecordedViews>,
        frame: Box<SyncedFrame>,
    },
}

impl FrameViewsSource {
    /// Path of the poses.
    pub(super) fn source(&self) -> &Path {
        match self {
            Self::Known { source, .. } => source,
            Self::Recorded { views, .. } => views.source(),
        }
    }

    /// Whether points, cameras and poses are all in one file.
    pub(super) fn is_one_file(&self) -> bool {
        matches!(self, Self::Recorded { views, .. } if views.has_own_poses())
    }

    /// The neighbours; none if the pose of the image is not known, or its points cannot be read.
    pub(super) fn find(&self) -> Option<FrameViews> {
        match self {
            Self::Known { views, .. } => Some(views.clone()),
            Self::Recorded { views, frame } => views.find(frame),
        }
    }

    /// The hash of the points and poses of the image and its neighbours.
    pub(super) fn content(&self) -> String {
        let found = self.find();
        let all = found.iter().flat_map(FrameViews::all);
        let hashes: Vec<&[u8]> = all.map(|view| view.hash.as_bytes()).collect();
        provenance::bytes_hash(&hashes)
    }
}

/// An image of a sequence.
struct SequenceView {
    name: PathBuf,
    view: PosedView,
    /// Hash of points and pose.
    hash: String,
}

impl SequenceView {
    /// Creates the view from the camera, posed in the world, and the points of an image.
    ///
    /// # Errors
    /// A camera with numbers that cannot be.
    fn new(name: PathBuf, camera: &Camera, points: Sparse) -> Result<Self> {
        let mut numbers = Vec::with_capacity(24 * points.points.len());
        for point in &points.points {
            let sigma = point.sigma.unwrap_or(0.0);
            numbers.extend([point.u, point.v].map(f64::to_le_bytes).concat());
            numbers.extend([point.depth, sigma].map(f32::to_le_bytes).concat());
        }
        let ids = points.ids.iter().flatten();
        let ids: Vec<u8> = ids.flat_map(|id| id.to_le_bytes()).collect();
        let placed = format!("{camera:?}");
        let hash = provenance::bytes_hash(&[placed.as_bytes(), &numbers, &ids]);
        let (width, height) = points.size;
        let view = PosedView::new(camera.clone(), width, height, points.points)?;
        let view = match points.ids {
            Some(ids) => view.with_ids(ids)?,
            None => view,
        };
        Ok(Self { name, view, hash })
    }
}

/// An image and its neighbours, the closest first.
#[derive(Clone)]
pub(super) struct FrameViews {
    own: Arc<SequenceView>,
    others: Vec<Arc<SequenceView>>,
    settings: ViewSettings,
}

impl FrameViews {
    /// The image, then its neighbours.
    fn all(&self) -> impl Iterator<Item = &Arc<SequenceView>> {
        std::iter::once(&self.own).chain(&self.others)
    }

    /// Fits the image to its points and those of the others.
    pub(super) fn complete(&self, scene: &Scene) -> Result<(Completion, ViewsReport)> {
        let others: Vec<&PosedView> = self.others.iter().map(|other| &other.view).collect();
        Ok(scene.complete_with_views(&self.own.view, &others, &self.settings)?)
    }
}

/// Opens a file of poses, and prints what is left out of it.
fn open(path: &Path) -> Result<Poses> {
    let poses = Poses::open(path)?;
    for warning in poses.warnings() {
        ui::warn(&format!("warning: {warning}"));
    }
    Ok(poses)
}

fn no_camera() -> Error {
    Error::config("`--views` needs the camera of the images")
        .hint("give --camera FILE, or --camera FX,FY,CX,CY")
}
