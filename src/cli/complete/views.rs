//! The measured points of other images of a sequence, which join those of each image.

use super::inputs::Job;
use super::loaded::with_noise;
use super::settings::Settings;
use crate::cli::args::PoseSource;
use crate::cli::ui::{self, counted};
use lsdc_core::{
    Completion, PosedView, Scene, ViewOutcome, ViewSettings, ViewsOutcome, ViewsReport, neighbours,
};
use lsdc_eval::data::{Camera, Colmap, Orientation};
use lsdc_files::error::{Error, Result};
use lsdc_files::{Poses, image_orientation};
use lsdc_weights::provenance;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The neighbours of an image among those of a sequence.
pub(super) struct FrameViews {
    sequence: Arc<Sequence>,
    own: usize,
    others: Vec<usize>,
    content: String,
}

/// All images whose points and poses are known.
struct Sequence {
    views: Vec<PosedView>,
    /// What they are called, and the hashes of points and poses.
    names: Vec<PathBuf>,
    hashes: Vec<String>,
    /// The file of the poses.
    source: PathBuf,
}

/// Finds the neighbours of every image: reads all points first, so that the results of a frame do not depend on the others
/// that are completed in the same run. An image without a pose has none, which is reported.
///
/// # Errors
/// Poses that cannot be read, or no camera for them.
pub(super) fn attach(settings: &Settings, jobs: &mut [Job]) -> Result<()> {
    let file = match &settings.views {
        None => return Ok(()),
        Some(PoseSource::Model) => None,
        Some(PoseSource::File(path)) => Some(path),
    };
    if file.is_none() && !Colmap::is_at(&settings.sparse) {
        return Err(Error::config("`--views` needs the poses of the images")
            .hint("give --views=FILE, such as a trajectory, or a model of COLMAP"));
    }
    let poses = file.map(|path| Poses::open(path)).transpose()?;
    for warning in poses.iter().flat_map(Poses::warnings) {
        ui::warn(&format!("warning: {warning}"));
    }
    let mut sequence = Sequence {
        views: Vec::new(),
        names: Vec::new(),
        hashes: Vec::new(),
        source: file.unwrap_or(&settings.sparse).clone(),
    };
    let mut jobs_of_views = Vec::new();
    let mut without = Vec::new();
    for (number, job) in jobs.iter().enumerate() {
        match view(settings, job, poses.as_ref()) {
            Ok(Some((view, hash))) => {
                sequence.views.push(view);
                sequence.hashes.push(hash);
                sequence.names.push(job.name.clone());
                jobs_of_views.push(number);
            }
            Ok(None) => without.push(job.name.display().to_string()),
            Err(Problem::Camera(error)) => return Err(error),
            // The error is reported where the image is completed.
            Err(Problem::Points) => {}
        }
    }
    let all = jobs.len();
    if let Some(first) = without.first() {
        if without.len() == all {
            let source = &sequence.source;
            let what = format!("none of {all} images has a pose; the first: `{first}`");
            return Err(Error::format(source, what).hint(
                "poses are found by the names or times of images; --views=FILE names a trajectory",
            ));
        }
        ui::warn(&format!(
            "warning: {} without a pose: completed without points of others, the first: {first}",
            counted(without.len(), "image")
        ));
    }
    let sequence = Arc::new(sequence);
    let all = (0..sequence.views.len()).into_par_iter();
    let found = all.map(|own| neighbours(&sequence.views, own, &ViewSettings::default()));
    let found: Vec<Vec<usize>> = found.collect();
    for ((own, others), number) in found.into_iter().enumerate().zip(jobs_of_views) {
        let hashes = std::iter::once(&own).chain(&others);
        let hashes = hashes.map(|&view| sequence.hashes[view].as_bytes());
        let hashes: Vec<&[u8]> = hashes.collect();
        jobs[number].views = Some(FrameViews {
            content: provenance::bytes_hash(&hashes),
            sequence: sequence.clone(),
            own,
            others,
        });
    }
    Ok(())
}

/// Why an image is no view.
enum Problem {
    /// No camera: none has one.
    Camera(Error),
    /// The image or its points cannot be read.
    Points,
}

/// The points of an image with its camera in the world, and their hash; nothing without a pose.
fn view(
    settings: &Settings,
    job: &Job,
    poses: Option<&Poses>,
) -> std::result::Result<Option<(PosedView, String)>, Problem> {
    let unreadable = |_: Error| Problem::Points;
    let image = image_orientation(&job.image).map_err(unreadable)?;
    let (camera, mut points) = job.points_in(settings, image).map_err(unreadable)?;
    with_noise(&mut points, settings).map_err(unreadable)?;
    let posed = posed_camera(settings, job, (poses, camera), &image);
    let Some(camera) = posed.map_err(Problem::Camera)? else {
        return Ok(None);
    };
    let mut numbers = Vec::with_capacity(points.points.len());
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
    let view = PosedView::new(camera, width, height, points.points);
    let view = view.map_err(|error| Problem::Camera(error.into()))?;
    let view = match points.ids {
        Some(ids) => view
            .with_ids(ids)
            .map_err(|error| Problem::Camera(error.into()))?,
        None => view,
    };
    Ok(Some((view, hash)))
}

