//! Which images are to be completed, each with its points: a job for each.

use super::failures::Failures;
use super::images::{Found, images};
use super::job::{Job, Points};
use super::recorded::Recorded;
use super::settings::Settings;
use crate::cli::ui;
use lsdc_eval::data::{Colmap, Sparse, View, check_foreign};
use lsdc_eval::predict::GuideSpec;
use lsdc_files::error::{Error, Result};
use serde_json::json;
use std::collections::{HashMap, HashSet};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// Finds the image and its points when a single image is given.
pub(super) fn one(settings: &Settings) -> Result<Job> {
    let image = settings.rgb[0].clone();
    let sparse = &settings.sparse;
    check_foreign(&image)?;
    check_foreign(sparse)?;
    let points = if Colmap::is_at(sparse) {
        let views = Colmap::read(sparse)?.views;
        Points::View(Box::new(
            view_of(&image, &by_name(&views)).cloned().ok_or_else(|| {
                Error::format(sparse, format!("has no image `{}`", image.display()))
            })?,
        ))
    } else if sparse.is_dir() {
        let name = Path::new(image.file_name().unwrap_or_default());
        Points::File(same_name(sparse, name, &image)?)
    } else {
        Points::File(sparse.clone())
    };
    let name = PathBuf::from(image.file_name().unwrap_or_default());
    Ok(Job {
        guide: guide_of(settings, &name)?,
        image,
        name,
        points,
        views: None,
    })
}
/// The file of the guide for an image of this name, unless a network predicts it.
fn guide_of(settings: &Settings, name: &Path) -> Result<Option<PathBuf>> {
    match &settings.guide {
        Some(GuideSpec::Files(source)) => source.file_for(name).map(Some),
        Some(GuideSpec::DepthAnything(_) | GuideSpec::None) | None => Ok(None),
    }
}
/// The model of COLMAP that the points of several images are from, if they are from one.
pub(super) fn model(settings: &Settings) -> Result<Option<Colmap>> {
    let is_model = !settings.rgb.is_empty() && Colmap::is_at(&settings.sparse);
    is_model.then(|| Colmap::read(&settings.sparse)).transpose()
}

/// Finds every image of the shard, or with `--views` every image, in folders, patterns, lists and recordings, each
/// with its points. Images without points or without a unique name are recorded as failures.
/// Points are those of `model`, if there is one.
pub(super) fn many(
    settings: &Settings,
    model: Option<&Colmap>,
    output: &Path,
    failures: &Failures,
) -> Result<Vec<Job>> {
    let holds =
        |name: &Path| settings.views.is_some() || settings.shard.holds(&name.to_string_lossy());
    if settings.rgb.is_empty() {
        check_foreign(&settings.sparse)?;
        if settings.depth_kind.is_some() {
            return Err(Error::config(
                "--depth-kind is for maps and tables in files, not for recordings",
            ));
        }
        let recorded = Arc::new(Recorded::open(settings)?);
        recorded.tell(settings.json);
        let mut jobs = Jobs::new(settings, failures);
        for frame in recorded.frames() {
            let name = Recorded::name(frame);
            if holds(&name) {
                let points = Points::Recorded(recorded.clone(), Box::new(frame.clone()));
                jobs.add(recorded.path().to_owned(), name, Ok(points));
            }
        }
        return Ok(jobs.found);
    }
    if model.is_none() && !settings.sparse.is_dir() {
        let what = "is no folder of points and no model of COLMAP";
        return Err(Error::format(&settings.sparse, what).hint(
            "for several images give a folder with a file of points for each, or a list; for one image give its path",
        ));
    }
    let views = by_name(model.map_or(&[], |model| &model.views));
    let mut jobs = Jobs::new(settings, failures);
    let mut found = images(settings, output)?;
    if model.is_some() && settings.rgb.iter().all(|path| path.is_dir()) {
        found = in_model(settings, found, &views)?;
    }
    let shared = shared_points(&found, |one| {
        let view = view_of(&one.image, &views).map(|view| PathBuf::from(&view.name));
        view.or_else(|| same_name(&settings.sparse, &one.name, &one.image).ok())
    });
    let unshared = |points: &Path| match shared.get(points) {
        Some(error) => Err(Error::config(error.clone())
            .hint("put the points into subfolders as the images are, or give a list")),
        None => Ok(()),
    };
    for Found {
        image,
        name,
        points,
    } in found
    {
        if !holds(&name) {
            continue;
        }
        let points = if let Some(points) = points {
            if settings.exports.is_empty() {
                Ok(Points::File(points))
            } else {
                Err(Error::config(
                    "its points are in a file, but `--export` needs its pose in the model",
                )
                .hint("leave the points out of the list"))
            }
        } else if let Some(view) = view_of(&image, &views) {
            unshared(Path::new(&view.name)).map(|()| Points::View(Box::new(view.clone())))
        } else {
            let file = same_name(&settings.sparse, &name, &image);
            file.and_then(|file| unshared(&file).map(|()| Points::File(file)))
        };
        jobs.add(image, name, points);
    }
    Ok(jobs.found)
}

