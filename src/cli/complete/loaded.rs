//! A frame in memory.

use super::settings::Settings;
use super::views::FrameViews;
use image::RgbImage;
use lsdc_core::{DepthGuide, DepthNoise};
use lsdc_eval::data::{Camera, Sparse, Unit};
use lsdc_files::error::{Error, Result};
use std::time::Duration;

/// A frame in memory.
pub(super) struct Loaded {
    pub(super) rgb: RgbImage,
    pub(super) points: Sparse,
    /// Points that were left out before, as it is not known when or where they were measured.
    pub(super) unplaced: usize,
    /// Whether all points count at the stamp of their cloud, though those of other frames do not.
    pub(super) skewed: bool,
    pub(super) camera: Option<Camera>,
    pub(super) guide: Option<DepthGuide>,
    pub(super) noise: Option<Noise>,
    /// With `--views`, if the pose of the image is known.
    pub(super) views: Option<FrameViews>,
    pub(super) reading: Duration,
}

/// The noise of a depth camera, and how many points have their standard deviations from it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noise {
    pub(super) model: DepthNoise,
    pub(super) points: usize,
}

impl Loaded {
    /// Adds the requested noise, and warnings about the size of the result.
    ///
    /// # Errors
    /// Noise in metres for depths in an unknown unit.
    pub(super) fn with_options(mut self, settings: &Settings) -> Result<Self> {
        self.noise = with_noise(&mut self.points, settings.noise)?;
        let size = (self.rgb.width() as usize, self.rgb.height() as usize);
        let wanted = settings.size.map(|size| (size.width, size.height));
        self.points
            .remarks
            .extend(wanted.and_then(|wanted| stretched(size, wanted)));
        Ok(self)
    }
}

/// Gives the points without standard deviations those of the noise that is asked for.
///
/// # Errors
/// Noise in metres for depths in an unknown unit.
pub(super) fn with_noise(points: &mut Sparse, model: Option<DepthNoise>) -> Result<Option<Noise>> {
    let Some(model) = model else {
        return Ok(None);
    };
    let Sparse { unit, guessed, .. } = *points;
    if guessed || unit == Unit::MODEL {
        let what = if guessed {
            format!("but the unit of the depths is a guess: {unit}")
        } else {
            "but the depths are in the unit of the model".to_owned()
        };
        return Err(Error::config(format!("`--noise` is in metres, {what}"))
            .hint("give --depth-unit, as in --depth-unit mm"));
    }
    let count;
    (points.points, count) = model.applied(&points.points);
    if count == 0 {
        let what = "--noise is not used: all points have standard deviations of their own";
        points.remarks.push(what.to_owned());
    }
    let points = count;
    Ok(Some(Noise { model, points }))
}

/// Warning if the result has another aspect ratio than the image.
fn stretched(image: (usize, usize), wanted: (usize, usize)) -> Option<String> {
    // Rounding a side to a pixel does not count.
    let fits = |(a, b): (usize, usize), (c, d): (usize, usize)| {
        (b as f64 * c as f64 / a as f64 - d as f64).abs() <= 1.0
    };
    let turned = |(a, b)| (b, a);
    let same = fits(image, wanted) || fits(turned(image), turned(wanted));
    (!same).then(|| {
        format!(
            "--size {}x{} stretches the image of {}x{}, which has another shape",
            wanted.0, wanted.1, image.0, image.1
        )
    })
}
