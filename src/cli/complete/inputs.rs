//! What is to be completed: images, and where the points of each are.

use super::Complete;
use super::failures::Failures;
use crate::data::{self, Camera, Colmap, Sparse, View};
use crate::error::{Error, Result};
use image::RgbImage;
use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};
use std::time::{Duration, Instant};

/// The endings of files of points, in the order in which they are looked for.
const ENDINGS: [&str; 13] = [
    "npy", "npz", "png", "tiff", "tif", "exr", "pfm", "csv", "txt", "ply", "pcd", "las", "laz",
];

/// An image and where its points are.
pub(super) struct Job {
    pub(super) image: PathBuf,
    /// What its results are called: a path below the folder of results.
    pub(super) name: PathBuf,
    points: Points,
}

enum Points {
    File(PathBuf),
    View(Box<View>),
}

/// A frame in memory.
pub(super) struct Loaded {
    pub(super) rgb: RgbImage,
    pub(super) points: Sparse,
    pub(super) camera: Option<Camera>,
    pub(super) reading: Duration,
}

impl Job {
    /// The files that it is read from, each with what it is: those of a model as one folder.
    pub(super) fn files<'a>(&'a self, args: &'a Complete) -> [(&'static str, &'a Path); 2] {
        let points = match &self.points {
            Points::File(path) => path,
            Points::View(_) => &args.sparse,
        };
        [("image", &self.image), ("points", points)]
    }

    pub(super) fn load(&self, args: &Complete) -> Result<Loaded> {
        let started = Instant::now();
        let rgb = data::read_rgb(&self.image)?;
        let size = (rgb.width() as usize, rgb.height() as usize);
        let camera = args.camera.as_ref().map(|camera| camera.resized(size));
        let read = |path: &Path, unit| -> Result<Sparse> {
            Sparse::read(path, unit, camera.as_ref(), size)?.placed_on(size)
        };
        let mut points = match &self.points {
            Points::File(path) => read(path, args.depth_unit)?,
            Points::View(view) => Sparse::of_view(view, size)?,
        };
        if let Some(path) = &args.sigma {
            points.sigma = Some(read(path, Some(points.unit))?.depth);
        }
        let camera = camera.or_else(|| match &self.points {
            Points::View(view) => Some(view.camera.as_ref()?.resized(size)),
            Points::File(_) => None,
        });
        Ok(Loaded {
            rgb,
            points,
            camera,
            reading: started.elapsed(),
        })
    }
}

/// Whether one image is meant, whose results may lie beside it.
pub(super) fn is_one(args: &Complete) -> bool {
    matches!(&args.rgb[..], [path] if !path.is_dir() && !is_pattern(path) && !is_list(path))
}

/// The one image that is meant.
pub(super) fn one(args: &Complete) -> Result<Job> {
    let image = args.rgb[0].clone();
    let sparse = &args.sparse;
    let points = if Colmap::is_at(sparse) {
        let views = Colmap::read(sparse)?.views;
        let view = views.into_iter().find(|view| image.ends_with(&view.name));
        Points::View(Box::new(view.ok_or_else(|| {
            Error::format(sparse, format!("has no image `{}`", image.display()))
        })?))
    } else if sparse.is_dir() {
        same_name(
            sparse,
            Path::new(image.file_name().unwrap_or_default()),
            &image,
        )?
    } else {
        Points::File(sparse.clone())
    };
    let name = PathBuf::from(image.file_name().unwrap_or_default());
    Ok(Job {
        image,
        name,
        points,
    })
}

