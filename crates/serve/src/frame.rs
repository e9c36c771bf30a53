//! What is in an upload: an image with its camera, and points.

use crate::config::Limits;
use crate::fault::{Fault, Kind};
use crate::options::Options;
use crate::points::{Points, too_many};
use crate::upload::Upload;
use image::RgbImage;
use lsdc_core::{Channels, Image, Observation};
use lsdc_files::{
    Camera, Orientation, Sparse, Unit, Upright, has_ending, image_size, read_upright,
    reading_at_most,
};
use std::path::Path;

/// An image and what belongs to it.
pub(crate) struct Frame {
    /// Upright.
    pub(crate) rgb: RgbImage,
    pub(crate) orientation: Orientation,
    /// Of the image as it is shown.
    pub(crate) camera: Option<Camera>,
    /// What was assumed of them.
    pub(crate) remarks: Vec<String>,
}

impl Frame {
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
        let Upright {
            rgb,
            orientation,
            doubts,
        } = reading_at_most(limits.unfolded, || read_upright(path))?;
        let mut remarks: Vec<String> = doubts.iter().map(ToString::to_string).collect();
        let camera = match upload.get("camera") {
            None => None,
            Some(path) => {
                let (camera, remark) = camera(path)?.for_image(&orientation)?;
                remarks.extend(remark);
                remarks.extend(camera.doubts());
                Some(camera)
            }
        };
        Ok(Self {
            rgb,
            orientation,
            camera,
            remarks,
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
            return Ok(self.listed(Points::parse(&json, limits.points)?, options));
        }
        if is_cloud(path) && self.camera.is_none() {
            let what = "points in space need the part `camera`, to be projected into the image";
            return Err(Fault::unusable(what));
        }
        let read = || {
            Sparse::read(
                path,
                options.unit()?,
                self.camera.as_ref(),
                self.orientation,
            )
            .map_err(Fault::from)
        };
        let mut points = reading_at_most(limits.unfolded, read)?;
        if points.points.len() > limits.points {
            return Err(too_many(points.points.len(), limits.points));
        }
        points.points = with_sigma(points.points.iter(), options.sigma);
        Ok(points)
    }

    /// Points of a list, which are taken as they are.
    pub(crate) fn listed(&self, points: Points, options: &Options) -> Sparse {
        Sparse {
            points: with_sigma(points.0.iter(), options.sigma),
            size: self.size(),
            unit: Unit::METRE,
            guessed: false,
            ignored: 0,
            outside: 0,
            hidden: 0,
            remarks: Vec::new(),
        }
    }
}

/// Refuses points of a kind that is not read.
///
/// # Errors
/// They are.
pub(crate) fn check_points(upload: &Upload) -> Result<(), Fault> {
    let path = upload.need("points")?;
    if is_list(path) || Sparse::endings().any(|ending| has_ending(path, ending)) {
        return Ok(());
    }
    let known: Vec<&str> = Sparse::endings().collect();
    let what = "the part `points` is of no kind that is known by the ending of its file";
    Err(Fault::new(Kind::Unsupported, what).hint(format!("send json, {}", known.join(", "))))
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

fn with_sigma<'a>(
    points: impl Iterator<Item = &'a Observation>,
    sigma: Option<f32>,
) -> lsdc_core::Observations {
    let points = points.map(|point| Observation {
        sigma: point.sigma.or(sigma),
        ..*point
    });
    points.collect()
}

/// A camera from its file, or four numbers. (A name of another file would be read by `Camera::from_str`.)
fn camera(path: &Path) -> Result<Camera, Fault> {
    if path.extension().is_some() {
        return Ok(Camera::read(path)?);
    }
    let text = std::fs::read_to_string(path)
        .map_err(|_| Fault::malformed("the part `camera` is no text"))?;
    let numbers: Vec<Option<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    if let [Some(fx), Some(fy), Some(cx), Some(cy)] = numbers[..] {
        let sound = fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|v| v.is_finite());
        return if sound {
            Ok(Camera::pinhole([fx, fy], [cx, cy]))
        } else {
            Err(Fault::unusable(
                "a camera has positive focal lengths and finite numbers",
            ))
        };
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
