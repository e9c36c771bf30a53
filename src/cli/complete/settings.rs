//! The settings of a run, resolved from its arguments: defaults filled in, combinations checked.

use crate::cli::args::{Complete, Format, Model, PoseSource, Recorded};
use lsdc_core::fit::{Changes, FitConfig};
use lsdc_core::{DepthNoise, Quality, ViewSettings};
use lsdc_eval::data::{Camera, Colmap, DepthKind, Shard, Unit};
use lsdc_eval::predict::{GuideSpec, Method, Preserve};
use lsdc_eval::sampling::Size;
use lsdc_files::error::{Error, Result};
use lsdc_files::{CloudOptions, DeviationLimits, WorkspaceFormat};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Formats without `--formats`.
const DEFAULT_FORMATS: [Format; 3] = [Format::Npy, Format::Png, Format::Color];

/// The settings of a run. Results of an earlier run are used again only if every serialised field is the same, so a field
/// is skipped only if it does not decide what is in the results of a frame.
#[derive(Debug, Serialize)]
pub(super) struct Settings {
    /// Images, folders, patterns or lists; none for a recording. Input files are compared by their contents.
    #[serde(skip)]
    pub(super) rgb: Vec<PathBuf>,
    #[serde(skip)]
    pub(super) sparse: PathBuf,
    #[serde(skip)]
    pub(super) sigma: Option<PathBuf>,
    #[serde(serialize_with = "as_text::kind")]
    pub(super) guide: Option<GuideSpec>,
    #[serde(serialize_with = "as_text::display")]
    pub(super) depth_unit: Option<Unit>,
    #[serde(serialize_with = "as_text::display")]
    pub(super) depth_kind: Option<DepthKind>,
    #[serde(serialize_with = "as_text::debug")]
    pub(super) camera: Option<Camera>,
    #[serde(serialize_with = "as_text::coefficients")]
    pub(super) noise: Option<DepthNoise>,
    #[serde(skip)]
    pub(super) recording: Recorded,
    pub(super) method: Method,
    /// Weights and device. The record has the contents of the weights, see [`super::record`].
    #[serde(skip)]
    pub(super) model: Model,
    /// Differences from the fit settings of the weights, which the record has in full.
    #[serde(skip)]
    fit: Changes,
    #[serde(skip_serializing_if = "is_default")]
    pub(super) quality: Quality,
    #[serde(skip_serializing_if = "is_default")]
    pub(super) encoder_side: Option<usize>,
    pub(super) full: bool,
    pub(super) size: Option<Size>,
    pub(super) temporal: bool,
    /// Whether points of other images join, and the file of their poses, whose contents are compared for each image.
    #[serde(
        serialize_with = "as_text::is_given",
        skip_serializing_if = "Option::is_none"
    )]
    pub(super) views: Option<PoseSource>,
    /// Which images are neighbours.
    #[serde(
        serialize_with = "as_text::view_settings",
        skip_serializing_if = "is_default"
    )]
    pub(super) neighbours: ViewSettings,
    pub(super) preserve_input: Preserve,
    /// Depths of the first and the last colour of colour maps.
    pub(super) range: Option<(f32, f32)>,
    pub(super) max_sigma: Option<f32>,
    #[serde(skip_serializing_if = "is_default")]
    pub(super) max_relative_sigma: Option<f32>,
    /// Largest relative standard deviation in clouds and workspaces, if a run writes any.
    #[serde(skip_serializing_if = "is_default")]
    measured: Option<f32>,
    voxel: Option<f64>,
    keep_flying: bool,
    /// Whether files of depths hold standard deviations, too.
    sigma_in_files: bool,
    #[serde(skip)]
    pub(super) uncertainty: bool,
    #[serde(skip)]
    pub(super) outliers: bool,
    #[serde(skip)]
    pub(super) formats: Vec<Format>,
    /// Programs that workspaces are written for.
    #[serde(skip)]
    pub(super) exports: Vec<WorkspaceFormat>,
    #[serde(skip)]
    pub(super) destination: Destination,
    #[serde(skip)]
    pub(super) shard: Shard,
    #[serde(skip)]
    pub(super) force: bool,
    #[serde(skip)]
    pub(super) json: bool,
    #[serde(skip)]
    pub(super) checks_alignment: bool,
}

/// Destination of the results.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Destination {
    /// In the folder of the single image.
    BesideImage,
    Folder(PathBuf),
    /// A single file for a single image; or a recording.
    File(PathBuf),
}

