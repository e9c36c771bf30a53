//! The files of a result.

use super::export::{Export, Exported};
use super::frame::Completed;
use super::job::Job;
use super::loaded::Loaded;
use super::record;
use super::settings::{Destination, Settings};
use super::summary::Summary;
use crate::cli::args::Format;
use lsdc_eval::data::{self, Camera, ColoredCloud, DepthMap, Unit};
use lsdc_eval::report::{colour_map, usual_range};
use lsdc_files::error::{Error, Result};
use lsdc_files::{DescribedPng, Workspace};
use std::path::{Path, PathBuf};

/// The files of a result.
pub(super) struct Outputs<'a> {
    settings: &'a Settings,
    folder: PathBuf,
    files: Vec<(Kind, PathBuf)>,
    /// The image in the workspaces for other programs.
    export: Option<Export<'a>>,
    /// In a video, the file of the weights from which the next frame starts.
    state: Option<PathBuf>,
}

/// Data that formats need besides the depths.
#[derive(Default)]
pub(super) struct FormatData {
    /// Depths of the first and the last colour of a colour map.
    pub(super) color_range: Option<(f32, f32)>,
    pub(super) png: Option<DescribedPng>,
    pub(super) cloud: Option<ColoredCloud>,
    pub(super) exported: Option<Exported>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Depth(Format),
    Sigma,
    Outliers,
}

impl<'a> Outputs<'a> {
    /// Outputs of a single image: in the folder `-o`, in the file `-o`, or beside the image.
    pub(super) fn beside(settings: &'a Settings, job: &Job) -> Self {
        match &settings.destination {
            Destination::File(path) => {
                let folder = path.parent().unwrap_or(Path::new(""));
                let mut outputs = Self::of(settings, folder, path);
                for (kind, named) in &mut outputs.files {
                    if matches!(kind, Kind::Depth(_)) {
                        named.clone_from(path);
                    }
                }
                outputs
            }
            Destination::Folder(folder) => Self::of(settings, folder, &job.name),
            Destination::BesideImage => {
                let folder = settings.rgb[0].parent().unwrap_or(Path::new(""));
                Self::of(settings, folder, &job.name)
            }
        }
    }

    /// Outputs of one image among many.
    pub(super) fn below(
        settings: &'a Settings,
        workspaces: &'a [Workspace],
        output: &Path,
        job: &Job,
    ) -> Self {
        let folder = match job.name.parent() {
            Some(below) if !below.as_os_str().is_empty() => &output.join(below),
            _ => output,
        };
        Self {
            export: Export::of(workspaces, job),
            state: settings.temporal.then(|| record::state(output, job)),
            ..Self::of(settings, folder, &job.name)
        }
    }

    /// Files in a folder, which are called as `name` is but for its ending.
    fn of(settings: &'a Settings, folder: &Path, name: &Path) -> Self {
        let stem = name.file_stem().unwrap_or_default().to_string_lossy();
        let path = |end: &str| folder.join(format!("{stem}_{end}"));
        let depths = settings.formats.iter();
        let mut files: Vec<(Kind, PathBuf)> = depths
            .map(|&format| (Kind::Depth(format), path(format.end())))
            .collect();
        if settings.uncertainty {
            files.push((Kind::Sigma, path("sigma.npy")));
        }
        if settings.outliers {
            files.push((Kind::Outliers, path("outliers.csv")));
        }
        Self {
            settings,
            folder: folder.to_owned(),
            files,
            export: None,
            state: None,
        }
    }

    /// In a video, the file of the weights from which the next frame starts.
    pub(super) fn weights(&self) -> Option<&Path> {
        self.state.as_deref()
    }

    /// The list of outliers, if there is one.
    pub(super) fn outliers(&self) -> Option<&Path> {
        let mut files = self.files.iter();
        let found = files.find(|(kind, _)| *kind == Kind::Outliers);
        found.map(|(_, path)| path.as_path())
    }

    /// Lists all files by name, for people.
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

    /// Folder of the files.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// The first file.
    pub(super) fn first(&self) -> &Path {
        self.files.first().map_or(&self.folder, |(_, path)| path)
    }

    /// Checks that the files can be written, before anything is computed.
    pub(super) fn check_writable(&self) -> Result<()> {
        data::check_writable(&self.folder)
    }

    /// Checks that no output file is also an input.
    pub(super) fn check_apart(&self, job: &Job) -> Result<()> {
        let real = |path: &Path| path.canonicalize().ok();
        for (what, input) in job.inputs(self.settings) {
            let input = real(input.path());
            let mut files = self.files.iter().map(|(_, path)| path);
            if let Some(path) = files.find(|path| input.is_some() && real(path) == input) {
                let found = format!("`{}` is the {what}", path.display());
                return Err(Error::config(found).hint("give another folder or file with -o"));
            }
        }
        Ok(())
    }

