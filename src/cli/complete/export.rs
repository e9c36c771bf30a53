//! Workspaces for other programs, filled with the completed frames.

use super::frame::Completed;
use super::job::Job;
use super::loaded::Loaded;
use super::settings::Settings;
use crate::cli::ui::{self, counted};
use lsdc_eval::data::{self, Colmap, DepthMap, Unit};
use lsdc_files::error::Result;
use lsdc_files::{
    Camera, DeviationLimits, Workspace, WorkspaceCounts, WorkspaceFormat, WorkspaceFrame,
    WorkspaceImages,
};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The workspaces of a run, below its folder of results.
pub(super) fn workspaces(
    settings: &Settings,
    model: Option<&Colmap>,
    output: &Path,
) -> Result<Vec<Workspace>> {
    let of = |model, format: &WorkspaceFormat| {
        let folder = output.join(format.name());
        Workspace::new(*format, folder, &settings.sparse, model)
    };
    let formats = settings.exports.iter();
    model.map_or(Ok(Vec::new()), |model| {
        formats.map(|format| of(model, format)).collect()
    })
}

/// Writes the lists of the images in the workspaces, and prints how many there are.
pub(super) fn finish(workspaces: &[Workspace], json: bool) -> Result<()> {
    let tell = if json { ui::say } else { ui::tell };
    for workspace in workspaces {
        let WorkspaceImages {
            with_depth,
            without_depth,
        } = workspace.finish()?;
        tell(&format!(
            "exported  {} for {} in {}",
            counted(with_depth, "image"),
            workspace.format(),
            workspace.folder().display()
        ));
        if without_depth > 0 && workspace.format() == WorkspaceFormat::Splatting {
            ui::warn(&format!(
                "warning: {} of the model without depth: the loader of splatting needs the depth of every image",
                counted(without_depth, "image")
            ));
        }
    }
    Ok(())
}

/// An image in the workspaces of a run.
pub(super) struct Export<'a> {
    workspaces: &'a [Workspace],
    image: PathBuf,
    /// The name of the image in the model.
    name: String,
}

/// The encoded depths of a frame, one for each workspace.
pub(super) struct Exported {
    frames: Vec<WorkspaceFrame>,
    counts: ExportCounts,
}

/// Pixels that the workspaces store otherwise than their depth: the sum over the images; in each image, the most of any
/// workspace.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct ExportCounts {
    /// Left empty because their standard deviation is too large.
    uncertain: usize,
    /// Whether a workspace is for a program that reads empty pixels as infinitely far.
    #[serde(skip)]
    needs_all: bool,
    #[serde(flatten)]
    pixels: WorkspaceCounts,
}

impl<'a> Export<'a> {
    /// Returns the export of an image of a model, if there are workspaces.
    pub(super) fn of(workspaces: &'a [Workspace], job: &Job) -> Option<Self> {
        let view = job.view().filter(|_| !workspaces.is_empty())?;
        Some(Self {
            workspaces,
            image: job.image.clone(),
            name: view.name.clone(),
        })
    }

    pub(super) fn exists(&self) -> bool {
        self.workspaces.iter().all(|one| one.has(&self.name))
    }

    pub(super) fn any_exists(&self) -> bool {
        self.workspaces.iter().any(|one| one.has_any(&self.name))
    }

    /// Encodes a completed frame. Depths return to the unit of the model.
    pub(super) fn encode(
        &self,
        settings: &Settings,
        frame: &Loaded,
        found: &Completed,
    ) -> Result<Exported> {
        let certain = |limits: DeviationLimits| {
            let (depth, uncertain) = match found.deviations() {
                Some(deviations) => {
                    data::without_uncertain(found.filled().clone(), deviations, &limits)?
                }
                None => (found.depth.clone(), 0),
            };
            in_model_unit(depth, settings.depth_unit).map(|depth| (depth, uncertain))
        };
        let measured = certain(settings.limits_of_surfaces())?;
        let wanted = certain(settings.limits())?;
        // The code of splatting has no mask: pixels are left empty only if that was asked for.
        let of = |one: &Workspace| {
            if one.format() == WorkspaceFormat::Splatting {
                &wanted
            } else {
                &measured
            }
        };
        let uncertain = self.workspaces.iter().map(|one| of(one).1).max();
        let camera: Option<&Camera> = frame.camera.as_ref();
        let workspaces = self.workspaces.iter();
        let frames = workspaces.map(|one| one.encode(&self.name, &of(one).0, camera));
        let frames: Vec<WorkspaceFrame> = frames.collect::<Result<_>>()?;
        let mut pixels = WorkspaceCounts::default();
        for frame in &frames {
            pixels = pixels.max(frame.counts);
        }
        let mut formats = self.workspaces.iter().map(Workspace::format);
        Ok(Exported {
            frames,
            counts: ExportCounts {
                uncertain: uncertain.unwrap_or(0),
                needs_all: formats.any(|format| format == WorkspaceFormat::Splatting),
                pixels,
            },
        })
    }

    pub(super) fn write(&self, exported: &Exported, force: bool) -> Result<()> {
        let pairs = self.workspaces.iter().zip(&exported.frames);
        for (workspace, frame) in pairs {
            workspace.write(frame, &self.image, force)?;
        }
        Ok(())
    }
}

impl Exported {
    pub(super) fn counts(&self) -> ExportCounts {
        self.counts
    }
}

impl ExportCounts {
    /// Adds the pixels of another image.
    pub(super) fn add(&mut self, other: Self) {
        self.uncertain += other.uncertain;
        self.needs_all |= other.needs_all;
        self.pixels.add(other.pixels);
    }

    /// Lines of the summary.
    pub(super) fn lines(self) -> Vec<String> {
        let Self {
            uncertain,
            needs_all,
            pixels,
        } = self;
        let line = |count: usize, what: &str| {
            (count > 0).then(|| format!("exported  {} {what}", counted(count, "pixel")))
        };
        let far = "read as infinitely far by the published splatting code, which has no mask";
        let lines = [
            line(
                uncertain,
                "left empty: their standard deviation is too large",
            ),
            line(pixels.empty, far).filter(|_| needs_all),
            line(
                pixels.without_normal,
                "with a depth but no normal, as they have no neighbours",
            ),
            line(
                pixels.nearest,
                "nearer than the format stores, set to its nearest depth",
            ),
            line(
                pixels.farthest,
                "farther than the format stores, set to its farthest depth",
            ),
        ];
        lines.into_iter().flatten().collect()
    }
}

/// Depths in the unit of the model, of depths in the unit of the results.
fn in_model_unit(depth: DepthMap, unit: Option<Unit>) -> Result<DepthMap> {
    let Some(factor) = unit.map(Unit::metres).filter(|factor| *factor != 1.0) else {
        return Ok(depth);
    };
    let (width, height) = (depth.width(), depth.height());
    let values = depth.into_values().into_iter();
    let values = values.map(|v| (f64::from(v) / factor) as f32).collect();
    Ok(DepthMap::new(width, height, values)?)
}
