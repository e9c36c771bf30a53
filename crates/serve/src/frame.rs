//! The frame of an upload: an image with its camera, and points.

use crate::config::Limits;
use crate::fault::{Fault, FaultKind};
use crate::options::Options;
use crate::points::{self, too_many};
use crate::upload::Upload;
use image::RgbImage;
use lsdc_core::{Channels, Image, Observation, Observations};
use lsdc_files::checks::implausible_unit;
use lsdc_files::{
    Camera, Orientation, Sparse, Unit, UprightImage, has_ending, image_size, read_upright,
    reading_at_most,
};
use std::path::Path;

/// The image of a request and what belongs to it.
pub(crate) struct InputFrame {
    /// Upright.
    pub(crate) rgb: RgbImage,
    pub(crate) orientation: Orientation,
    /// Camera of the upright image.
    pub(crate) camera: Option<Camera>,
    /// Assumptions about image and camera.
    pub(crate) remarks: Vec<String>,
}

impl InputFrame {
    /// Reads the parts `image` and `camera`.
    ///
    /// # Errors
    /// Too many pixels, as the head of the file declares them; files that cannot be used.
    pub(crate) fn read(upload: &Upload, limits: &Limits) -> Result<Self, Fault> {
        let path = upload.need("image")?;
        let (width, height) = image_size(path)?;
        if width.saturating_mul(height) > limits.pixels {
            let most = limits.pixels;
            let what = format!("{width}x{height} pixels are more than the {most} that are taken");
            return Err(Fault::too_large(what).hint("send a smaller image"));
        }
        let UprightImage {
            rgb,
            orientation,
            warnings,
        } = reading_at_most(limits.unfolded, || read_upright(path))?;
        let mut remarks: Vec<String> = warnings.iter().map(ToString::to_string).collect();
        let camera = match upload.get("camera") {
            None => None,
            Some(path) => {
                let (camera, remark) = camera(path)?.for_image(&orientation)?;
                remarks.extend(remark);
                remarks.extend(camera.warnings());
                Some(camera)
            }
        };
        Ok(Self {
            rgb,
            orientation,
            camera,
            remarks: remarks
                .iter()
                .map(|remark| upload.rename_files(remark))
                .collect(),
        })
    }

    /// Width and height.
    pub(crate) fn size(&self) -> (usize, usize) {
        (self.rgb.width() as usize, self.rgb.height() as usize)
    }

    /// The image as the network takes it.
    pub(crate) fn image(&self) -> Result<Image<'_>, Fault> {
        let (width, height) = self.size();
        Ok(Image::new(width, height, Channels::Rgb, self.rgb.as_raw())?)
    }

    /// Reads the part `points`.
    ///
    /// # Errors
    /// Too many points; a file that cannot be used.
    pub(crate) fn points(
        &self,
        upload: &Upload,
        options: &Options,
        limits: &Limits,
    ) -> Result<Sparse, Fault> {
        let path = upload.need("points")?;
        if is_list(path) {
            let json = std::fs::read(path).map_err(|_| Fault::failed())?;
            return self.listed_points(points::parse(&json, limits.points)?, options);
        }
        if is_cloud(path) && self.camera.is_none() {
            let what = "points in space need the part `camera`, to be projected into the image";
            return Err(Fault::unusable(what));
        }
        let read = || {
            Sparse::read_as(
                path,
                options.stored_as()?,
                self.camera.as_ref(),
                self.orientation,
            )
            .map_err(Fault::from)
        };
        let mut points = reading_at_most(limits.unfolded, read)?;
        if points.points.len() > limits.points {
            return Err(too_many(limits.points));
        }
        points.points = with_sigma(points.points, options)?;
        for remark in &mut points.remarks {
            *remark = upload.rename_files(remark);
        }
        if options.noise()?.is_some() && (points.guessed || points.unit == Unit::MODEL) {
            let what = format!(
                "`noise` is in metres, but the unit of the depths is a guess: {}",
                points.unit
            );
            return Err(Fault::unusable(what).hint("send the option `depth_unit`, as in \"mm\""));
        }
        Ok(points)
    }

    /// The points of a list in metres, as they are.
    ///
    /// # Errors
    /// Options that were not checked.
    pub(crate) fn listed_points(
        &self,
        points: Observations,
        options: &Options,
    ) -> Result<Sparse, Fault> {
        let depths = points.iter().map(|point| point.depth);
        let depths = depths.filter(|depth| depth.is_finite() && *depth > 0.0);
        let implausible = implausible_unit(Unit::METRE, depths.collect());
        Ok(Sparse {
            points: with_sigma(points, options)?,
            ids: None,
            size: self.size(),
            unit: Unit::METRE,
            guessed: false,
            ignored: 0,
            outside: 0,
            hidden: 0,
            remarks: implausible.iter().map(ToString::to_string).collect(),
        })
    }
}

/// Checks that the part `points` is of a kind that is read.
///
/// # Errors
/// It is missing, or of another kind.
pub(crate) fn check_points(upload: &Upload) -> Result<(), Fault> {
    let path = upload.need("points")?;
    if is_list(path) || Sparse::endings().any(|ending| has_ending(path, ending)) {
        return Ok(());
    }
    let known: Vec<&str> = Sparse::endings().collect();
    let what = "the part `points` is of no kind that is known by the ending of its file";
    Err(Fault::new(FaultKind::Unsupported, what).hint(format!("send json, {}", known.join(", "))))
}

/// Whether points are JSON: by their file's ending, or as they are no file.
fn is_list(path: &Path) -> bool {
    path.extension().is_none() || has_ending(path, "json")
}

fn is_cloud(path: &Path) -> bool {
    ["ply", "pcd", "las", "laz", "bin", "xyz"]
        .into_iter()
        .any(|ending| has_ending(path, ending))
}

fn with_sigma(points: Observations, options: &Options) -> Result<Observations, Fault> {
    if let Some(noise) = options.noise()? {
        return Ok(noise.applied(&points).0);
    }
    let Some(sigma) = options.sigma else {
        return Ok(points);
    };
    let with = |point: &Observation| Observation {
        sigma: point.sigma.or(Some(sigma)),
        ..*point
    };
    Ok(points.iter().map(with).collect())
}

/// A camera from its file, or four numbers. (`Camera::from_str` would read any file that the text names.)
fn camera(path: &Path) -> Result<Camera, Fault> {
    if path.extension().is_some() {
        return Ok(Camera::read(path)?);
    }
    let text = std::fs::read_to_string(path)
        .map_err(|_| Fault::malformed("the part `camera` is no text"))?;
    if let Some(camera) = Camera::of_numbers(&text) {
        let what = "a camera has positive focal lengths and finite numbers";
        return camera.map_err(|_| Fault::unusable(what));
    }
    let ending = if text.trim_start().starts_with('{') {
        "json"
    } else {
        "toml"
    };
    let named = path.with_extension(ending);
    std::fs::rename(path, &named).map_err(|_| Fault::failed())?;
    Ok(Camera::read(&named)?)
}
