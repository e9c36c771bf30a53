//! The records of the files of a model.

use crate::pose::{Pose, rotation_matrix};
use std::collections::HashMap;

/// A parsed part of a file, or a description of the damage and its location.
pub(super) type Parsed<T> = Result<T, String>;

/// A record of `images`.
pub(super) struct ImageRecord {
    pub(super) id: u64,
    pub(super) pose: Pose,
    pub(super) camera: u32,
    pub(super) name: String,
    /// Position of each keypoint that has a point, and the identifier of the point.
    pub(super) keypoints: Vec<([f64; 2], u64)>,
}

/// A record of `points3D`.
pub(super) struct Landmark {
    pub(super) position: [f64; 3],
    /// Mean reprojection error in pixels.
    pub(super) error: f64,
    /// Identifiers of the images that see the point.
    pub(super) images: Vec<u64>,
}

/// Poses of the cameras of rigs (COLMAP 3.12 and later), by rig and camera; `None` if unknown.
pub(super) type Rigs = HashMap<(u32, u32), Option<Pose>>;

/// Rig and camera of an image, and the pose of the rig (COLMAP 3.12 and later), by image.
pub(super) type RigFrames = HashMap<u64, ((u32, u32), Pose)>;

/// Returns the pose of a quaternion w, x, y, z of any length and a translation.
///
/// # Errors
/// The quaternion has no length, or numbers are not finite.
pub(super) fn pose([w, x, y, z, translation @ ..]: [f64; 7]) -> Parsed<Pose> {
    let norm = [w, x, y, z].iter().map(|v| v * v).sum::<f64>().sqrt();
    if !(norm.is_normal() && translation.iter().all(|v| v.is_finite())) {
        return Err(format!(
            "holds a pose that is no rotation and translation: {w} {x} {y} {z}, {translation:?}"
        ));
    }
    Ok(Pose {
        rotation: rotation_matrix([x, y, z, w].map(|v| v / norm)),
        translation,
    })
}
