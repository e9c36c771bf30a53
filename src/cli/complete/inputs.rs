//! What is to be completed: images, and where the points of each are.

use super::failures::Failures;
use super::loaded::Loaded;
use super::recorded::Recorded;
use super::settings::{Settings, is_list, is_pattern};
use super::views::FrameViewsSource;
use crate::cli::args::Format;
use crate::cli::ui;
use lsdc_core::DepthGuide;
use lsdc_eval::data::{
    self, Camera, Colmap, DepthReadOptions, Orientation, Sparse, UprightImage, View, check_foreign,
};
use lsdc_eval::predict::GuideSpec;
use lsdc_files::error::{Error, Result};
use lsdc_files::{Workspace, WorkspaceFormat};
use lsdc_recordings::SyncedFrame;
use serde_json::json;
use std::collections::{HashMap, HashSet};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// An image and where its points are.
pub(super) struct Job {
    pub(super) image: PathBuf,
    /// What its results are called: a path below the folder of results.
    pub(super) name: PathBuf,
    points: Points,
    guide: Option<PathBuf>,
    /// With `--views`, where the image finds its neighbours.
    pub(super) views: Option<FrameViewsSource>,
}

enum Points {
    File(PathBuf),
    View(Box<View>),
    /// Image and points are messages.
    Recorded(Arc<Recorded>, Box<SyncedFrame>),
}

/// What a frame is read from.
pub(super) enum Input<'a> {
    /// A file, or the folder of a model.
    File(&'a Path),
    /// Messages of a recording.
    Frame(&'a Recorded, &'a SyncedFrame),
    /// Points and poses of other images.
    Views(&'a FrameViewsSource),
}

impl Input<'_> {
    /// Where it is.
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::File(path) => path,
            Self::Frame(recorded, _) => recorded.path(),
            Self::Views(views) => views.source(),
        }
    }
}

