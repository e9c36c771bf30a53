//! Workspaces of programs that use dense depth: COLMAP's dense stage, 3-D Gaussian splatting and nerfstudio.
//!
//! A workspace is a folder with the images and cameras of a sparse model and a depth map for each image, laid out as the
//! program expects. Depths stay in the unit of the model, as poses and points do. 0 means no depth.

mod colmap;
mod nerfstudio;
mod normals;
mod splatting;

use crate::camera::Camera;
use crate::colmap::{Colmap, View};
use crate::error::{Error, Result};
use crate::files::{image_size, link_or_copy, remove_leftovers, write_atomically};
use lsdc_core::{DepthMap, Lens};
use nerfstudio::DepthFormat;
use serde::Serialize;
use splatting::InverseDepth;
use std::collections::{HashMap, HashSet};
use std::ffi::OsString;
use std::fmt::{Display, Formatter};
use std::path::{Component, Path, PathBuf};
use std::str::FromStr;

/// File that marks a folder as a workspace written by this library, which may be continued.
const MARKER: &str = ".lsdc-workspace";

/// Folder of images in every workspace.
const IMAGES: &str = "images";

/// The program that a workspace is written for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum WorkspaceFormat {
    /// COLMAP's dense stage: `stereo_fusion`, `poisson_mesher`, `delaunay_mesher`.
    Colmap,
    /// 3-D Gaussian splatting as published (graphdeco-inria/gaussian-splatting), option `-d`.
    Splatting,
    /// nerfstudio: `transforms.json` with `depth_file_path`.
    Nerfstudio,
}

impl WorkspaceFormat {
    /// All formats, in the order of their documentation.
    pub const ALL: [Self; 3] = [Self::Colmap, Self::Splatting, Self::Nerfstudio];

    /// Returns the name in arguments, which is also that of the folder of the workspace.
    pub fn name(self) -> &'static str {
        match self {
            Self::Colmap => "colmap",
            Self::Splatting => "splatting",
            Self::Nerfstudio => "nerfstudio",
        }
    }
}

impl Display for WorkspaceFormat {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for WorkspaceFormat {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let mut formats = Self::ALL.into_iter();
        formats.find(|format| format.name() == text).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            Error::config(format!("there is no export `{text}`")).hint(format!("exports: {names}"))
        })
    }
}

/// A workspace of a sparse model, which is filled image by image, in any order and by any number of processes.
///
/// ```no_run
/// use lsdc_files::{Colmap, DepthMap, WorkspaceFormat, Workspace};
/// # fn main() -> lsdc_files::error::Result<()> {
/// let model = Colmap::read("sparse/0".as_ref())?;
/// let workspace = Workspace::new(WorkspaceFormat::Colmap, "dense".into(), "sparse/0".as_ref(), &model)?;
/// workspace.create(false)?;
/// for view in &model.views {
///     let depth = DepthMap::new(view.size.0, view.size.1, vec![2.0; view.size.0 * view.size.1])?;
///     let frame = workspace.encode(&view.name, &depth, view.camera.as_ref())?;
///     workspace.write(&frame, &std::path::Path::new("images").join(&view.name), false)?;
/// }
/// let images = workspace.finish()?;
/// println!("{} images, {} without depth", images.with_depth, images.without_depth);
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Workspace {
    folder: PathBuf,
    /// The folder of the sparse model.
    model: PathBuf,
    /// Images of the model, by name.
    views: Vec<PosedView>,
    index: HashMap<String, usize>,
    coding: Coding,
}

/// An image of the model with its camera at its pose.
#[derive(Debug)]
struct PosedView {
    name: String,
    size: (usize, usize),
    camera: Camera,
}

/// Storage format of depths.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Coding {
    Colmap,
    Splatting(InverseDepth),
    Nerfstudio(DepthFormat),
}

/// The encoded depth of an image.
#[derive(Clone, Debug)]
pub struct WorkspaceFrame {
    view: usize,
    /// Paths below the folder of the workspace, with their contents.
    files: Vec<(PathBuf, Vec<u8>)>,
    /// Counts of pixels that are not stored as their depth.
    pub counts: WorkspaceCounts,
}

