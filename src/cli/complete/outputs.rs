//! The files of a result.

use super::formats::{Forms, Png, formats};
use super::frame::{Completed, Diagnostics};
use super::inputs::Job;
use super::loaded::Loaded;
use super::record;
use super::summary::Summary;
use crate::cli::args::{Complete, Format};
use lsdc_eval::data::{self, Cloud, DepthMap, Unit};
use lsdc_eval::report::{colour_map, usual_range};
use lsdc_files::error::{Error, Result};
use std::path::{Path, PathBuf};

/// The files of a result.
pub(super) struct Outputs<'a> {
    args: &'a Complete,
    folder: PathBuf,
    files: Vec<(Kind, PathBuf)>,
    /// Of a video, where the weights are kept that the next frame starts from.
    state: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Depth(Format),
    Sigma,
    Outliers,
}

impl<'a> Outputs<'a> {
    /// Of the one image: in the folder of `-o`, in that file, or beside the image.
    pub(super) fn beside(args: &'a Complete, job: &Job) -> Result<Self> {
        let output = args.output.as_deref();
        if let Some(path) = output.filter(|path| !path.is_dir())
            && let Some(format) = Format::of(path)
        {
            if args.formats.is_some() {
                return Err(Error::config(
                    "`-o FILE` and `--formats` name the format twice",
                ));
            }
            let folder = path.parent().unwrap_or(Path::new(""));
            let stem = path.file_stem().unwrap_or_default();
            let files = Self::new(args, folder, &stem.to_string_lossy(), &[]).files;
            return Self {
                args,
                folder: folder.to_owned(),
                files: [(Kind::Depth(format), path.to_owned())]
                    .into_iter()
                    .chain(files)
                    .collect(),
                state: None,
            }
            .checked();
        }
        if let Some(path) = output {
            check_folder(path)?;
        }
        let folder = output.or(args.rgb[0].parent()).unwrap_or(Path::new(""));
        Self::of(args, folder, job)
    }

    /// Of one image among many.
    pub(super) fn below(args: &'a Complete, output: &Path, job: &Job) -> Result<Self> {
        let folder = match job.name.parent() {
            Some(below) if !below.as_os_str().is_empty() => &output.join(below),
            _ => output,
        };
        let outputs = Self::of(args, folder, job)?;
        Ok(Self {
            state: args.temporal.then(|| record::state(output, job)),
            ..outputs
        })
    }

    fn of(args: &'a Complete, folder: &Path, job: &Job) -> Result<Self> {
        let stem = job.name.file_stem().unwrap_or_default();
        Self::new(args, folder, &stem.to_string_lossy(), formats(args)).checked()
    }

    fn new(args: &'a Complete, folder: &Path, stem: &str, formats: &[Format]) -> Self {
        let path = |end: &str| folder.join(format!("{stem}_{end}"));
        let mut files: Vec<(Kind, PathBuf)> = formats
            .iter()
            .map(|&format| (Kind::Depth(format), path(format.end())))
            .collect();
        if args.uncertainty {
            files.push((Kind::Sigma, path("sigma.npy")));
        }
        if args.outliers {
            files.push((Kind::Outliers, path("outliers.csv")));
        }
        Self {
            args,
            folder: folder.to_owned(),
            files,
            state: None,
        }
    }

    fn checked(self) -> Result<Self> {
        if let Some(option) = self.args.of_clouds().filter(|_| !self.has(Format::Ply)) {
            let error = Error::config(format!("`{option}` is for clouds"));
            return Err(error.hint("add ply to --formats"));
        }
        if self.args.range.is_some() && !self.has(Format::Color) {
            let error = Error::config("`--range` is for colour maps");
            return Err(error.hint("add color to --formats"));
        }
        Ok(self)
    }

    fn has(&self, format: Format) -> bool {
        let mut kinds = self.files.iter().map(|(kind, _)| *kind);
        kinds.any(|kind| kind == Kind::Depth(format))
    }

    /// Of a video, where the weights are kept that the next frame starts from.
    pub(super) fn weights(&self) -> Option<&Path> {
        self.state.as_deref()
    }

    /// The list of outliers, if there is one.
    pub(super) fn outliers(&self) -> Option<&Path> {
        let mut files = self.files.iter();
        let found = files.find(|(kind, _)| *kind == Kind::Outliers);
        found.map(|(_, path)| path.as_path())
    }

