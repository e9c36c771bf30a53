//! Images in files: all points are read before the first image is completed.

use super::{FrameViews, FrameViewsSource, SequenceView};
use crate::cli::args::PoseSource;
use crate::cli::complete::job::Job;
use crate::cli::complete::loaded::with_noise;
use crate::cli::complete::settings::Settings;
use crate::cli::ui::{self, counted};
use lsdc_core::{PosedView, neighbours};
use lsdc_eval::data::{Camera, Colmap, Orientation};
use lsdc_files::error::{Error, Result};
use lsdc_files::{Poses, image_orientation};
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;

/// Finds the neighbours of every image: reads all points first, so that the results of a frame do not depend on the others
/// that are completed in the same run. An image without a pose has none, which is reported.
///
/// # Errors
/// Poses that cannot be read, or no camera for them.
pub(super) fn attach(settings: &Settings, poses: &PoseSource, jobs: &mut [Job]) -> Result<()> {
    let file = match poses {
        PoseSource::Own => None,
        PoseSource::File(path) => Some(path),
    };
    if file.is_none() && !Colmap::is_at(&settings.sparse) {
        return Err(Error::config("`--views` needs the poses of the images")
            .hint("give --views=FILE, such as a trajectory, or a model of COLMAP"));
    }
    let poses = file.map(|path| super::open(path)).transpose()?;
    let source: Arc<Path> = file.unwrap_or(&settings.sparse).as_path().into();
    let mut sequence = Vec::new();
    let mut jobs_of_views = Vec::new();
    let mut without = Vec::new();
    for (number, job) in jobs.iter().enumerate() {
        match view(settings, job, poses.as_ref()) {
            Ok(Some(view)) => {
                sequence.push(Arc::new(view));
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
            let what = format!("none of {all} images has a pose; the first: `{first}`");
            return Err(Error::format(&source, what).hint(
                "poses are found by the names or times of images; --views=FILE names a trajectory",
            ));
        }
        ui::warn(&format!(
            "warning: {} without a pose: completed without points of others, the first: {first}",
            counted(without.len(), "image")
        ));
    }
    let views: Vec<PosedView> = sequence.iter().map(|one| one.view.clone()).collect();
    let all = (0..views.len()).into_par_iter();
    let found = all.map(|own| neighbours(&views, own, &settings.neighbours));
    let found: Vec<Vec<usize>> = found.collect();
    for ((own, others), number) in found.into_iter().enumerate().zip(jobs_of_views) {
        let others = others.into_iter().map(|view| sequence[view].clone());
        jobs[number].views = Some(FrameViewsSource::Known {
            source: source.clone(),
            views: FrameViews {
                own: sequence[own].clone(),
                others: others.collect(),
                settings: settings.neighbours,
            },
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

/// The points of an image with its camera in the world; nothing without a pose.
fn view(
    settings: &Settings,
    job: &Job,
    poses: Option<&Poses>,
) -> std::result::Result<Option<SequenceView>, Problem> {
    let unreadable = |_: Error| Problem::Points;
    let image = image_orientation(&job.image).map_err(unreadable)?;
    let (camera, mut points) = job.points_in(settings, image).map_err(unreadable)?;
    with_noise(&mut points, settings.noise).map_err(unreadable)?;
    let posed = posed_camera(settings, job, (poses, camera), &image);
    let Some(camera) = posed.map_err(Problem::Camera)? else {
        return Ok(None);
    };
    let view = SequenceView::new(job.name.clone(), &camera, points);
    view.map(Some).map_err(Problem::Camera)
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
    let camera = camera.ok_or_else(super::no_camera)?;
    Ok(Some(camera.with_pose(pose.rotation, pose.translation)))
}
