//! Any tree of colour and depth files, described by two path templates.

use super::template::{Captures, Template};
use super::{Dataset, Frame, FrameId, Split, read_depth_png, read_npy, read_rgb};
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Where the files lie and how depths are stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FolderConfig {
    /// Colour files below the root, with names in braces; `{split}` is `train` or `val`.
    pub rgb: String,
    /// The depth file of a colour file, by the same names.
    pub depth: String,
    /// Metres per stored unit: 0.001 for millimetres in PNG, 1 for metres in npy.
    pub depth_scale: f32,
}

impl Default for FolderConfig {
    fn default() -> Self {
        Self {
            rgb: "{split}/{frame}.jpg".into(),
            depth: "{split}/{frame}_depth.png".into(),
            depth_scale: 0.001,
        }
    }
}

/// Frames of a folder, in the order of their names.
#[derive(Debug)]
pub struct Folder {
    root: PathBuf,
    depth_scale: f32,
    frames: Vec<(FrameId, String, String)>,
}

impl Folder {
    /// Lists the frames of `split` below `root`. A template without `{split}` serves every split.
    ///
    /// # Errors
    /// An unreadable folder, a broken template, or no frame at all.
    pub fn open(root: &Path, split: Split, config: &FolderConfig) -> Result<Self> {
        let rgb = Template::new(&config.rgb)?;
        let depth = Template::new(&config.depth)?;
        let mut paths = Vec::new();
        list(root, "", rgb.depth(), &mut paths)?;
        paths.sort_unstable();
        let mut frames = Vec::new();
        for path in paths {
            let Some(captures) = rgb.captures(&path) else {
                continue;
            };
            if captures.get("split").is_some_and(|s| s != split.name()) {
                continue;
            }
            frames.push((id(&captures), path, depth.fill(&captures)?));
        }
        if frames.is_empty() {
            return Err(Error::config(format!(
                "no `{}` frame of the form `{}` in `{}`",
                split.name(),
                config.rgb,
                root.display()
            ))
            .hint("check --root and --split"));
        }
        Ok(Self {
            root: root.to_owned(),
            depth_scale: config.depth_scale,
            frames,
        })
    }
}

/// A frame is named by what its names stand for, without the split.
fn id(captures: &Captures) -> FrameId {
    let texts: Vec<&str> = captures
        .iter()
        .filter(|(name, _)| *name != "split" && *name != "frame")
        .chain(captures.get_key_value("frame"))
        .map(|(_, text)| text.as_str())
        .collect();
    texts.join("/")
}

/// All files `levels` deep below `root`, as paths relative to it.
fn list(root: &Path, below: &str, levels: usize, paths: &mut Vec<String>) -> Result<()> {
    let folder = root.join(below);
    for entry in std::fs::read_dir(&folder).map_err(|e| Error::read(&folder, e))? {
        let entry = entry.map_err(|e| Error::read(&folder, e))?;
        let Ok(name) = entry.file_name().into_string() else {
            continue;
        };
        let path = if below.is_empty() {
            name
        } else {
            format!("{below}/{name}")
        };
        let is_dir = entry.path().is_dir();
        if levels > 1 && is_dir {
            list(root, &path, levels - 1, paths)?;
        } else if levels == 1 && !is_dir {
            paths.push(path);
        }
    }
    Ok(())
}

impl Dataset for Folder {
    fn len(&self) -> usize {
        self.frames.len()
    }

    fn id(&self, index: usize) -> FrameId {
        self.frames[index].0.clone()
    }

    fn load(&self, index: usize) -> Result<Frame> {
        let (id, rgb, depth) = &self.frames[index];
        let rgb = read_rgb(&self.root.join(rgb))?;
        let path = self.root.join(depth);
        let depth = if path.extension().is_some_and(|e| e == "npy") {
            read_npy(&path, self.depth_scale)?
        } else {
            read_depth_png(&path, self.depth_scale)?
        };
        let (width, height) = (rgb.width() as usize, rgb.height() as usize);
        if (width, height) != (depth.width(), depth.height()) {
            return Err(Error::shape(format!(
                "`{}` is {}x{} but its colour image is {width}x{height}",
                path.display(),
                depth.width(),
                depth.height()
            )));
        }
        Ok(Frame {
            id: id.clone(),
            rgb,
            depth,
        })
    }
}
