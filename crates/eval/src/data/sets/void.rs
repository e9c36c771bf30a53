//! VOID (Wong et al. 2020): 640x480 with the points of a visual-inertial odometry, 16-bit PNG,
//! metres = value / 256.

use super::folder::{FolderConfig, find};
use super::{Folder, no_frame};
use crate::data::Split;
use lsdc_files::error::{Error, Result};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Opens `root/data/<sequence>/{image,sparse_depth,ground_truth,validity_map}/<frame>.png`, where `root` is one of `void_150`,
/// `void_500` and `void_1500`. The frames of a split are listed in `train_image.txt` or `test_image.txt`, if the list exists.
///
/// # Errors
/// No frame, or a list that cannot be read.
pub(in crate::data) fn void(root: &Path, split: Split) -> Result<Folder> {
    let stem = |kind: &str| format!("data/{{sequence}}/{kind}/{{frame}}.png");
    let config = FolderConfig {
        rgb: stem("image"),
        depth: stem("ground_truth"),
        sparse: Some(stem("sparse_depth")),
        depth_scale: Some(1.0 / 256.0),
        ..FolderConfig::default()
    };
    let mut frames = find(root, split, &config)?;
    let list = root.join(match split {
        Split::Train => "train_image.txt",
        Split::Val => "test_image.txt",
    });
    let listed = list.is_file();
    if listed {
        let text = std::fs::read_to_string(&list).map_err(|e| Error::read(&list, e))?;
        let names: BTreeSet<PathBuf> = text
            .lines()
            .map(|line| last_three(line.trim().as_ref()))
            .collect();
        frames.retain(|files| names.contains(&last_three(&files.rgb)));
    }
    if frames.is_empty() {
        return Err(no_frame("VOID", split, root)
            .hint("give the folder of one density: void_release/void_1500"));
    }
    let how = if listed { "by its list" } else { "all frames" };
    Ok(Folder::of(
        format!("VOID, {how}"),
        "void",
        config.scale(),
        frames,
    ))
}

/// Returns sequence, kind and file, which the list and the folders have in common.
fn last_three(path: &Path) -> PathBuf {
    let mut parts: Vec<_> = path.components().rev().take(3).collect();
    parts.reverse();
    parts.into_iter().collect()
}