/// The camera of an image at its place, if its pose is known. `camera` is that of the points.
fn posed_camera(
    settings: &Settings,
    job: &Job,
    (poses, camera): (Option<&Poses>, Option<Camera>),
    image: &Orientation,
) -> Result<Option<Camera>> {
    let Some(poses) = poses else {
        return job.camera_in_model(settings, image);
    };
    let name = job.name.to_string_lossy();
    let Some(pose) = poses.of(&name) else {
        return Ok(None);
    };
    let of_file = poses.camera(&name).filter(|_| settings.camera.is_none());
    let of_file = of_file.map(|camera| camera.for_image(image)).transpose()?;
    let camera = of_file.map(|(camera, _)| camera).or(camera);
    let camera = camera.ok_or_else(|| {
        Error::config("`--views` needs the camera of the images")
            .hint("give --camera FILE, or --camera FX,FY,CX,CY")
    })?;
    Ok(Some(camera.with_pose(pose.rotation, pose.translation)))
}

impl FrameViews {
    /// Where the poses are from.
    pub(super) fn source(&self) -> &Path {
        &self.sequence.source
    }

    /// The hash of the points and poses of the image and its neighbours.
    pub(super) fn content(&self) -> &str {
        &self.content
    }

    /// Fits the image to its points and those of the others.
    pub(super) fn complete(&self, scene: &Scene) -> Result<(Completion, ViewsReport)> {
        let views = &self.sequence.views;
        let others: Vec<&PosedView> = self.others.iter().map(|&view| &views[view]).collect();
        let settings = ViewSettings::default();
        Ok(scene.complete_with_views(&views[self.own], &others, &settings)?)
    }

    /// The report in numbers.
    pub(super) fn described(&self, report: &ViewsReport) -> DescribedViews {
        let names = self.others.iter().map(|&view| &self.sequence.names[view]);
        let views = names.zip(&report.views).map(|(name, view)| DescribedView {
            image: name.display().to_string(),
            outcome: match view.outcome {
                ViewOutcome::Used => "used",
                ViewOutcome::Inconsistent => "inconsistent",
                _ => "no overlap",
            },
            carried: view.carried,
            occluded: view.occluded,
            contradicting: view.contradicting,
            pose_deviation: view.pose_deviation,
        });
        let sum = |count: fn(&lsdc_core::ViewReport) -> usize| {
            report.views.iter().map(count).sum::<usize>()
        };
        DescribedViews {
            outcome: match report.outcome {
                ViewsOutcome::Used => "used",
                ViewsOutcome::TooFewPoints => "too few points of its own",
                ViewsOutcome::Rejected => "rejected",
                _ => "no points",
            },
            considered: report.views.len(),
            used: report.count(ViewOutcome::Used),
            inconsistent: report.count(ViewOutcome::Inconsistent),
            carried: report.carried(),
            occluded: sum(|view| view.occluded),
            contradicting: sum(|view| view.contradicting),
            doubled: sum(|view| view.doubled),
            thinned: sum(|view| view.thinned),
            errors: report.errors,
            images: views.collect(),
        }
    }
}

/// What became of the points of other images.
#[derive(Debug, Serialize)]
pub(super) struct DescribedViews {
    pub(super) outcome: &'static str,
    /// Neighbours, those that agree with the image, and those that contradict it.
    pub(super) considered: usize,
    pub(super) used: usize,
    pub(super) inconsistent: usize,
    /// Points that joined the fit, and those that did not.
    pub(super) carried: usize,
    pub(super) occluded: usize,
    pub(super) contradicting: usize,
    pub(super) doubled: usize,
    pub(super) thinned: usize,
    /// Mean relative leave-one-out errors of the image's own points, without and with the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    errors: Option<[f64; 2]>,
    images: Vec<DescribedView>,
}

#[derive(Debug, Serialize)]
struct DescribedView {
    image: String,
    outcome: &'static str,
    carried: usize,
    occluded: usize,
    contradicting: usize,
    pose_deviation: f64,
}

impl DescribedViews {
    /// What is known of points that were left out, and what should be checked, if anything.
    pub(super) fn remark(&self) -> Option<String> {
        let check = "check poses and time stamps";
        let errors = self.errors.filter(|[before, after]| after > before);
        if let Some([before, after]) = errors.filter(|_| self.outcome == "rejected") {
            let carried: usize = self.images.iter().map(|view| view.carried).sum();
            let are_wrong = self.images.iter().any(|view| view.pose_deviation > 0.0);
            let cause = if are_wrong || self.inconsistent > 0 {
                format!(
                    "{check}; if they are right, surfaces are rougher than the points are dense"
                )
            } else {
                "no error of the poses is found; surfaces may be rougher than the points are dense"
                    .to_owned()
            };
            return Some(format!(
                "{} of other images are left out, as the leave-one-out errors of the image's own points rise from {:.2} to \
                 {:.2} % with them: {cause}",
                counted(carried, "point"),
                100.0 * before,
                100.0 * after
            ));
        }
        (self.inconsistent > 0).then(|| {
            format!(
                "{} of {} contradict its points and are left out: {check}",
                self.inconsistent,
                counted(self.considered, "other image")
            )
        })
    }
}