/// Counts of pixels of an image that a workspace does not store as their depth.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct WorkspaceCounts {
    /// Pixels without depth: 0 in the workspace.
    pub empty: usize,
    /// Pixels with too few neighbours with depth for a normal (COLMAP): the normal is 0.
    pub without_normal: usize,
    /// Pixels farther than a 16-bit format can store: clamped to its farthest depth.
    pub farthest: usize,
    /// Pixels nearer than a 16-bit format can store: clamped to its nearest depth.
    pub nearest: usize,
}

impl WorkspaceCounts {
    /// Returns the larger of each count of two workspaces of an image.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self {
            empty: self.empty.max(other.empty),
            without_normal: self.without_normal.max(other.without_normal),
            farthest: self.farthest.max(other.farthest),
            nearest: self.nearest.max(other.nearest),
        }
    }

    /// Adds the counts of another image.
    pub fn add(&mut self, other: Self) {
        self.empty += other.empty;
        self.without_normal += other.without_normal;
        self.farthest += other.farthest;
        self.nearest += other.nearest;
    }
}

/// The images of a workspace after [`Workspace::finish`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WorkspaceImages {
    /// Number of images with depth.
    pub with_depth: usize,
    /// Number of images of the model without depth: not completed yet, or without files.
    pub without_depth: usize,
}

impl Workspace {
    /// Creates a workspace in `folder` for the sparse model that was read from `model_folder`. Nothing is written.
    ///
    /// # Errors
    /// A camera is unsupported by the program; for splatting, names of images differ only in their extensions, or the model
    /// has no points.
    pub fn new(
        format: WorkspaceFormat,
        folder: PathBuf,
        model_folder: &Path,
        model: &Colmap,
    ) -> Result<Self> {
        let wrong = |what: String| Error::format(model_folder, what);
        let coding = match format {
            WorkspaceFormat::Colmap => Coding::Colmap,
            WorkspaceFormat::Splatting => {
                check_stems(&model.views).map_err(wrong)?;
                let nearest = depth_range(&model.views).map(|[nearest, _]| nearest);
                let nearest = nearest.ok_or_else(|| {
                    wrong("no image sees a point, so the range of depths is unknown".to_owned())
                })?;
                Coding::Splatting(InverseDepth::of_nearest(nearest))
            }
            WorkspaceFormat::Nerfstudio => {
                let range = depth_range(&model.views);
                Coding::Nerfstudio(DepthFormat::of_range(range))
            }
        };
        let views = model.views.iter().map(|view| {
            let camera = usable(format, view.camera.as_ref()).map_err(|what| {
                wrong(format!("{format} cannot use the camera of `{}`: {what}", view.name))
                    .hint("`colmap image_undistorter` makes images and a model without distortion: give its folders images and sparse")
            })?;
            Ok(PosedView {
                name: view.name.clone(),
                size: view.size,
                camera,
            })
        });
        let views: Vec<PosedView> = views.collect::<Result<_>>()?;
        let lenses = views.iter().map(|view| view.camera.optics().lens());
        if format == WorkspaceFormat::Nerfstudio && nerfstudio::is_mixed(lenses) {
            let what = "has fisheye cameras beside others, which nerfstudio does not";
            return Err(wrong(what.to_owned()).hint("make a model of each kind of camera"));
        }
        let names = views.iter().enumerate();
        Ok(Self {
            index: names.map(|(i, view)| (view.name.clone(), i)).collect(),
            folder,
            model: model_folder.to_owned(),
            views,
            coding,
        })
    }

    /// Whether a folder is a workspace written by this library.
    pub fn is_at(folder: &Path) -> bool {
        folder.join(MARKER).is_file()
    }

    /// Returns the program.
    pub fn format(&self) -> WorkspaceFormat {
        match self.coding {
            Coding::Colmap => WorkspaceFormat::Colmap,
            Coding::Splatting(_) => WorkspaceFormat::Splatting,
            Coding::Nerfstudio(_) => WorkspaceFormat::Nerfstudio,
        }
    }

