//! Frames of a video: each starts from the weights of the one before.

use super::frame::Fitted;
use super::outputs::read_weights;
use image::{RgbImage, imageops};
use lsdc_eval::data;
use lsdc_files::error::Result;
use std::path::{Path, PathBuf};

/// Files of the preceding frame: its weights and its image.
pub(super) struct Before {
    pub(super) weights: PathBuf,
    pub(super) image: PathBuf,
}

/// The frame completed last.
#[derive(Default)]
pub(super) struct Chain(Option<Last>);

struct Last {
    path: PathBuf,
    weights: Vec<f64>,
    thumbnail: RgbImage,
}

impl Chain {
    /// The weights of the frame before, in memory or of an earlier run; none if it failed, or if the
    /// scene is another.
    pub(super) fn before(
        &self,
        before: Option<&Before>,
        rgb: &RgbImage,
    ) -> Result<Option<Vec<f64>>> {
        let Some(before) = before else {
            return Ok(None);
        };
        let read;
        let last = match &self.0 {
            Some(last) if last.path == before.weights => last,
            _ if before.weights.exists() => {
                read = Last {
                    path: before.weights.clone(),
                    weights: read_weights(&before.weights)?,
                    thumbnail: thumbnail(&data::read_rgb(&before.image)?),
                };
                &read
            }
            _ => return Ok(None),
        };
        Ok(same_scene(&last.thumbnail, &thumbnail(rgb)).then(|| last.weights.clone()))
    }

    /// Goes on from a frame whose weights go to the file `path`.
    pub(super) fn go_on(&mut self, path: Option<&Path>, rgb: &RgbImage, fitted: &Fitted) {
        self.0 = path.zip(fitted.weights()).map(|(path, weights)| Last {
            path: path.to_owned(),
            weights: weights.to_owned(),
            thumbnail: thumbnail(rgb),
        });
    }
}

fn thumbnail(rgb: &RgbImage) -> RgbImage {
    imageops::thumbnail(rgb, 32, 24)
}

/// Whether a video goes on between two images, rather than cuts.
fn same_scene(a: &RgbImage, b: &RgbImage) -> bool {
    /// Levels of 255 by which pixels differ, on average; frames of rooms seconds apart differ by 15
    /// to 80.
    const DIFFERENT: f64 = 15.0;
    let pairs = a.iter().zip(b.iter());
    let off: f64 = pairs.map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    off / (a.len().max(1) as f64) < DIFFERENT
}
