//! DIODE (Vasiljevic et al. 2019) in the layout of its devkit: 1024x768, depths in metres as
//! float32 `.npy`, validity masks as `.npy`.

use super::folder::{FolderConfig, FrameFiles, find};
use super::{Folder, no_frame};
use crate::data::{Environment, Split, check_name};
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::Path;

/// The devkit's list of all frames.
const META: &str = "diode_meta.json";

/// Settings of `dataset = "diode"`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DiodeConfig {
    /// Restricts the dataset to indoor or outdoor frames; both if absent.
    pub place: Option<Environment>,
}

/// Opens a split by `diode_meta.json` if it is in `root`, otherwise by searching the folders.
///
/// # Errors
/// A damaged list, or no frame.
pub(in crate::data) fn diode(root: &Path, split: Split, config: DiodeConfig) -> Result<Folder> {
    let list = root.join(META);
    let listed = list.is_file();
    let mut frames = if listed {
        by_list(root, &list, split)?
    } else {
        by_walking(root, split)?
    };
    frames.retain(|files| config.place.is_none_or(|place| files.place == place));
    if frames.is_empty() {
        return Err(no_frame("DIODE", split, root).hint(
            "expected SPLIT/indoors|outdoor/SCENE/SCAN/FRAME.png with FRAME_depth.npy and \
             FRAME_depth_mask.npy",
        ));
    }
    let how = if listed {
        "by diode_meta.json"
    } else {
        "as found"
    };
    Ok(Folder::of(
        format!("DIODE, {how}"),
        "diode-masked",
        1.0,
        frames,
    ))
}

const PLACES: [(&str, Environment); 2] = [
    ("indoors", Environment::Indoor),
    ("outdoor", Environment::Outdoor),
];

fn by_walking(root: &Path, split: Split) -> Result<Vec<FrameFiles>> {
    let mut frames = Vec::new();
    for (name, place) in PLACES {
        // The devkit's archives unpack to `val/`; its list has the same tree without that folder.
        for prefix in ["{split}/", ""] {
            let stem = format!("{prefix}{name}/{{scene}}/{{scan}}/{{frame}}");
            let config = FolderConfig {
                rgb: format!("{stem}.png"),
                depth: format!("{stem}_depth.npy"),
                mask: Some(format!("{stem}_depth_mask.npy")),
                depth_scale: Some(1.0),
                place,
                ..FolderConfig::default()
            };
            let found = find(root, split, &config)?;
            if !found.is_empty() {
                frames.extend(found.into_iter().map(|files| FrameFiles {
                    id: format!("{name}/{}", last(&files.id)),
                    scene: scene_of(last(&files.id)),
                    ..files
                }));
                break;
            }
        }
    }
    Ok(frames)
}

/// Returns the last part of the name, which includes scene, scan and place.
fn last(id: &str) -> &str {
    id.rsplit('/').next().unwrap_or(id)
}

/// Returns the first part of the frame's own name, as in `00019_00183_indoors_000_010`.
fn scene_of(frame: &str) -> Option<String> {
    frame.split_once('_').map(|(scene, _)| scene.to_owned())
}

fn by_list(root: &Path, list: &Path, split: Split) -> Result<Vec<FrameFiles>> {
    let text = std::fs::read_to_string(list).map_err(|e| Error::read(list, e))?;
    let meta: Value =
        serde_json::from_str(&text).map_err(|e| Error::format(list, "is not JSON").because(e))?;
    let mut frames = Vec::new();
    for (name, place) in PLACES {
        let scenes = meta[split.name()][name].as_object();
        for (scene, scans) in scenes.into_iter().flatten() {
            for (scan, names) in scans.as_object().into_iter().flatten() {
                for frame in names.as_array().into_iter().flatten() {
                    let Some(frame) = frame.as_str() else {
                        return Err(Error::format(list, format!("`{scan}` lists no names")));
                    };
                    for part in [scene, scan, frame] {
                        check_name(part).map_err(|e| Error::format(list, e))?;
                    }
                    let folder = root.join(split.name()).join(name).join(scene).join(scan);
                    frames.push(FrameFiles {
                        id: format!("{name}/{frame}"),
                        scene: scene_of(frame),
                        rgb: folder.join(format!("{frame}.png")),
                        depth: folder.join(format!("{frame}_depth.npy")),
                        mask: Some(folder.join(format!("{frame}_depth_mask.npy"))),
                        place,
                        ..FrameFiles::default()
                    });
                }
            }
        }
    }
    frames.sort_by(|a, b| a.id.cmp(&b.id));
    Ok(frames)
}