    /// All files by their names, for people.
    pub(super) fn listed(&self) -> String {
        if let [(_, path)] = &self.files[..] {
            return path.display().to_string();
        }
        let names = self.files.iter().map(|(_, path)| {
            let name = path.file_name().unwrap_or_default();
            name.to_string_lossy().into_owned()
        });
        let names = names.collect::<Vec<_>>().join(", ");
        if self.folder.as_os_str().is_empty() {
            return names;
        }
        format!("{names} in {}", self.folder.display())
    }

    /// Where the files are.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// The file that is named first.
    pub(super) fn first(&self) -> &Path {
        self.files.first().map_or(&self.folder, |(_, path)| path)
    }

    /// Checks that the files can be written, before anything is computed.
    pub(super) fn check_writable(&self) -> Result<()> {
        data::check_writable(&self.folder)
    }

    /// Checks that no file of the result is one that it is made from.
    pub(super) fn check_apart(&self, job: &Job) -> Result<()> {
        let real = |path: &Path| path.canonicalize().ok();
        for (what, input) in job.inputs(self.args) {
            let input = real(input.path());
            let mut files = self.files.iter().map(|(_, path)| path);
            if let Some(path) = files.find(|path| input.is_some() && real(path) == input) {
                let found = format!("`{}` is the {what}", path.display());
                return Err(Error::config(found).hint("give another folder or file with -o"));
            }
        }
        Ok(())
    }

    /// What the formats make of a result.
    pub(super) fn forms(&self, frame: &Loaded, found: &Completed) -> Result<Forms> {
        let png = || -> Result<Png> {
            let unit = data::png_unit(&found.depth)?;
            let raised = data::raised_in_png(&found.depth, unit.metres());
            Ok(Png { unit, raised })
        };
        let cloud = || -> Result<Cloud> {
            let camera = frame.camera.as_ref().ok_or_else(no_camera)?;
            let diagnostics = found.diagnostics.as_ref();
            let deviations = diagnostics.and_then(|found| found.deviations.as_ref());
            let (depth, options) = (found.filled(), self.args.cloud_options());
            Ok(Cloud::new(depth, deviations, &frame.rgb, camera, &options))
        };
        let range = || {
            let range = self.args.range.or(usual_range(&found.depth));
            range.unwrap_or((0.0, 1.0))
        };
        Ok(Forms {
            range: self.has(Format::Color).then(range),
            png: self.has(Format::Png).then(png).transpose()?,
            cloud: self.has(Format::Ply).then(cloud).transpose()?,
        })
    }

    /// Whether any of the files is there.
    pub(super) fn any_exists(&self) -> bool {
        self.files.iter().any(|(_, path)| data::would_replace(path))
    }

    /// Whether all files are there; a pipe or device keeps nothing.
    pub(super) fn exist(&self) -> bool {
        let mut files = self.files.iter().map(|(_, path)| path);
        files.all(|path| path.is_file()) && self.state.as_ref().is_none_or(|path| path.is_file())
    }

    /// Writes what was asked for. An existing file is replaced only by an equal one, or with
    /// `--force`; else nothing is written. So what an interrupted run has left is no obstacle.
    pub(super) fn write(
        &self,
        frame: &Loaded,
        found: &Completed,
        forms: &Forms,
        summary: &Summary,
    ) -> Result<()> {
        let result = Contents::new(self.args, frame, found, forms, summary);
        for (kind, path) in &self.files {
            if !self.args.force && data::would_replace(path) && !result.is_in(*kind, path) {
                return Err(Error::config(format!("`{}` exists", path.display()))
                    .hint("give --force to replace it, or -o DIR to write elsewhere"));
            }
        }
        if !self.folder.as_os_str().is_empty() {
            std::fs::create_dir_all(&self.folder).map_err(|e| Error::write(&self.folder, e))?;
        }
        self.files
            .iter()
            .try_for_each(|(kind, path)| result.write(*kind, path))?;
        match (&self.state, &found.diagnostics) {
            (Some(path), Some(found)) => write_weights(path, found.completion.weights()),
            _ => Ok(()),
        }
    }
}

/// What goes into the files.
struct Contents<'a> {
    depth: &'a DepthMap,
    deviations: Option<&'a DepthMap>,
    /// Of the depths.
    unit: &'static str,
    forms: &'a Forms,
    outliers: Option<String>,
    summary: &'a Summary,
    wanted: bool,
}