impl Settings {
    /// Settings of a run whose results are files.
    ///
    /// # Errors
    /// Options that exclude each other, or that would change nothing.
    pub(super) fn of_files(args: Complete) -> Result<Self> {
        if args.temporal && is_one(&args.rgb) {
            let what = "`--temporal` would change nothing: one image has none before it";
            return Err(Error::config(what).hint("give the images of the video, or leave it out"));
        }
        if args.views.is_some() && is_one(&args.rgb) {
            let what = "`--views` would change nothing: one image has no neighbours";
            return Err(
                Error::config(what).hint("give the images of the sequence, or leave it out")
            );
        }
        let destination = match &args.output {
            None => Destination::BesideImage,
            Some(path) if names_file(&args.rgb, path) => Destination::File(path.clone()),
            Some(path) => {
                check_folder(path)?;
                Destination::Folder(path.clone())
            }
        };
        let formats = match (&destination, &args.formats) {
            (Destination::File(_), Some(_)) => {
                return Err(Error::config(
                    "`-o FILE` and `--formats` name the format twice",
                ));
            }
            (Destination::File(path), None) => Format::of(path).into_iter().collect(),
            (_, Some(formats)) => formats.clone(),
            (_, None) if !args.export.is_empty() => Vec::new(),
            (_, None) => DEFAULT_FORMATS.to_vec(),
        };
        check_export(&args)?;
        if let Some(option) = args.of_clouds()
            && !formats.contains(&Format::Ply)
        {
            let error = Error::config(format!("`{option}` is for clouds"));
            return Err(error.hint("add ply to --formats"));
        }
        if args.range.is_some() && !formats.contains(&Format::Color) {
            let error = Error::config("`--range` is for colour maps");
            return Err(error.hint("add color to --formats"));
        }
        Self::new(args, formats, destination)
    }

    /// Settings of a run whose results go into the recording `output`.
    ///
    /// # Errors
    /// Options of the fit for a method that has none.
    pub(super) fn of_recording(args: Complete, output: &Path) -> Result<Self> {
        Self::new(args, Vec::new(), Destination::File(output.to_owned()))
    }

    fn new(args: Complete, formats: Vec<Format>, destination: Destination) -> Result<Self> {
        check_method(&args)?;
        // Destructured completely, so that a new argument cannot be forgotten.
        let Complete {
            rgb,
            sparse,
            output: _,
            depth_unit,
            depth_kind,
            camera,
            formats: _,
            export,
            max_relative_sigma,
            range,
            max_sigma,
            voxel,
            keep_flying,
            size,
            method,
            fit,
            preserve_input,
            sigma,
            noise,
            guide,
            head,
            uncertainty,
            outliers,
            no_alignment,
            full,
            temporal,
            views,
            views_past,
            views_count,
            shard,
            force,
            json,
            recorded,
            model,
        } = args;
        let usual = ViewSettings::default();
        let has_mask = |format: &WorkspaceFormat| *format != WorkspaceFormat::Splatting;
        let writes_surfaces =
            formats.contains(&Format::Ply) || recorded.cloud || export.iter().any(has_mask);
        let measured = max_relative_sigma.unwrap_or(DeviationLimits::MEASURED as f32);
        let measured = (method == Method::Lsdc && writes_surfaces).then_some(measured);
        let holds_sigma = |format| matches!(format, &Format::Npz | &Format::Exr | &Format::Ply);
        Ok(Self {
            sigma_in_files: uncertainty && formats.iter().any(holds_sigma),
            rgb,
            sparse,
            sigma,
            guide: guide.map(|guide| guide.with_head(head)).transpose()?,
            depth_unit,
            depth_kind,
            camera,
            noise,
            recording: recorded,
            method,
            model,
            fit: fit.changes(),
            quality: fit.quality,
            encoder_side: fit.encoder.side,
            full,
            size,
            temporal,
            views,
            neighbours: ViewSettings {
                only_past: views_past,
                count: views_count.map_or(usual.count, |count| count as usize),
                ..usual
            },
            preserve_input,
            range,
            max_sigma,
            max_relative_sigma,
            measured,
            voxel,
            keep_flying,
            uncertainty,
            outliers,
            formats,
            exports: distinct(export),
            destination,
            shard,
            force,
            json,
            checks_alignment: !no_alignment,
        })
    }

    /// The fit of this run, with weights that have these fit settings.
    pub(super) fn fit(&self, stored: &FitConfig) -> FitConfig {
        stored.changed(&self.fit)
    }

    pub(super) fn writes(&self, format: Format) -> bool {
        self.formats.contains(&format)
    }

    /// The largest standard deviations in depth maps, as they were asked for.
    pub(super) fn limits(&self) -> DeviationLimits {
        DeviationLimits {
            absolute: self.max_sigma,
            relative: self.max_relative_sigma,
        }
    }

    /// Limits in clouds and workspaces: those of measured pixels, unless a share is given.
    pub(super) fn limits_of_surfaces(&self) -> DeviationLimits {
        DeviationLimits {
            relative: self.measured,
            ..self.limits()
        }
    }

