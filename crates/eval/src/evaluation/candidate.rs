//! Candidates of an evaluation: the methods of this program, or depth maps of another program.

use crate::data::{DepthMap, Frame, GuideSource, Unit, read_depth, stored_unit};
use crate::metrics::PredictedErrors;
use crate::predict::{DepthCompleter, Guides, Method, complete_classic, guided_scene, scene};
use crate::sampling::{Interpolation, Size, move_points, resize_depth, resize_rgb};
use image::RgbImage;
use lsdc_core::{Completer, DepthGuide, Observations, Scene};
use lsdc_files::error::{Cause, Error, Result};
use lsdc_weights::provenance;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A source of predictions.
#[derive(Clone, Debug)]
pub enum Candidate {
    /// A method of this program.
    Method(Method),
    /// A method that completes at a smaller size, with its result enlarged.
    Enlarged {
        /// The method.
        method: Method,
        /// The smaller size.
        from: Size,
        /// Kind of enlargement.
        by: Enlargement,
    },
    /// A trained system; if `from` is set, it completes at that size, and its result is enlarged bilinearly.
    System {
        /// The system with its weights.
        system: Arc<dyn DepthCompleter>,
        /// Record of the inputs that its predictions depend on.
        made_from: Map<String, Value>,
        /// The smaller size; `None` for the size of the frame.
        from: Option<Size>,
    },
    /// Predictions in this folder, or in its `seedN` folders, which must exist if there are several draws: `FRAME.npy` (metres)
    /// or `FRAME.png` (millimetres, or the unit recorded in the file).
    Files(PathBuf),
}

impl Candidate {
    /// Checks that there are predictions for each draw of points: one prediction used for several draws would have no spread.
    pub(super) fn check_draws(&self, name: &str, seeds: &[u64]) -> Result<()> {
        let Self::Files(folder) = self else {
            return Ok(());
        };
        let missing = seeds
            .iter()
            .find(|seed| !seed_folder(folder, **seed).is_dir());
        match missing.filter(|_| seeds.len() > 1) {
            None => Ok(()),
            Some(seed) => Err(Error::config(format!(
                "`{name}` has no folder `{}`: one prediction would count for {} draws of points",
                seed_folder(folder, *seed).display(),
                seeds.len()
            ))
            .hint("give the predictions of each draw a folder seedN, or measure one: --seeds 1")),
        }
    }

    /// Returns a record of the inputs of its predictions, apart from the network and its fit. Files are recorded by their
    /// contents.
    ///
    /// # Errors
    /// A folder that cannot be read.
    pub(super) fn made_from(&self) -> Result<Value> {
        Ok(match self {
            Self::Method(method) => json!({ "method": method }),
            Self::Enlarged { method, from, by } => {
                json!({ "method": method, "from": from, "by": format!("{by:?}") })
            }
            Self::System {
                made_from, from, ..
            } => {
                let mut made_from = made_from.clone();
                made_from.insert("from".to_owned(), json!(from));
                made_from.into()
            }
            Self::Files(folder) => {
                json!({ "files": provenance::folder_hash(folder, &["npy", "png"])? })
            }
        })
    }
}

/// Method of enlarging a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Enlargement {
    /// Bilinear interpolation between depths.
    Bilinear,
    /// Basis functions evaluated at the larger size (Fang et al., section 4.5); only for `lsdc`.
    Bases,
}

/// State shared by the predictions of a frame: its features and basis functions, and its guide if there is one.
pub(super) struct PreparedFrame<'a> {
    network: Option<(&'a Completer, Scene)>,
    uncertainty: bool,
}

impl<'a> PreparedFrame<'a> {
    pub(super) fn new(
        completer: Option<&'a Completer>,
        guides: Option<Guides<'_>>,
        frame: &Frame,
        uncertainty: bool,
    ) -> Result<Self> {
        let network = match completer {
            None => None,
            Some(completer) => {
                let guide = guides.map(|guides| match guides {
                    Guides::Files(source) => guide(source, frame),
                    Guides::Predicted(network) => network.predict(&frame.rgb),
                });
                let scene = guided_scene(completer, &frame.rgb, guide.transpose()?.as_ref())?;
                Some((completer, scene))
            }
        };
        Ok(Self {
            network,
            uncertainty,
        })
    }