impl Job {
    /// What it is read from, each with what it is: the files of a model as one folder.
    pub(super) fn inputs<'a>(&'a self, settings: &'a Settings) -> Vec<(&'static str, Input<'a>)> {
        let points = match &self.points {
            Points::File(path) => Input::File(path),
            Points::View(_) => Input::File(&settings.sparse),
            Points::Recorded(recorded, frame) => Input::Frame(recorded, frame),
        };
        let alone = matches!(points, Input::Frame(..));
        let image = (!alone).then_some(("image", Input::File(&self.image)));
        let points = (if alone { "recording" } else { "points" }, points);
        let guide = self
            .guide
            .as_deref()
            .map(|guide| ("guide", Input::File(guide)));
        let views = self.views.as_ref();
        let views = views.map(|views| ("views", Input::Views(views)));
        let all = image.into_iter().chain([points]).chain(guide);
        all.chain(views).collect()
    }

    /// The image of a model, if it is one.
    pub(super) fn view(&self) -> Option<&View> {
        match &self.points {
            Points::View(view) => Some(view),
            Points::File(_) | Points::Recorded(..) => None,
        }
    }

    /// The frame of a recording, if it is one.
    pub(super) fn recorded(&self) -> Option<(&Recorded, &SyncedFrame)> {
        match &self.points {
            Points::Recorded(recorded, frame) => Some((recorded, frame)),
            Points::File(_) | Points::View(_) => None,
        }
    }

    /// The recording that it is of, if it is of one.
    pub(super) fn recording(&self) -> Option<&Arc<Recorded>> {
        match &self.points {
            Points::Recorded(recorded, _) => Some(recorded),
            Points::File(_) | Points::View(_) => None,
        }
    }

    pub(super) fn load(&self, settings: &Settings) -> Result<Loaded> {
        let started = Instant::now();
        let mut loaded = match &self.points {
            Points::Recorded(recorded, frame) => recorded.load(frame)?.1,
            Points::File(_) | Points::View(_) => self.load_files(settings)?,
        };
        if let (Some(GuideSpec::Files(source)), Some(file)) = (&settings.guide, &self.guide) {
            let (guide, read) = source.read(file)?;
            let size = (loaded.rgb.width() as usize, loaded.rgb.height() as usize);
            let read = read.iter().map(|doubt| format!("of the guide: {doubt}"));
            let warnings = warnings(&guide, size).into_iter().chain(read);
            loaded.points.remarks.extend(warnings);
            loaded.guide = Some(guide);
        }
        loaded.views = self.views.as_ref().and_then(FrameViewsSource::find);
        loaded.reading = started.elapsed();
        loaded.with_options(settings)
    }

    fn load_files(&self, settings: &Settings) -> Result<Loaded> {
        let UprightImage {
            rgb,
            orientation: image,
            warnings,
        } = data::read_upright(&self.image)?;
        let (camera, mut points) = self.points_in(settings, image)?;
        points
            .remarks
            .extend(warnings.iter().map(ToString::to_string));
        Ok(Loaded {
            rgb,
            points,
            unplaced: 0,
            skewed: false,
            camera,
            guide: None,
            noise: None,
            views: None,
            reading: Duration::ZERO,
        })
    }

    /// The points of files in an image of this size, and its camera, if that is known.
    pub(super) fn points_in(
        &self,
        settings: &Settings,
        image: Orientation,
    ) -> Result<(Option<Camera>, Sparse)> {
        let mut assumed = Vec::new();
        let camera = match (&settings.camera, &self.points) {
            (Some(camera), _) => {
                let (camera, remark) = camera.for_image(&image)?;
                assumed.extend(remark.into_iter().chain(camera.warnings()));
                Some(camera)
            }
            (None, Points::View(view)) => view.camera_of(&image, settings.depth_unit)?,
            (None, _) => None,
        };
        let mut points = match &self.points {
            Points::File(path) => {
                let how = DepthReadOptions {
                    unit: settings.depth_unit,
                    kind: settings.depth_kind,
                };
                Sparse::read_as(path, how, camera.as_ref(), image)?
            }
            Points::View(view) => Sparse::of_view(view, image, settings.depth_unit)?,
            Points::Recorded(..) => return Err(Error::config("a message is in no file")),
        };
        if let Some(path) = &settings.sigma {
            points = points.with_sigma(path, image)?;
        }
        points.remarks.extend(assumed);
        Ok((camera, points))
    }

    /// The camera of the image at its place in the model, if it is of one.
    pub(super) fn camera_in_model(
        &self,
        settings: &Settings,
        image: &Orientation,
    ) -> Result<Option<Camera>> {
        match &self.points {
            Points::View(view) => view.camera_of(image, settings.depth_unit),
            Points::File(_) | Points::Recorded(..) => Ok(None),
        }
    }
}

/// What should be checked of a guide for an image of (width, height).
fn warnings(guide: &DepthGuide, (width, height): (usize, usize)) -> Vec<String> {
    /// Sides are rounded, to multiples of 14 or 32 by many networks.
    const UNLIKE: f64 = 1.1;
    let mut warnings = Vec::new();
    let aspect = |width: usize, height: usize| width as f64 / height as f64;
    let ratio = aspect(guide.width(), guide.height()) / aspect(width, height);
    if !(UNLIKE.recip()..=UNLIKE).contains(&ratio) {
        warnings.push(format!(
            "the guide is {}x{} but the image {width}x{height}: it is stretched to cover the image",
            guide.width(),
            guide.height()
        ));
    }
    let (missing, pixels) = (guide.missing(), guide.width() * guide.height());
    if missing > 0 {
        warnings.push(format!(
            "{missing} of the {pixels} pixels of the guide hold no prediction; gaps were filled from their sides"
        ));
    }
    warnings
}

/// The one image that is meant.
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

/// Every image of folders, patterns, lists and recordings that belongs to the shard, or with `--views` every image, each
/// with its points. What has none, or no name of its own, has failed.
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
    /// So many are named.
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
        // Where capitals make no difference, both are one file.
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

/// An image that was named.
struct Found {
    image: PathBuf,
    name: PathBuf,
    /// In a list.
    points: Option<PathBuf>,
}