    /// Returns the folder of the workspace.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Creates the folder, or continues a workspace for the same program. `replace` allows a folder of other contents.
    ///
    /// # Errors
    /// The folder has other contents and `replace` is not set, or it cannot be written.
    pub fn create(&self, replace: bool) -> Result<()> {
        let folder = &self.folder;
        let marker = folder.join(MARKER);
        let text = format!("{}\n", self.format());
        if std::fs::read_to_string(&marker).is_ok_and(|found| found == text) {
            self.remove_leftovers();
            return Ok(());
        }
        let is_used = std::fs::read_dir(folder).is_ok_and(|mut files| files.next().is_some());
        if is_used && !replace {
            let what = format!(
                "`{}` exists and is no workspace by lsdc for {}",
                folder.display(),
                self.format()
            );
            return Err(
                Error::config(what).hint("give --force to write into it, or another folder")
            );
        }
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        write_atomically(&marker, |out| out.write_all(text.as_bytes()))
    }

    /// Removes files that interrupted writers left in the folders of images and depths.
    fn remove_leftovers(&self) {
        let files = self.views.iter().enumerate().flat_map(|(view, posed)| {
            let depths = self.paths(&posed.name).map(|path| self.folder.join(path));
            depths.chain([self.image(view)])
        });
        let folders = files.filter_map(|file| file.parent().map(Path::to_owned));
        let folders: HashSet<PathBuf> = folders.collect();
        for folder in &folders {
            remove_leftovers(folder);
        }
    }

    /// Whether the image of this name and its depth are in the workspace.
    pub fn has(&self, name: &str) -> bool {
        self.index.get(name).is_some_and(|&view| {
            let mut files = self.paths(name);
            self.image(view).is_file() && files.all(|path| self.folder.join(path).is_file())
        })
    }

    /// Whether any depth file of the image of this name is in the workspace.
    pub fn has_any(&self, name: &str) -> bool {
        self.paths(name)
            .any(|path| self.folder.join(path).is_file())
    }

    /// Encodes the depth of an image. `depth` is of any size, in the unit of the model, and upright. `camera` is the camera
    /// of the upright image; it undoes EXIF orientations, because programs read the pixels as stored.
    ///
    /// # Errors
    /// The name is not in the model or leads out of the folder, or the format cannot store a depth.
    pub fn encode(
        &self,
        name: &str,
        depth: &DepthMap,
        camera: Option<&Camera>,
    ) -> Result<WorkspaceFrame> {
        let view = *self.index.get(name).ok_or_else(|| {
            Error::config(format!("`{}` has no image `{name}`", self.model.display()))
        })?;
        let inside = |part| matches!(part, Component::Normal(_));
        if !Path::new(name).components().all(inside) {
            return Err(Error::config(format!(
                "the name of image `{name}` leads out of the workspace"
            ))
            .hint("name the images of the model by their paths below one folder"));
        }
        let stored;
        let depth = match camera {
            Some(camera) => {
                stored = camera.as_stored(depth)?;
                stored.as_ref().unwrap_or(depth)
            }
            None => depth,
        };
        let mut counts = WorkspaceCounts {
            empty: depth.values().len() - depth.count(),
            ..WorkspaceCounts::default()
        };
        let contents = match self.coding {
            Coding::Colmap => {
                let size = (depth.width(), depth.height());
                let intrinsics = self.views[view].camera.stretched(size).intrinsics();
                let (maps, without_normal) = colmap::maps(depth, intrinsics);
                counts.without_normal = without_normal;
                maps.to_vec()
            }
            Coding::Splatting(code) => {
                let (values, [nearest, farthest]) = code.encode(depth);
                counts.nearest = nearest;
                counts.farthest = farthest;
                vec![code.png(depth, &values)?]
            }
            Coding::Nerfstudio(format) => {
                let along_rays = nerfstudio::along_rays(depth, &self.views[view].camera)?;
                let depth = along_rays.as_ref().unwrap_or(depth);
                counts.empty = depth.values().len() - depth.count();
                let (bytes, [nearest, farthest]) = format.encode(depth)?;
                counts.nearest = nearest;
                counts.farthest = farthest;
                vec![bytes]
            }
        };
        Ok(WorkspaceFrame {
            view,
            files: self.paths(name).zip(contents).collect(),
            counts,
        })
    }