/// Every image of folders, patterns and lists that belongs to the shard, each with its points. What
/// has none, or no name of its own, has failed.
pub(super) fn many(args: &Complete, output: &Path, failures: &Failures) -> Result<Vec<Job>> {
    let mut jobs = Vec::new();
    let mut names = HashSet::new();
    let mut add = |image: PathBuf, name: PathBuf, points: Result<Points>| {
        let inside = name
            .components()
            .all(|part| matches!(part, Component::Normal(_)));
        let points = if !inside {
            Err(Error::config("its name leads out of the folder"))
        } else if !names.insert(name.with_extension("")) {
            Err(Error::config(
                "another image has that name, but for the ending",
            ))
        } else {
            points
        };
        match points {
            Ok(points) => jobs.push(Job {
                image,
                name,
                points,
            }),
            Err(error) => failures.add(&name, &error),
        }
    };
    let holds = |name: &Path| args.shard.holds(&name.to_string_lossy());
    let mut views = Vec::new();
    if Colmap::is_at(&args.sparse) {
        views = Colmap::read(&args.sparse)?.views;
        if let ([folder], true) = (&args.rgb[..], args.rgb[0].is_dir()) {
            for view in views {
                let name = PathBuf::from(&view.name);
                if holds(&name) {
                    add(folder.join(&name), name, Ok(Points::View(Box::new(view))));
                }
            }
            return Ok(jobs);
        }
    } else if !args.sparse.is_dir() {
        let what = "is no folder of points and no model of COLMAP";
        return Err(Error::format(&args.sparse, what));
    }
    for Found {
        image,
        name,
        points,
    } in images(args, output)?
    {
        if !holds(&name) {
            continue;
        }
        let points = if let Some(points) = points {
            Ok(Points::File(points))
        } else if let Some(view) = views.iter().find(|view| image.ends_with(&view.name)) {
            Ok(Points::View(Box::new(view.clone())))
        } else {
            same_name(&args.sparse, &name, &image)
        };
        add(image, name, points);
    }
    Ok(jobs)
}

/// The file of points that is called as the image, in the same subfolder or in none.
fn same_name(folder: &Path, name: &Path, image: &Path) -> Result<Points> {
    let flat = Path::new(name.file_name().unwrap_or_default());
    let files = [name, flat].map(|name| ENDINGS.map(|e| folder.join(name).with_extension(e)));
    let mut files = files.into_iter().flatten();
    let file = files.find(|file| file.exists() && file != image);
    file.map(Points::File).ok_or_else(|| {
        let folder = folder.display();
        Error::config(format!("there are no points of that name in `{folder}`"))
    })
}

/// An image that was named.
struct Found {
    image: PathBuf,
    name: PathBuf,
    /// In a list.
    points: Option<PathBuf>,
}

fn images(args: &Complete, output: &Path) -> Result<Vec<Found>> {
    let mut found = Vec::new();
    for path in &args.rgb {
        let before = found.len();
        if path.is_dir() {
            for image in data::images_below(path)? {
                let ours = image.starts_with(output) && !path.starts_with(output);
                if !ours {
                    let name = image.strip_prefix(path).unwrap_or(&image).to_owned();
                    found.push(Found::new(image, name));
                }
            }
        } else if is_list(path) {
            listed(path, &mut found)?;
        } else if is_pattern(path) {
            let wrong = |what: String| Error::config(format!("`{}` {what}", path.display()));
            let matches = glob::glob(&path.to_string_lossy())
                .map_err(|e| wrong(format!("is no pattern: {}", e.msg)))?;
            for image in matches {
                let image = image.map_err(|e| wrong(e.to_string()))?;
                found.push(Found::flat(image));
            }
        } else {
            found.push(Found::flat(path.clone()));
        }
        if found.len() == before {
            return Err(Error::format(path, "holds no image")
                .hint("JPEG, PNG, WebP and TIFF images are looked for"));
        }
    }
    Ok(found)
}

/// An image to a line, then its points, if they are not in the folder of points.
fn listed(path: &Path, found: &mut Vec<Found>) -> Result<()> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    for line in text.lines() {
        let line = line.split('#').next().unwrap_or_default();
        let mut fields = line
            .split([',', ' ', '\t'])
            .filter(|field| !field.is_empty());
        if let Some(image) = fields.next() {
            let relative = Path::new(image).is_relative();
            let name = if relative {
                PathBuf::from(image)
            } else {
                PathBuf::from(Path::new(image).file_name().unwrap_or_default())
            };
            found.push(Found {
                points: fields.next().map(|points| folder.join(points)),
                ..Found::new(folder.join(image), name)
            });
        }
    }
    Ok(())
}

impl Found {
    fn new(image: PathBuf, name: PathBuf) -> Self {
        Self {
            image,
            name,
            points: None,
        }
    }

    /// Called by its last part alone.
    fn flat(image: PathBuf) -> Self {
        let name = PathBuf::from(image.file_name().unwrap_or_default());
        Self::new(image, name)
    }
}

fn is_list(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "txt")
}

fn is_pattern(path: &Path) -> bool {
    !path.exists() && path.to_string_lossy().contains(['*', '?', '['])
}