fn images(settings: &Settings, output: &Path) -> Result<Vec<Found>> {
    let mut found = Vec::new();
    for path in &settings.rgb {
        let before = found.len();
        if path.is_dir() {
            let (images, results) = without_results(data::images_below(path)?, path, output);
            if results > 0 {
                ui::say(&format!(
                    "left out of `{}`: {} that `lsdc complete` wrote",
                    path.display(),
                    ui::counted(results, "image")
                ));
            }
            for image in images {
                let name = image.strip_prefix(path).unwrap_or(&image).to_owned();
                found.push(Found::new(image, name));
            }
        } else if is_list(path) {
            read_list(path, &mut found)?;
        } else if is_pattern(path) {
            let wrong = |what: String| Error::config(format!("`{}` {what}", path.display()));
            let matches = glob::glob(&path.to_string_lossy())
                .map_err(|e| wrong(format!("is no pattern: {}", e.msg)))?;
            for image in matches {
                let image = image.map_err(|e| wrong(e.to_string()))?;
                found.push(Found::flat(image));
            }
        } else {
            check_foreign(path)?;
            found.push(Found::flat(path.clone()));
        }
        if found.len() == before {
            return Err(Error::format(path, "holds no image")
                .hint("JPEG, PNG, WebP, TIFF, BMP and PNM images are looked for"));
        }
    }
    Ok(found)
}

/// The images of a folder without what an earlier run has written there, and how many those were:
/// all below the folder of results, and where that holds the images too, what is called as results
/// of another image are.
fn without_results(images: Vec<PathBuf>, folder: &Path, output: &Path) -> (Vec<PathBuf>, usize) {
    let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let (folder, output) = (real(folder), real(output));
    let together = folder.starts_with(&output);
    let stems: HashSet<PathBuf> = images.iter().map(|path| path.with_extension("")).collect();
    let workspaces: Vec<PathBuf> = WorkspaceFormat::ALL
        .map(|format| output.join(format.name()))
        .into_iter()
        .filter(|folder| Workspace::is_at(folder))
        .collect();
    let is_result = |path: &Path| {
        let named = |end: &str| {
            let name = path.file_name()?.to_str()?;
            let stem = name.strip_suffix(end)?.strip_suffix('_')?;
            Some(stems.contains(&path.with_file_name(stem)))
        };
        let ends = Format::ALL.into_iter().map(Format::end);
        if together {
            ends.into_iter().any(|end| named(end) == Some(true))
                || workspaces
                    .iter()
                    .any(|folder| real(path).starts_with(folder))
        } else {
            real(path).starts_with(&output)
        }
    };
    let before = images.len();
    let images: Vec<PathBuf> = images.into_iter().filter(|path| !is_result(path)).collect();
    let results = before - images.len();
    (images, results)
}

/// An image to a line, then its points, if they are not in the folder of points.
fn read_list(path: &Path, found: &mut Vec<Found>) -> Result<()> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    for (number, line) in text.lines().enumerate() {
        let fields = split(line, folder);
        let (image, points) = match &fields[..] {
            [] => continue,
            [image] => (image, None),
            [image, points] => (image, Some(folder.join(points))),
            _ => {
                let what = format!("line {}: {} paths", number + 1, fields.len());
                return Err(Error::format(path, what).hint(
                    "a line is an image and its points; quote what has blanks: \"a b.png\"",
                ));
            }
        };
        let plain: PathBuf = Path::new(image)
            .components()
            .filter(|part| *part != Component::CurDir)
            .collect();
        let image = folder.join(&plain);
        found.push(if plain.is_relative() {
            Found {
                points,
                ..Found::new(image, plain)
            }
        } else {
            Found {
                points,
                ..Found::flat(image)
            }
        });
    }
    Ok(())
}

/// The paths of a line, separated by commas or blanks, or quoted; what follows a `#` before a path is
/// a remark. A line that is the name of a file is that file, whatever is in the name.
fn split(line: &str, folder: &Path) -> Vec<String> {
    let line = line.trim();
    if !line.is_empty() && folder.join(line).is_file() {
        return vec![line.to_owned()];
    }
    let mut fields = Vec::new();
    let mut rest = line;
    loop {
        rest = rest.trim_start_matches([',', ' ', '\t']);
        if rest.is_empty() || rest.starts_with('#') {
            return fields;
        }
        let quoted = rest.strip_prefix('"').and_then(|text| text.split_once('"'));
        let (field, after) = quoted.unwrap_or_else(|| {
            let end = rest.find([',', ' ', '\t']).unwrap_or(rest.len());
            rest.split_at(end)
        });
        fields.push(field.to_owned());
        rest = after;
    }
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