    /// Returns the depth map of a candidate for a frame and its points, and the predicted error distribution if uncertainty is
    /// measured and the candidate predicts it.
    pub(super) fn predict(
        &self,
        candidate: &Candidate,
        frame: &Frame,
        sparse: &DepthMap,
        seed: u64,
    ) -> Result<(DepthMap, Option<PredictedErrors>)> {
        match (candidate, &self.network) {
            (Candidate::Method(Method::Classic(method)), _) => {
                Ok((complete_classic(*method, &frame.rgb, sparse)?, None))
            }
            (Candidate::Method(Method::Lsdc), Some((_, scene))) => {
                let completion = scene.complete(&given(sparse))?;
                let predicted_errors = self.uncertainty.then(|| {
                    Ok::<_, Error>(PredictedErrors {
                        deviations: completion.standard_deviation()?,
                        freedom: completion.freedom(),
                    })
                });
                Ok((completion.depth()?, predicted_errors.transpose()?))
            }
            (Candidate::Method(Method::Lsdc), None) => Err(missing_network()),
            (Candidate::Enlarged { method, from, by }, network) => {
                let complete = |rgb: &RgbImage, sparse: &DepthMap| -> Result<DepthMap> {
                    match (method, network) {
                        (Method::Classic(method), _) => complete_classic(*method, rgb, sparse),
                        (Method::System(system), _) => Err(missing_weights(system.name())),
                        (Method::Lsdc, None) => Err(missing_network()),
                        (Method::Lsdc, Some((completer, _))) => {
                            let completion = scene(completer, rgb)?.complete(&given(sparse))?;
                            Ok(match by {
                                Enlargement::Bases => completion
                                    .depth_at(frame.depth.width(), frame.depth.height())?,
                                Enlargement::Bilinear => completion.depth()?,
                            })
                        }
                    }
                };
                Ok((enlarged(*from, frame, sparse, complete)?, None))
            }
            (Candidate::Method(Method::System(system)), _) => Err(missing_weights(system.name())),
            (Candidate::System { system, from, .. }, _) => {
                let depth = match from {
                    None => system.depth(&frame.rgb, sparse)?,
                    Some(from) => enlarged(*from, frame, sparse, |rgb, sparse| {
                        system.depth(rgb, sparse)
                    })?,
                };
                Ok((depth, None))
            }
            (Candidate::Files(folder), _) => {
                let prediction = read(folder, &frame.id, seed)?;
                check(&prediction, frame, folder)?;
                Ok((prediction, None))
            }
        }
    }
}

/// Returns the points of a map as `lsdc complete` reads them, without hidden ones.
fn given(sparse: &DepthMap) -> Observations {
    let mut points = Observations::from_map(sparse);
    points.remove_hidden(sparse.width(), sparse.height());
    points
}

/// Returns the error for a system whose weights are missing.
fn missing_weights(name: &str) -> Error {
    Error::weights(format!("method `{name}` needs weights of its own"))
        .hint(format!("train them: `lsdc train --method {name}`"))
}

fn missing_network() -> Error {
    Error::weights("method `lsdc` needs a network")
}

/// Completes image and points at a smaller size, and interpolates the result to the size of the frame.
fn enlarged(
    from: Size,
    frame: &Frame,
    sparse: &DepthMap,
    complete: impl FnOnce(&RgbImage, &DepthMap) -> Result<DepthMap>,
) -> Result<DepthMap> {
    let rgb = resize_rgb(&frame.rgb, from, Interpolation::PilBilinear)?;
    let depth = complete(&rgb, &move_points(sparse, from)?)?;
    resize_depth(&depth, Size::of(&frame.depth), Interpolation::CvBilinear)
}