    /// Which pixels become points of a cloud.
    pub(super) fn cloud_options(&self) -> CloudOptions {
        CloudOptions {
            limits: self.limits_of_surfaces(),
            keep_flying: self.keep_flying,
            voxel: self.voxel,
        }
    }
}

/// Whether a setting is left out of the record, so that results from before it existed are used again.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Checks that workspaces are of images of a COLMAP model, with the cameras of the model.
fn check_export(args: &Complete) -> Result<()> {
    if args.export.is_empty() {
        return Ok(());
    }
    if is_one(&args.rgb) {
        let what = "`--export` writes workspaces of several images";
        return Err(Error::config(what).hint("give the folder of images, and -o DIR"));
    }
    if args.rgb.is_empty() || !Colmap::is_at(&args.sparse) {
        let what = "`--export` needs the poses of a COLMAP model";
        return Err(Error::config(what).hint("give its folder, such as sparse/0, as the points"));
    }
    if args.camera.is_some() {
        let what = "`--export` writes the cameras of the model, not `--camera`";
        return Err(Error::config(what).hint("leave --camera out"));
    }
    Ok(())
}

/// The elements without those that were there before.
fn distinct(exports: Vec<WorkspaceFormat>) -> Vec<WorkspaceFormat> {
    let mut found = Vec::new();
    for export in exports {
        if !found.contains(&export) {
            found.push(export);
        }
    }
    found
}

/// Checks that options of the fit are given for a method that has one.
fn check_method(args: &Complete) -> Result<()> {
    if args.method == Method::Lsdc {
        return Ok(());
    }
    let options = [
        ("`--size`", args.size.is_some()),
        ("`--sigma`", args.sigma.is_some()),
        ("`--noise`", args.noise.is_some()),
        ("`--guide`", args.guide.is_some()),
        ("`--uncertainty`", args.uncertainty),
        ("`--max-sigma`", args.max_sigma.is_some()),
        ("`--max-relative-sigma`", args.max_relative_sigma.is_some()),
        ("`--outliers`", args.outliers),
        ("`--temporal`", args.temporal),
        ("`--views`", args.views.is_some()),
        ("`--full`", args.full),
    ];
    let given = options.into_iter().filter(|(_, given)| *given);
    let given = given.map(|(name, _)| name).chain(args.fit.given());
    let given: Vec<&str> = given.collect();
    if given.is_empty() {
        return Ok(());
    }
    Err(Error::config(format!(
        "{}: options that need method `lsdc`",
        given.join(", ")
    )))
}

/// Whether one image is given, whose results may lie beside it.
pub(super) fn is_one(rgb: &[PathBuf]) -> bool {
    matches!(rgb, [path] if !path.is_dir() && !is_pattern(path) && !is_list(path))
}

pub(super) fn is_list(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "txt")
}

pub(super) fn is_pattern(path: &Path) -> bool {
    !path.exists() && path.to_string_lossy().contains(['*', '?', '['])
}

/// Whether `output` is one file of one image.
fn names_file(rgb: &[PathBuf], output: &Path) -> bool {
    is_one(rgb) && !output.is_dir() && Format::of(output).is_some()
}

/// Checks that a path names a folder of results: with an ending that is not one of the formats, the folder would look
/// like a file.
fn check_folder(path: &Path) -> Result<()> {
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

/// Serialisation of values as text.
mod as_text {
    #![expect(clippy::ref_option, reason = "serde passes fields by reference")]

    use super::{DepthNoise, GuideSpec, ViewSettings};
    use serde::{Serialize as _, Serializer};
    use std::fmt::{Debug, Display};

    /// The kind alone: the file of a guide is an input of each frame. Or the network with size and head.
    pub(super) fn kind<S: Serializer>(guide: &Option<GuideSpec>, to: S) -> Result<S::Ok, S::Error> {
        let kind = guide.as_ref().map(|guide| match guide {
            GuideSpec::Files(source) => format!("{:?}", source.kind),
            GuideSpec::None | GuideSpec::DepthAnything(_) => guide.to_string(),
        });
        kind.serialize(to)
    }

    pub(super) fn display<T: Display, S: Serializer>(
        value: &Option<T>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        let text = value.as_ref().map(ToString::to_string);
        text.serialize(to)
    }

    pub(super) fn debug<T: Debug, S: Serializer>(
        value: &Option<T>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        let text = value.as_ref().map(|value| format!("{value:?}"));
        text.serialize(to)
    }

    pub(super) fn is_given<T, S: Serializer>(value: &Option<T>, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_bool(value.is_some())
    }

    /// The numbers that options set.
    pub(super) fn view_settings<S: Serializer>(
        settings: &ViewSettings,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        (settings.count, settings.only_past).serialize(to)
    }

    pub(super) fn coefficients<S: Serializer>(
        noise: &Option<DepthNoise>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        noise.map(DepthNoise::coefficients).serialize(to)
    }
}