/// The images of folders that a model knows; says which it does not know, and how many of its own are not there.
fn in_model(settings: &Settings, found: Vec<Found>, views: &Views<'_>) -> Result<Vec<Found>> {
    /// Number of images that the message names.
    const NAMED: usize = 5;
    let all = found.len();
    let is_known = |one: &Found| view_of(&one.image, views).is_some();
    let (known, unknown): (Vec<Found>, Vec<Found>) = found.into_iter().partition(is_known);
    let of = |count: usize| {
        if count == 1 {
            "1 image is".to_owned()
        } else {
            format!("{count} images are")
        }
    };
    let names = unknown
        .iter()
        .take(NAMED)
        .map(|one| one.name.display().to_string());
    let names = names.collect::<Vec<_>>().join(", ");
    let more = unknown.len().saturating_sub(NAMED);
    let more = if more > 0 {
        format!(", and {more} more")
    } else {
        String::new()
    };
    let unknown_line = format!("{} not in the model: {names}{more}", of(unknown.len()));
    if known.is_empty() {
        let what = format!("none of {all} images is in the model; {unknown_line}");
        let first = views
            .values()
            .map(|view| view.name.as_str())
            .min()
            .unwrap_or("none");
        return Err(Error::format(&settings.sparse, what).hint(format!(
            "give the folder of images that the model was made of; the first name in the model: {first}"
        )));
    }
    let tell = if settings.json { ui::say } else { ui::tell };
    let seen: HashSet<&str> = known
        .iter()
        .filter_map(|one| view_of(&one.image, views))
        .map(|view| view.name.as_str())
        .collect();
    let absent = views.len().saturating_sub(seen.len());
    if absent > 0 {
        tell(&format!(
            "model     {} images, {absent} of them not in the folder",
            views.len()
        ));
    }
    if !unknown.is_empty() {
        ui::warn(&format!("warning: {unknown_line}"));
    }
    for one in unknown.iter().filter(|_| settings.json) {
        let value = json!({
            "image": one.name.display().to_string(), "status": "left out", "reason": "it is not in the model",
        });
        ui::print(&value.to_string());
    }
    Ok(known)
}

/// Images with their points, each of another name.
struct Jobs<'a> {
    settings: &'a Settings,
    found: Vec<Job>,
    names: HashSet<PathBuf>,
    failures: &'a Failures,
}

impl<'a> Jobs<'a> {
    fn new(settings: &'a Settings, failures: &'a Failures) -> Self {
        Self {
            settings,
            found: Vec::new(),
            names: HashSet::new(),
            failures,
        }
    }

    fn add(&mut self, image: PathBuf, name: PathBuf, points: Result<Points>) {
        let inside = name
            .components()
            .all(|part| matches!(part, Component::Normal(_)));
        let points = if !inside {
            Err(Error::config("its name leads out of the folder"))
        } else if !self.names.insert(name.with_extension("")) {
            Err(Error::config(
                "another image has that name, but for the ending",
            ))
        } else {
            points
        };
        let found = points.and_then(|points| Ok((points, guide_of(self.settings, &name)?)));
        match found {
            Ok((points, guide)) => self.found.push(Job {
                image,
                name,
                points,
                guide,
                views: None,
            }),
            // With `--views`, images of other shards are here for their points.
            Err(error) if self.settings.shard.holds(&name.to_string_lossy()) => {
                self.failures.add(&name, &error);
            }
            Err(_) => {}
        }
    }
}

/// The images of a model by name.
type Views<'a> = HashMap<&'a Path, &'a View>;

fn by_name(views: &[View]) -> Views<'_> {
    views
        .iter()
        .map(|view| (Path::new(&view.name), view))
        .collect()
}

/// The image of a model whose path an image's ends with; of several the longest.
fn view_of<'a>(image: &Path, views: &Views<'a>) -> Option<&'a View> {
    let mut rest = image.components();
    loop {
        if let Some(view) = views.get(rest.as_path()) {
            return Some(view);
        }
        rest.next()?;
    }
}

/// The file of points that is called as the image, in the same subfolder or in none; its ending is in
/// small letters or in capitals.
fn same_name(folder: &Path, name: &Path, image: &Path) -> Result<PathBuf> {
    let flat = Path::new(name.file_name().unwrap_or_default());
    for name in [name, flat] {
        let path = folder.join(name);
        let endings = Sparse::endings().flat_map(|small| [small.to_owned(), small.to_uppercase()]);
        let files = endings.map(|ending| path.with_extension(ending));
        let mut files: Vec<PathBuf> = files
            .filter(|file| file.exists() && file != image)
            .collect();
        // On case-insensitive file systems both are the same file.
        files.dedup_by_key(|file| file.canonicalize().ok());
        match &files[..] {
            [] => {}
            [_] => return Ok(files.remove(0)),
            [one, other, ..] => {
                let (one, other) = (one.display(), other.display());
                let what = format!("`{one}` and `{other}` may both be its points");
                return Err(Error::config(what).hint("take one away, or give a list"));
            }
        }
    }
    let folder = folder.display();
    let stem = name.with_extension("");
    Err(Error::config(format!(
        "there are no points of that name in `{folder}`"
    ))
    .hint(format!(
        "points of an image are in a file of the same name, as in `{folder}/{}.npy`; a list names others",
        stem.display()
    )))
}

/// Points that are found for several images, as these have one name in different folders, by their
/// file or the name of their view, and what is wrong with that.
fn shared_points(
    found: &[Found],
    points: impl Fn(&Found) -> Option<PathBuf>,
) -> HashMap<PathBuf, String> {
    let mut images: HashMap<PathBuf, &Path> = HashMap::new();
    let mut shared = HashMap::new();
    for one in found.iter().filter(|one| one.points.is_none()) {
        let Some(file) = points(one) else {
            continue;
        };
        let same = |other: &Path| other.with_extension("") == one.name.with_extension("");
        if let Some(other) = images.insert(file.clone(), &one.name)
            && !same(other)
        {
            shared.insert(
                file.clone(),
                format!(
                    "`{}` would be the points of both `{}` and `{}`",
                    file.display(),
                    other.display(),
                    one.name.display()
                ),
            );
        }
    }
    shared
}