    /// Computes the data that the formats need besides the depths.
    pub(super) fn format_data(&self, frame: &Loaded, found: &Completed) -> Result<FormatData> {
        let png = || DescribedPng::new(&found.depth);
        let points = || -> Result<ColoredCloud> {
            let camera = frame.camera.as_ref().ok_or_else(no_camera)?;
            Ok(cloud(self.settings, frame, found, camera))
        };
        let range = || {
            let range = self.settings.range.or(usual_range(&found.depth));
            range.unwrap_or((0.0, 1.0))
        };
        Ok(FormatData {
            color_range: self.settings.writes(Format::Color).then(range),
            png: self.settings.writes(Format::Png).then(png).transpose()?,
            cloud: self.settings.writes(Format::Ply).then(points).transpose()?,
            exported: self
                .export
                .as_ref()
                .map(|export| export.encode(self.settings, frame, found))
                .transpose()?,
        })
    }

    /// Whether any of the files is there.
    pub(super) fn any_exists(&self) -> bool {
        self.files.iter().any(|(_, path)| data::would_replace(path))
            || self.export.as_ref().is_some_and(Export::any_exists)
    }

    /// Whether all files are there; a pipe or device keeps nothing.
    pub(super) fn exist(&self) -> bool {
        let mut files = self.files.iter().map(|(_, path)| path);
        files.all(|path| path.is_file())
            && self.export.as_ref().is_none_or(Export::exists)
            && self.state.as_ref().is_none_or(|path| path.is_file())
    }

    /// Writes what was asked for. An existing file is replaced only by an equal one, or with
    /// `--force`; else nothing is written. So what an interrupted run has left is no obstacle.
    pub(super) fn write(
        &self,
        frame: &Loaded,
        found: &Completed,
        format_data: &FormatData,
        summary: &Summary,
    ) -> Result<()> {
        let result = Contents {
            settings: self.settings,
            frame,
            found,
            format_data,
            summary,
        };
        for (kind, path) in &self.files {
            if !self.settings.force && data::would_replace(path) && !result.is_in(*kind, path) {
                return Err(Error::config(format!("`{}` exists", path.display()))
                    .hint("give --force to replace it, or -o DIR to write elsewhere"));
            }
        }
        if !self.folder.as_os_str().is_empty() && !self.files.is_empty() {
            std::fs::create_dir_all(&self.folder).map_err(|e| Error::write(&self.folder, e))?;
        }
        self.files
            .iter()
            .try_for_each(|(kind, path)| result.write(*kind, path))?;
        if let (Some(export), Some(exported)) = (&self.export, &format_data.exported) {
            export.write(exported, self.settings.force)?;
        }
        match (&self.state, &found.diagnostics) {
            (Some(path), Some(found)) => write_weights(path, found.completion.weights()),
            _ => Ok(()),
        }
    }
}

/// The contents of the files.
struct Contents<'a> {
    settings: &'a Settings,
    frame: &'a Loaded,
    found: &'a Completed,
    format_data: &'a FormatData,
    summary: &'a Summary,
}

impl Contents<'_> {
    /// Deviations that are asked for, not only needed.
    fn sigma(&self) -> Option<&DepthMap> {
        let deviations = self.found.deviations();
        deviations.filter(|_| self.settings.uncertainty)
    }

    fn write(&self, kind: Kind, path: &Path) -> Result<()> {
        let depth = &self.found.depth;
        match kind {
            Kind::Depth(Format::Npy) => data::write_npy(path, depth),
            Kind::Depth(Format::Npz) => {
                let mut maps = vec![("depth", depth)];
                maps.extend(self.sigma().map(|map| ("sigma", map)));
                data::write_npz(path, &maps)
            }
            Kind::Depth(Format::Png) => {
                let unit = self
                    .format_data
                    .png
                    .map_or(Unit::MILLIMETRE, |png| png.unit);
                data::write_depth_png(path, depth, unit.metres())
            }
            Kind::Depth(Format::Tiff) => data::write_tiff(path, depth),
            Kind::Depth(Format::Exr) => data::write_exr(path, depth, self.sigma()),
            Kind::Depth(Format::Pfm) => data::write_pfm(path, depth),
            Kind::Depth(Format::Color) => {
                let (low, high) = self.format_data.color_range.unwrap_or((0.0, 1.0));
                let colours = colour_map(depth, low, high, self.summary.metres())?;
                data::write_colour_map(path, &colours, (low, high))
            }
            Kind::Depth(Format::Ply) => {
                let cloud = self.format_data.cloud.as_ref();
                data::write_ply(path, cloud.map_or(&[], |cloud| &cloud.points))
            }
            Kind::Depth(Format::Json) => {
                data::write_atomically(path, |out| writeln!(out, "{}", self.summary.value()))
            }
            Kind::Sigma => self
                .found
                .deviations()
                .map_or(Ok(()), |map| data::write_npy(path, map)),
            Kind::Outliers => {
                let diagnostics = self.found.diagnostics.as_ref();
                let list = diagnostics.map(|found| found.outliers_csv(&self.frame.points));
                data::write_atomically(path, |out| {
                    out.write_all(list.unwrap_or_default().as_bytes())
                })
            }
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

/// The points of a result. They have standard deviations if these were asked for.
pub(super) fn cloud(
    settings: &Settings,
    frame: &Loaded,
    found: &Completed,
    camera: &Camera,
) -> ColoredCloud {
    let deviations = found.deviations();
    let options = settings.cloud_options();
    let mut cloud = ColoredCloud::new(found.filled(), deviations, &frame.rgb, camera, &options);
    if !(settings.uncertainty || settings.limits().is_any()) {
        cloud.points.iter_mut().for_each(|point| point.sigma = None);
    }
    cloud
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
