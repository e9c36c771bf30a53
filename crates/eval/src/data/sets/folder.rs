//! Any tree of colour and depth files, described by path templates.

use super::listing::files_below;
use super::template::{Captures, Template};
use crate::data::{
    Dataset, DepthMap, Environment, Frame, FrameId, Split, read_depth, read_mask, read_rgb,
};
use lsdc_files::error::{Error, Result};
use lsdc_files::{has_ending, read_pair};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Paths of the files and storage of depths.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FolderConfig {
    /// Colour files below the root, with names in braces; `{split}` is `train`, or `val` or `test`.
    pub rgb: String,
    /// Depth file of a colour file, by the same names. The same `.h5` file for both means the sparse-to-dense layout: arrays
    /// `rgb` and `depth`. If empty, there are only images, for training with a teacher.
    pub depth: String,
    /// File of sparse depths, by the same names, if there is one.
    pub sparse: Option<String>,
    /// File of the validity mask, by the same names, if there is one.
    pub mask: Option<String>,
    /// Metres per stored unit. If absent, 0.001 for PNG and PGM (millimetres), 1 for other files.
    pub depth_scale: Option<f64>,
    /// Whether the frames were taken indoors or outdoors.
    pub place: Environment,
}

impl Default for FolderConfig {
    fn default() -> Self {
        Self {
            rgb: "{split}/{frame}.jpg".into(),
            depth: "{split}/{frame}_depth.png".into(),
            sparse: None,
            mask: None,
            depth_scale: None,
            place: Environment::Indoor,
        }
    }
}

impl FolderConfig {
    /// Returns the metres per stored unit.
    pub(super) fn scale(&self) -> f64 {
        let millimetres = ["png", "pgm"]
            .into_iter()
            .any(|ending| has_ending(Path::new(&self.depth), ending));
        let usual = if millimetres { 0.001 } else { 1.0 };
        self.depth_scale.unwrap_or(usual)
    }
}

/// The files of one frame.
#[derive(Clone, Debug, Default)]
pub(super) struct FrameFiles {
    pub(super) id: FrameId,
    /// Scene, if it is not a folder in the name.
    pub(super) scene: Option<String>,
    pub(super) rgb: PathBuf,
    /// Empty if there is none.
    pub(super) depth: PathBuf,
    pub(super) sparse: Option<PathBuf>,
    pub(super) mask: Option<PathBuf>,
    pub(super) place: Environment,
}

impl FrameFiles {
    fn has_depth(&self) -> bool {
        !self.depth.as_os_str().is_empty()
    }
}

/// Frames of a folder, sorted by name.
#[derive(Debug)]
pub struct Folder {
    about: String,
    protocol: &'static str,
    depth_scale: f64,
    frames: Vec<FrameFiles>,
}

impl Folder {
    /// Lists the frames of `split` below `root`. A template without `{split}` applies to every split.
    ///
    /// # Errors
    /// An unreadable folder, a broken template, or no frame at all.
    pub fn open(root: &Path, split: Split, config: &FolderConfig) -> Result<Self> {
        let frames = find(root, split, config)?;
        if frames.is_empty() {
            return Err(Error::config(format!(
                "no `{}` frame of the form `{}` in `{}`",
                split.name(),
                config.rgb,
                root.display()
            ))
            .hint("check --root and --split"));
        }
        let scale = config.scale();
        let about = if config.depth.is_empty() {
            format!("folder `{}`, images alone", config.rgb)
        } else {
            format!("folder `{}`, depths in units of {scale} m", config.rgb)
        };
        Ok(Self::of(about, "full", scale, frames))
    }

    /// Creates a dataset from frames listed by other means.
    pub(super) fn of(
        about: String,
        protocol: &'static str,
        depth_scale: f64,
        frames: Vec<FrameFiles>,
    ) -> Self {
        Self {
            about,
            protocol,
            depth_scale,
            frames,
        }
    }
}