/// Returns the folder of the predictions of a draw, if each draw has its own.
fn seed_folder(folder: &Path, seed: u64) -> PathBuf {
    folder.join(format!("seed{seed}"))
}

fn read(folder: &Path, frame: &str, seed: u64) -> Result<DepthMap> {
    let seed_folder = seed_folder(folder, seed);
    let folder = if seed_folder.is_dir() {
        seed_folder
    } else {
        folder.to_owned()
    };
    // Frames may be in subfolders, or all in one folder with `/` replaced by `_` in their names.
    for name in [frame.to_owned(), frame.replace('/', "_")] {
        for (ending, scale) in [("npy", 1.0), ("png", 0.001)] {
            let path = folder.join(format!("{name}.{ending}"));
            if path.is_file() {
                let scale = stored_unit(&path).map_or(scale, Unit::metres);
                return read_depth(&path, scale);
            }
        }
    }
    Err(Error::new(
        Cause::Read,
        format!(
            "there is no prediction for frame `{frame}` in `{}`",
            folder.display()
        ),
    )
    .hint("expected FRAME.npy in metres or FRAME.png in millimetres"))
}

/// Reads the guide of a frame from a file, which must show the same part of the image.
fn guide(source: &GuideSource, frame: &Frame) -> Result<DepthGuide> {
    let (guide, _) = source.read_for(&frame.id)?;
    let [guide_size, frame_size] = [
        (guide.width(), guide.height()),
        (frame.depth.width(), frame.depth.height()),
    ];
    let aspect = |(width, height): (usize, usize)| width as f64 / height as f64;
    if (aspect(guide_size) / aspect(frame_size)).ln().abs() > MAX_LOG_ASPECT {
        return Err(Error::shape(format!(
            "the guide for `{}` in `{}` is {}x{} but the frame is {}x{}",
            frame.id,
            source.path.display(),
            guide_size.0,
            guide_size.1,
            frame_size.0,
            frame_size.1
        ))
        .hint(
            "guides belong to the frame after resizing and cropping: `lsdc export` writes the images",
        ));
    }
    Ok(guide)
}

/// Largest difference between the logarithms of two aspect ratios that counts as rounding.
const MAX_LOG_ASPECT: f64 = 0.02;

fn check(prediction: &DepthMap, frame: &Frame, folder: &Path) -> Result<()> {
    if Size::of(prediction) == Size::of(&frame.depth) {
        let pairs = prediction.values().iter().zip(frame.depth.values());
        if pairs.into_iter().any(|(&p, &truth)| p > 0.0 && truth > 0.0) {
            return Ok(());
        }
        return Err(Error::shape(format!(
            "the prediction for `{}` in `{}` has no depth where there is a true one",
            frame.id,
            folder.display()
        ))
        .hint("0, NaN, infinite and negative values are no depths"));
    }
    Err(Error::shape(format!(
        "the prediction for `{}` in `{}` is {}x{} but the frame is {}x{}",
        frame.id,
        folder.display(),
        prediction.width(),
        prediction.height(),
        frame.depth.width(),
        frame.depth.height()
    ))
    .hint("predictions belong to the frame after resizing and cropping: `lsdc export` writes it"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_between_the_returns_of_an_object_are_not_given() {
        let mut depths = vec![0.0; 600 * 200];
        for v in (0..200).step_by(5) {
            for u in (0..600).step_by(4) {
                let is_object = (200..300).contains(&u) && (50..150).contains(&v);
                depths[v * 600 + u] = if is_object { 8.0 } else { 30.0 };
                if is_object && u < 213 {
                    depths[(v + 2) * 600 + u + 1] = 30.0;
                }
            }
        }
        let given = given(&DepthMap::new(600, 200, depths).unwrap());
        assert!(given.len() > 5000);
        assert!(
            given
                .iter()
                .all(|point| (point.v as usize).is_multiple_of(5))
        );
    }
}