    /// Writes the depth of an image, and links `image` into the workspace, or copies it if the file system does not support
    /// links.
    /// Existing files are replaced only by equal ones, unless `replace` is set.
    ///
    /// # Errors
    /// Existing files that differ, an image of another size than that of the model, or files that cannot be written.
    pub fn write(&self, frame: &WorkspaceFrame, image: &Path, replace: bool) -> Result<()> {
        let view = &self.views[frame.view];
        let (width, height) = image_size(image)?;
        if (width, height) != view.size {
            let (w, h) = view.size;
            let what = format!(
                "`{}` is {width}x{height}, but {w}x{h} in the model",
                image.display()
            );
            return Err(Error::shape(what).hint("give the images that the model was made of"));
        }
        let target = self.image(frame.view);
        let files = frame.files.iter();
        let files: Vec<(PathBuf, &[u8])> = files
            .map(|(path, bytes)| (self.folder.join(path), bytes.as_slice()))
            .collect();
        let differs = |path: &Path, bytes: &[u8]| {
            path.symlink_metadata().is_ok() && std::fs::read(path).ok().as_deref() != Some(bytes)
        };
        let is_same_image = is_same_file(image, &target)?;
        let mut other = files.iter().filter(|(path, bytes)| differs(path, bytes));
        let other = other.next().map(|(path, _)| path);
        let other = other.or((target.exists() && !is_same_image).then_some(&target));
        if let (Some(path), false) = (other, replace) {
            return Err(Error::config(format!("`{}` exists", path.display()))
                .hint("give --force to replace it, or another folder"));
        }
        for path in files.iter().map(|(path, _)| path).chain([&target]) {
            if let Some(folder) = path.parent() {
                std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
            }
        }
        if !is_same_image {
            link_or_copy(image, &target)?;
        }
        files
            .iter()
            .try_for_each(|(path, bytes)| write_atomically(path, |out| out.write_all(bytes)))
    }

    /// Writes the files that list the images with depth, and copies the sparse model. The result depends only on the model
    /// and on the images in the workspace, so this may be called again after more images.
    ///
    /// # Errors
    /// Files cannot be read or written.
    pub fn finish(&self) -> Result<WorkspaceImages> {
        let views: Vec<&PosedView> = self
            .views
            .iter()
            .filter(|view| self.has(&view.name))
            .collect();
        let images = WorkspaceImages {
            with_depth: views.len(),
            without_depth: self.views.len() - views.len(),
        };
        let lists = match self.coding {
            Coding::Colmap => {
                self.copy_model("sparse")?;
                let names = views.iter().map(|view| view.name.as_str());
                colmap::lists(names).to_vec()
            }
            Coding::Splatting(code) => {
                self.copy_model("sparse/0")?;
                let stems = views.iter().map(|view| stem(&view.name));
                vec![(splatting::PARAMETERS, code.parameters(stems))]
            }
            Coding::Nerfstudio(_) => {
                let frames = views.iter().map(|view| nerfstudio::Image {
                    file: format!("{IMAGES}/{}", view.name),
                    depth: self.paths(&view.name).next().unwrap_or_default(),
                    size: view.size,
                    camera: &view.camera,
                });
                vec![(nerfstudio::TRANSFORMS, nerfstudio::transforms(frames))]
            }
        };
        for (name, text) in lists {
            let path = self.folder.join(name);
            if let Some(folder) = path.parent() {
                std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
            }
            write_atomically(&path, |out| out.write_all(text.as_bytes()))?;
        }
        Ok(images)
    }