impl<'a> Contents<'a> {
    fn new(
        args: &Complete,
        frame: &'a Loaded,
        found: &'a Completed,
        forms: &'a Forms,
        summary: &'a Summary,
    ) -> Self {
        let depth = &found.depth;
        let found = found.diagnostics.as_ref();
        let list = |found: &Diagnostics| found.outliers_csv(&frame.points);
        Self {
            depth,
            deviations: found.and_then(|found| found.deviations.as_ref()),
            unit: summary.metres(),
            forms,
            outliers: found.filter(|_| args.outliers).map(list),
            summary,
            wanted: args.uncertainty,
        }
    }

    /// Deviations that are asked for, not only needed.
    fn sigma(&self) -> Option<&'a DepthMap> {
        self.deviations.filter(|_| self.wanted)
    }

    fn write(&self, kind: Kind, path: &Path) -> Result<()> {
        let depth = self.depth;
        match kind {
            Kind::Depth(Format::Npy) => data::write_npy(path, depth),
            Kind::Depth(Format::Npz) => {
                let maps = [("depth", Some(depth)), ("sigma", self.sigma())];
                let maps = maps
                    .into_iter()
                    .filter_map(|(name, map)| Some((name, map?)));
                data::write_npz(path, &maps.collect::<Vec<_>>())
            }
            Kind::Depth(Format::Png) => {
                let unit = self.forms.png.map_or(Unit::MILLIMETRE, |png| png.unit);
                data::write_depth_png(path, depth, unit.metres())
            }
            Kind::Depth(Format::Tiff) => data::write_tiff(path, depth),
            Kind::Depth(Format::Exr) => data::write_exr(path, depth, self.sigma()),
            Kind::Depth(Format::Pfm) => data::write_pfm(path, depth),
            Kind::Depth(Format::Color) => {
                let (low, high) = self.forms.range.unwrap_or((0.0, 1.0));
                let colours = colour_map(depth, low, high, self.unit)?;
                data::write_colour_map(path, &colours, (low, high))
            }
            Kind::Depth(Format::Ply) => {
                let cloud = self.forms.cloud.as_ref();
                data::write_ply(path, cloud.map_or(&[], |cloud| &cloud.points))
            }
            Kind::Depth(Format::Json) => {
                data::write_atomically(path, |out| writeln!(out, "{}", self.summary.value()))
            }
            Kind::Sigma => self
                .deviations
                .map_or(Ok(()), |map| data::write_npy(path, map)),
            Kind::Outliers => data::write_atomically(path, |out| {
                out.write_all(self.outliers.as_deref().unwrap_or_default().as_bytes())
            }),
        }
    }

    /// Whether a file holds this already. The same depths make the same bytes; only reports say how
    /// long it took.
    fn is_in(&self, kind: Kind, path: &Path) -> bool {
        if kind == Kind::Depth(Format::Json) {
            let old = std::fs::read_to_string(path);
            return old.is_ok_and(|old| self.summary.is_but_for_times(&old));
        }
        let Ok(folder) = tempfile::tempdir() else {
            return false;
        };
        let again = folder.path().join("again");
        let bytes = |path: &Path| std::fs::read(path).ok();
        self.write(kind, &again).is_ok() && bytes(path) == bytes(&again)
    }
}

/// Checks that a path means a folder of results: an ending that is not one of the formats would
/// make a folder that looks like a file.
pub(super) fn check_folder(path: &Path) -> Result<()> {
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    let like_a_file = ending.starts_with(|c: char| c.is_ascii_alphabetic());
    let text = path.to_string_lossy();
    if !like_a_file || path.is_dir() || text.ends_with(std::path::is_separator) {
        return Ok(());
    }
    Err(Error::config(format!("`{text}` names no folder and no known format")).hint(format!(
        "for one image: .npy, .npz, .png, .tiff, .exr, .pfm, .ply or .json; for a folder: `{text}/`"
    )))
}

fn no_camera() -> Error {
    Error::config("a cloud needs a camera")
        .hint("give --camera FILE, --camera FX,FY,CX,CY, or points of a model of COLMAP")
}

fn write_weights(path: &Path, weights: &[f64]) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
    }
    data::write_atomically(path, |out| {
        let text = serde_json::to_string(weights)?;
        writeln!(out, "{text}")
    })
}

/// Weights that were written.
pub(super) fn read_weights(path: &Path) -> Result<Vec<f64>> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
    serde_json::from_str(&text).map_err(|e| {
        Error::format(path, "holds no weights")
            .because(e)
            .hint("remove it: the video starts anew there")
    })
}
