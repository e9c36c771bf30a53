//! The records of the files of a model.

use crate::pose::{Pose, rotation_matrix};
use std::collections::HashMap;

/// A part of a file, or what is wrong with it, and where.
pub(super) type Parsed<T> = Result<T, String>;

/// A record of `images`.
pub(super) struct ImageRecord {
    pub(super) id: u64,
    pub(super) pose: Pose,
    pub(super) camera: u32,
    pub(super) name: String,
    /// The position of each keypoint that has a point, and the point.
    pub(super) keypoints: Vec<([f64; 2], u64)>,
}

/// A record of `points3D`.
pub(super) struct Landmark {
    pub(super) position: [f64; 3],
    /// Mean reprojection error in pixels.
    pub(super) error: f64,
    /// Images that see it.
    pub(super) track: usize,
}

/// The poses of the cameras of rigs (COLMAP 3.12 and later), by rig and camera, where they are known.
pub(super) type Rigs = HashMap<(u32, u32), Option<Pose>>;

/// The rig and the camera of images and the pose of the rig (COLMAP 3.12 and later), by image.
pub(super) type RigFrames = HashMap<u64, ((u32, u32), Pose)>;

/// The pose of a quaternion w, x, y, z of any length and a translation.
///
/// # Errors
/// A quaternion of no length, or numbers that are not finite.
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