    /// Returns the paths of the depth files of an image, below the folder.
    fn paths(&self, name: &str) -> impl Iterator<Item = PathBuf> + use<> {
        let paths = match self.coding {
            Coding::Colmap => colmap::PATHS
                .map(|folder| ended(folder, name, ".geometric.bin"))
                .to_vec(),
            Coding::Splatting(_) => vec![ended(splatting::FOLDER, stem(name), ".png")],
            Coding::Nerfstudio(format) => vec![ended(nerfstudio::FOLDER, name, format.ending())],
        };
        paths.into_iter()
    }

    fn image(&self, view: usize) -> PathBuf {
        self.folder.join(IMAGES).join(&self.views[view].name)
    }

    /// Copies the files of the sparse model in both forms, including rigs and frames if they exist.
    fn copy_model(&self, below: &str) -> Result<()> {
        let folder = self.folder.join(below);
        std::fs::create_dir_all(&folder).map_err(|e| Error::write(&folder, e))?;
        for name in Colmap::files() {
            let source = self.model.join(&name);
            match std::fs::read(&source) {
                Ok(bytes) => {
                    write_atomically(&folder.join(&name), |out| out.write_all(&bytes))?;
                }
                Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
                Err(e) => return Err(Error::read(&source, e)),
            }
        }
        Ok(())
    }
}

/// Returns the camera of an image, or why the program cannot use it.
fn usable(format: WorkspaceFormat, camera: Option<&Camera>) -> std::result::Result<Camera, String> {
    let camera = camera.ok_or("its model is not supported")?;
    let lens = camera.optics().lens();
    let is_usable = match format {
        WorkspaceFormat::Colmap | WorkspaceFormat::Splatting => *lens == Lens::Pinhole,
        WorkspaceFormat::Nerfstudio => nerfstudio::is_usable(lens),
    };
    if is_usable {
        return Ok(camera.clone());
    }
    Err(format!("it has distortion ({})", lens.name()))
}

/// Returns an error if two images would share a depth file, because their names differ only in their extensions.
fn check_stems(views: &[View]) -> std::result::Result<(), String> {
    let mut stems = HashSet::new();
    let mut names = views.iter().map(|view| view.name.as_str());
    match names.find(|name| !stems.insert(stem(name))) {
        None => Ok(()),
        Some(name) => Err(format!(
            "several images are called `{}`, but for their endings: splatting names depths without endings",
            stem(name)
        )),
    }
}

/// Returns a name without its extension.
fn stem(name: &str) -> &str {
    match name.rsplit_once('.') {
        Some((stem, ending)) if !ending.contains('/') => stem,
        _ => name,
    }
}

/// Returns `folder/name` with a suffix.
fn ended(folder: &str, name: &str, end: &str) -> PathBuf {
    let mut path: OsString = Path::new(folder).join(name).into();
    path.push(end);
    path.into()
}

/// Returns the nearest and the farthest depth of the images of a model, in its unit. The nearest is the first percentile of
/// an image, because single points of a model are often far too near.
fn depth_range(views: &[View]) -> Option<[f64; 2]> {
    const SHARE: usize = 100;
    let mut range: Option<[f64; 2]> = None;
    for view in views {
        let mut depths: Vec<f64> = view.keypoints().iter().map(|point| point.depth).collect();
        if depths.is_empty() {
            continue;
        }
        let farthest = depths.iter().copied().fold(0.0, f64::max);
        let first = depths.len() / SHARE;
        let (_, nearest, _) = depths.select_nth_unstable_by(first, f64::total_cmp);
        let [low, high] = range.unwrap_or([f64::INFINITY, 0.0]);
        range = Some([low.min(*nearest), high.max(farthest)]);
    }
    range
}

/// Whether `copy` is a link to an image, or an equal file.
fn is_same_file(image: &Path, copy: &Path) -> Result<bool> {
    if !copy.exists() {
        return Ok(false);
    }
    let real = |path: &Path| path.canonicalize().map_err(|e| Error::read(path, e));
    if real(image)? == real(copy)? {
        return Ok(true);
    }
    let read = |path: &Path| std::fs::read(path).map_err(|e| Error::read(path, e));
    Ok(read(image)? == read(copy)?)
}

#[cfg(test)]
mod tests;