/// Returns the frames of `split` below `root` that match the templates; an empty result is not an error.
pub(super) fn find(root: &Path, split: Split, config: &FolderConfig) -> Result<Vec<FrameFiles>> {
    let rgb = Template::new(&config.rgb)?;
    let depth = (!config.depth.is_empty()).then(|| Template::new(&config.depth));
    let depth = depth.transpose()?;
    let optional = |text: &Option<String>| text.as_deref().map(Template::new).transpose();
    let (sparse, mask) = (optional(&config.sparse)?, optional(&config.mask)?);
    let mut frames = Vec::new();
    for path in files_below(root, Some(rgb.depth()))? {
        let Some(captures) = rgb.captures(&path) else {
            continue;
        };
        if captures.get("split").is_some_and(|s| !split.is_called(s)) {
            continue;
        }
        let other = |template: &Option<Template>| -> Result<Option<PathBuf>> {
            let filled = template.as_ref().map(|t| t.fill(&captures)).transpose()?;
            Ok(filled.map(|path| root.join(path)))
        };
        frames.push(FrameFiles {
            id: id(&captures),
            scene: None,
            rgb: root.join(&path),
            depth: other(&depth)?.unwrap_or_default(),
            sparse: other(&sparse)?,
            mask: other(&mask)?,
            place: config.place,
        });
    }
    // A loose template for colour files may also match other files.
    let others: BTreeSet<PathBuf> = frames
        .iter()
        .flat_map(|f| [Some(&f.depth), f.sparse.as_ref(), f.mask.as_ref()])
        .flatten()
        .cloned()
        .collect();
    let pairs = config.rgb == config.depth;
    frames.retain(|files| pairs || !others.contains(&files.rgb));
    Ok(frames)
}

/// Returns the name of a frame: the captured texts, without the split.
fn id(captures: &Captures) -> FrameId {
    let texts: Vec<&str> = captures
        .iter()
        .filter(|(name, _)| *name != "split" && *name != "frame")
        .chain(captures.get_key_value("frame"))
        .map(|(_, text)| text.as_str())
        .collect();
    texts.join("/")
}

impl Dataset for Folder {
    fn description(&self) -> String {
        self.about.clone()
    }

    fn protocol(&self) -> &'static str {
        self.protocol
    }

    fn has_depth(&self) -> bool {
        self.frames.iter().all(FrameFiles::has_depth)
    }

    fn len(&self) -> usize {
        self.frames.len()
    }

    fn scene(&self, index: usize) -> Option<String> {
        self.frames[index].scene.clone()
    }

    fn id(&self, index: usize) -> FrameId {
        self.frames[index].id.clone()
    }

    fn files(&self, index: usize) -> Vec<PathBuf> {
        let files = &self.frames[index];
        let depth = Some(&files.depth).filter(|_| files.has_depth());
        let others = depth.into_iter().chain(&files.sparse).chain(&files.mask);
        std::iter::once(&files.rgb).chain(others).cloned().collect()
    }

    fn load(&self, index: usize) -> Result<Frame> {
        let files = &self.frames[index];
        let (rgb, depth) = if files.rgb == files.depth && has_ending(&files.rgb, "h5") {
            read_pair(&files.rgb)?
        } else {
            let rgb = read_rgb(&files.rgb)?;
            let depth = if files.has_depth() {
                read_depth(&files.depth, self.depth_scale)?
            } else {
                DepthMap::from_points(rgb.width() as usize, rgb.height() as usize, &[])
            };
            (rgb, depth)
        };
        let mut frame = Frame::new(files.id.clone(), rgb, depth)?;
        frame.place = files.place;
        if let Some(path) = &files.sparse {
            frame = frame.with_sparse(read_depth(path, self.depth_scale)?)?;
        }
        if let Some(path) = &files.mask {
            let (width, height, valid) = read_mask(path)?;
            frame = frame.with_mask(width, height, valid)?;
        }
        Ok(frame)
    }
}
