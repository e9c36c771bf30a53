//! Depth maps in a folder, each with its standard deviations, camera, pose and image.

use crate::cli::args::Fuse;
use image::RgbImage;
use image::imageops::{FilterType, resize};
use lsdc_eval::data::{Contents, DepthMap, StoredMap, images_below, read_npy, read_upright};
use lsdc_files::Poses;
use lsdc_files::error::{Error, Result};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Endings of depth maps written by `lsdc complete`; those that include standard deviations first.
const DEPTHS: [&str; 6] = [
    "_depth.npz",
    "_depth.exr",
    "_depth.npy",
    "_depth.tiff",
    "_depth.pfm",
    "_depth.png",
];
const DEVIATIONS: &str = "_sigma.npy";
/// Extensions of other depth maps.
const OTHERS: [&str; 7] = ["npz", "exr", "npy", "tiff", "tif", "pfm", "png"];

/// A frame before it is read.
#[derive(Clone, Debug)]
pub(super) struct Source {
    /// Path relative to the folder, without extension.
    pub(super) name: String,
    depth: PathBuf,
    deviation: Option<PathBuf>,
    image: Option<PathBuf>,
}

/// A frame that was read.
pub(super) struct Loaded {
    pub(super) depth: DepthMap,
    pub(super) deviation: Option<DepthMap>,
    /// Camera with its pose.
    pub(super) camera: lsdc_core::Camera,
    /// Image, resized to the depth map.
    pub(super) image: Option<RgbImage>,
    pub(super) remarks: Vec<String>,
}

/// The frames of a folder in the order of their names, with their images.
///
/// # Errors
/// A folder that cannot be read or has no frames, a frame without an image.
pub(super) fn sources(folder: &Path, images: Option<&Path>) -> Result<Vec<Source>> {
    let mut files = Vec::new();
    walk(folder, folder, &mut files)?;
    let of_results = |(name, path): &(String, PathBuf)| {
        let found = DEPTHS.iter().enumerate();
        let mut found = found.filter_map(|(rank, end)| Some((name.strip_suffix(end)?, rank)));
        found
            .next()
            .map(|(frame, rank)| (frame.to_owned(), rank, path.clone()))
    };
    let others = |(name, path): &(String, PathBuf)| {
        let (frame, ending) = name.rsplit_once('.')?;
        let rank = OTHERS
            .iter()
            .position(|own| ending.eq_ignore_ascii_case(own))?;
        Some((frame.to_owned(), rank, path.clone()))
    };
    let mut found: Vec<(String, usize, PathBuf)> = files.iter().filter_map(of_results).collect();
    if found.is_empty() {
        found = files.iter().filter_map(others).collect();
    }
    if found.is_empty() {
        return Err(Error::format(folder, "has no depth maps")
            .hint("give the folder that `lsdc complete` wrote its results to"));
    }
    // Of several files of a frame, the first in the order of the endings is kept.
    found.sort();
    found.dedup_by(|later, kept| later.0 == kept.0);
    let names: BTreeMap<&str, &PathBuf> = files.iter().map(|(n, p)| (&n[..], p)).collect();
    let images = images.map(Images::below).transpose()?;
    let source = |(name, _, depth): (String, usize, PathBuf)| {
        let image = images.as_ref().map(|images| images.of(&name)).transpose()?;
        let deviation = names.get(&format!("{name}{DEVIATIONS}")[..]);
        Ok(Source {
            deviation: deviation.map(|path| (*path).clone()),
            name,
            depth,
            image,
        })
    };
    found.into_iter().map(source).collect()
}

/// Adds the files below a folder with their names below `root`. Hidden folders hold records of results.
fn walk(root: &Path, folder: &Path, files: &mut Vec<(String, PathBuf)>) -> Result<()> {
    let unreadable = |e| Error::read(folder, e);
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let path = entry.path();
        if entry.file_name().to_string_lossy().starts_with('.') {
            continue;
        }
        // Links to folders are not followed: they may lead back.
        if entry.file_type().map_err(unreadable)?.is_dir() {
            walk(root, &path, files)?;
        } else if let Ok(name) = path.strip_prefix(root) {
            files.push((name.to_string_lossy().replace('\\', "/"), path));
        }
    }
    Ok(())
}

/// Images by their names below a folder, without endings.
struct Images<'a> {
    folder: &'a Path,
    paths: BTreeMap<PathBuf, PathBuf>,
}

impl<'a> Images<'a> {
    fn below(folder: &'a Path) -> Result<Self> {
        let named = |path: PathBuf| {
            let name = path.strip_prefix(folder).ok()?.with_extension("");
            Some((name, path))
        };
        let paths = images_below(folder)?.into_iter().filter_map(named);
        Ok(Self {
            folder,
            paths: paths.collect(),
        })
    }

    fn of(&self, name: &str) -> Result<PathBuf> {
        self.paths.get(Path::new(name)).cloned().ok_or_else(|| {
            Error::format(self.folder, format!("has no image of frame `{name}`"))
                .hint("images and results have the same names; leave --images out for a surface without colours")
        })
    }
}

impl Source {
    /// Reads the frame.
    ///
    /// # Errors
    /// Files that are damaged, of different sizes, or no depth maps; a camera that is missing or of another shape.
    pub(super) fn load(&self, poses: &Poses, args: &Fuse) -> Result<Loaded> {
        let Contents::Map(map) = Contents::read(&self.depth, args.depth_unit)? else {
            return Err(Error::format(&self.depth, "is no depth map"));
        };
        let StoredMap {
            depth,
            sigma,
            remarks,
            ..
        } = *map;
        let size = (depth.width(), depth.height());
        let deviation = match &self.deviation {
            Some(path) if sigma.is_none() => Some(read_npy(path, 1.0)?),
            _ => sigma,
        };
        let mut image = None;
        if let Some(path) = &self.image {
            let read = read_upright(path)?;
            if !read.orientation.is_upright() {
                return Err(Error::format(
                    path,
                    "is turned by its EXIF orientation, which `fuse` does not read",
                )
                .hint("store images upright before they are completed"));
            }
            let (width, height) = (size.0 as u32, size.1 as u32);
            image = Some(if read.rgb.dimensions() == (width, height) {
                read.rgb
            } else {
                resize(&read.rgb, width, height, FilterType::Triangle)
            });
        }
        let camera = args.camera.as_ref().or_else(|| poses.camera(&self.name));
        let camera = camera.ok_or_else(|| {
            Error::config(format!("frame `{}` has no camera", self.name))
                .hint("give --camera FILE or --camera FX,FY,CX,CY")
        })?;
        let pose = poses
            .of(&self.name)
            .ok_or_else(|| Error::config(format!("frame `{}` has no pose", self.name)))?;
        let camera = camera
            .resized(size)?
            .with_pose(pose.rotation, pose.translation);
        Ok(Loaded {
            depth,
            deviation,
            camera: camera.optics().clone(),
            image,
            remarks: remarks.into_iter().chain(camera.warnings()).collect(),
        })
    }
}
