//! NYU Depth v2 (Silberman, Hoiem, Kohli, Fergus 2012) in its published forms. The files at the given path determine the form.
//!
//! Frames of the official test split have the same name, their official number, in every form. Hence they get the same sparse
//! points.

mod crops;
mod labelled;
mod official;

use super::folder::{FolderConfig, FrameFiles, find};
use super::{Folder, no_frame};
use crate::data::{Dataset, Split};
use lsdc_files::error::{Error, Result};
use lsdc_files::has_ending;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// Kind of depths in `nyu_depth_v2_labeled.mat`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Depths {
    /// Holes of the sensor filled by colorisation: the convention for evaluation. A network with an RMSE of 0.09 m on these has
    /// 0.46 m on raw ones (NLSPN, issue 40).
    #[default]
    Filled,
    /// Raw depths of the sensor, projected to the colour image.
    Raw,
}

/// Settings of `dataset = "nyu"`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NyuConfig {
    /// Which depths of `nyu_depth_v2_labeled.mat` to read; other forms have only one kind.
    pub depths: Depths,
}

/// A tree of files, one or two per frame.
struct Tree {
    about: &'static str,
    rgb: &'static str,
    depth: &'static str,
    /// Offset from a frame's number to its official number.
    official_offset: usize,
}

const TREES: [Tree; 6] = [
    Tree {
        about: "sparse-to-dense HDF5 tree, filled depths",
        rgb: "{split}/{scene}/{frame}.h5",
        depth: "{split}/{scene}/{frame}.h5",
        official_offset: 0,
    },
    Tree {
        about: "tree of JPEG and 16-bit PNG",
        rgb: "{split}/{scene}/{frame}.jpg",
        depth: "{split}/{scene}/{frame}_depth.png",
        official_offset: 0,
    },
    Tree {
        about: "BTS tree, depths of the synchronised frames",
        rgb: "{split}/{scene}/rgb_{frame}.jpg",
        depth: "{split}/{scene}/sync_depth_{frame}.png",
        official_offset: 1,
    },
    Tree {
        about: "BTS tree, depths of the synchronised frames",
        rgb: "{scene}/rgb_{frame}.jpg",
        depth: "{scene}/sync_depth_{frame}.png",
        official_offset: 1,
    },
    Tree {
        about: "Marigold tree of PNG, filled depths",
        rgb: "{split}/{scene}/rgb_{frame}.png",
        depth: "{split}/{scene}/filled_{frame}.png",
        official_offset: 0,
    },
    Tree {
        about: "DenseDepth `nyu2_test`",
        rgb: "{frame}_colors.png",
        depth: "{frame}_depth.png",
        official_offset: 1,
    },
];

/// Opens the dataset in the form found at `root`: a folder, or the `.mat` or `.h5` file itself.
///
/// # Errors
/// None of the known forms, or a damaged file.
pub(in crate::data) fn nyu(
    root: &Path,
    split: Split,
    config: NyuConfig,
) -> Result<Arc<dyn Dataset>> {
    if let Some(path) = only_file(root, "mat")? {
        return Ok(Arc::new(labelled::Labelled::open(
            &path,
            split,
            config.depths,
        )?));
    }
    if let Some(path) = crops::Crops::folder_of(root) {
        return Ok(Arc::new(crops::Crops::open(&path)?));
    }
    if root.is_file() {
        return Err(unknown_layout(root, split));
    }
    for tree in &TREES {
        let config = FolderConfig {
            rgb: tree.rgb.into(),
            depth: tree.depth.into(),
            ..FolderConfig::default()
        };
        let mut frames = find(root, split, &config)?;
        if !frames.is_empty() {
            use_official_names(&mut frames, tree, split);
            let about = format!("NYU Depth v2, {}", tree.about);
            return Ok(Arc::new(Folder::of(about, "nyu", config.scale(), frames)));
        }
    }
    Err(unknown_layout(root, split))
}

/// Renames the frames of the official test split to their official numbers. A number that occurs in two scenes is not the
/// official one, and those frames keep their names.
fn use_official_names(frames: &mut [FrameFiles], tree: &Tree, split: Split) {
    let official = |files: &FrameFiles| {
        let number: usize = files.id.rsplit('/').next()?.parse().ok()?;
        let number = number.checked_add(tree.official_offset)?;
        (split == Split::Val && official::is_test(number)).then_some(number)
    };
    let numbers: Vec<Option<usize>> = frames.iter().map(official).collect();
    let mut counts = HashMap::new();
    for number in numbers.iter().flatten() {
        *counts.entry(*number).or_insert(0_usize) += 1;
    }
    for (files, number) in frames.iter_mut().zip(numbers) {
        if let Some(number) = number.filter(|number| counts[number] == 1) {
            files.id = official::name(number);
        }
    }
}

/// Returns the file itself, or the only file with this extension in the folder.
fn only_file(root: &Path, ending: &str) -> Result<Option<std::path::PathBuf>> {
    if root.is_file() {
        return Ok(has_ending(root, ending).then(|| root.to_owned()));
    }
    let entries = std::fs::read_dir(root).map_err(|e| Error::read(root, e))?;
    let mut found = entries
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.is_file() && has_ending(path, ending));
    let first = found.next();
    Ok(first.filter(|_| found.next().is_none()))
}

fn unknown_layout(root: &Path, split: Split) -> Error {
    no_frame("NYU Depth v2", split, root).hint(
        "known forms: nyu_depth_v2_labeled.mat; SPLIT/SCENE/FRAME.h5 (sparse-to-dense); \
         SPLIT/SCENE/FRAME.jpg with FRAME_depth.png; SCENE/rgb_N.jpg with sync_depth_N.png (BTS); \
         SPLIT/SCENE/rgb_N.png with filled_N.png (Marigold); N_colors.png with N_depth.png \
         (DenseDepth); nyu_img_gt.h5 (Conti). Others: --dataset folder",
    )
}
