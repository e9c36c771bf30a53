//! KITTI depth completion (Uhrig et al. 2017): 16-bit PNG, metres = value / 256, 0 = no laser
//! return.

use super::folder::{FolderConfig, find};
use super::{Folder, no_frame};
use crate::data::{Environment, Split};
use lsdc_files::error::Result;
use std::path::Path;

/// Image, ground truth and laser points: the 1000 cropped validation frames, then the full tree with the raw images moved into
/// it.
const LAYOUTS: [[&str; 4]; 3] = [
    [
        "cropped validation frames",
        "{drive}_image_{frame}_image_{camera}.png",
        "{drive}_groundtruth_depth_{frame}_image_{camera}.png",
        "{drive}_velodyne_raw_{frame}_image_{camera}.png",
    ],
    [
        "full tree",
        "{split}/{drive}/{camera}/data/{frame}.png",
        "{split}/{drive}/proj_depth/groundtruth/{camera}/{frame}.png",
        "{split}/{drive}/proj_depth/velodyne_raw/{camera}/{frame}.png",
    ],
    [
        "full tree",
        "data_rgb/{split}/{drive}/{camera}/data/{frame}.png",
        "data_depth_annotated/{split}/{drive}/proj_depth/groundtruth/{camera}/{frame}.png",
        "data_depth_velodyne/{split}/{drive}/proj_depth/velodyne_raw/{camera}/{frame}.png",
    ],
];

/// Prefixes of the paths of the cropped validation frames.
const CROPPED_PREFIXES: [&str; 3] = [
    "depth_selection/val_selection_cropped/",
    "val_selection_cropped/",
    "",
];

/// Opens the cropped validation frames or the full tree.
///
/// # Errors
/// No frame in a known layout.
pub(in crate::data) fn kitti(root: &Path, split: Split) -> Result<Folder> {
    for [about, rgb, depth, sparse] in LAYOUTS {
        let cropped = !rgb.contains('/');
        if cropped && split == Split::Train {
            continue;
        }
        for prefix in if cropped {
            &CROPPED_PREFIXES[..]
        } else {
            &[""]
        } {
            let below = |folder: &str, name: &str| {
                if cropped {
                    format!("{prefix}{folder}/{name}")
                } else {
                    name.to_owned()
                }
            };
            let config = FolderConfig {
                rgb: below("image", rgb),
                depth: below("groundtruth_depth", depth),
                sparse: Some(below("velodyne_raw", sparse)),
                depth_scale: Some(1.0 / 256.0),
                place: Environment::Outdoor,
                ..FolderConfig::default()
            };
            let mut frames = find(root, split, &config)?;
            // The first and last frames of a drive have neither points nor truth.
            frames.retain(|files| cropped || files.depth.is_file());
            if !frames.is_empty() {
                let about = format!("KITTI depth completion, {about}");
                return Ok(Folder::of(about, "kitti", config.scale(), frames));
            }
        }
    }
    Err(no_frame("KITTI depth completion", split, root).hint(
        "known layouts: val_selection_cropped/{image,groundtruth_depth,velodyne_raw}; \
         SPLIT/DRIVE/image_02/data with SPLIT/DRIVE/proj_depth",
    ))
}
