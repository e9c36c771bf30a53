//! `lsdc fuse`: one surface from completed frames with poses.

mod frames;

use super::args::Fuse;
use super::{Exit, ui};
use frames::{Loaded, Source, sources};
use lsdc_core::{Channels, DepthMap, Image};
use lsdc_eval::data::{check_output, write_atomically};
use lsdc_files::error::{Error, Result};
use lsdc_files::{DeviationLimits, Poses, has_ending};
use lsdc_fusion::{Frame, Fusion, Mesh, Report, Settings, Up, VoxelSize, voxel_size};
use serde_json::json;
use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

/// Frames that the size of the voxels is derived from.
const SAMPLED: usize = 9;

pub(super) fn run(args: &Fuse) -> Result<Exit> {
    let glb = has_ending(&args.output, "glb");
    if !glb && !has_ending(&args.output, "ply") {
        let what = format!("`{}` is neither .ply nor .glb", args.output.display());
        return Err(Error::config(what));
    }
    check_output(&args.output, args.force)?;
    let settings = settings(args)?;
    let poses = Poses::open(&args.poses)?;
    for warning in poses.warnings() {
        ui::warn(&format!("warning: {}: {warning}", args.poses.display()));
    }
    let all = sources(&args.results, args.images.as_deref())?;
    let all: Vec<Source> = all.into_iter().step_by(args.every as usize).collect();
    let total = all.len();
    let (posed, without): (Vec<Source>, Vec<Source>) = all
        .into_iter()
        .partition(|one| poses.of(&one.name).is_some());
    let Some(first) = posed.first() else {
        let found = format!("none of {} has a pose", ui::counted(total, "frame"));
        return Err(Error::format(&args.poses, found).hint(format!(
            "frames are called as `{}`; poses are found by name, time in seconds or number",
            without.first().map_or("", |one| &one.name)
        )));
    };
    // A camera that is missing, or of another shape, is so in all frames.
    first.load(&poses, args)?;
    let stop = ui::stop_flag();
    let mut run = Run {
        args,
        poses: &poses,
        frames: &posed,
        stop: &stop,
        failed: 0,
    };
    let Some(fused) = run.fused(settings)? else {
        return Ok(Exit::Interrupted);
    };
    let failed = run.failed;
    let mut mesh = fused.fusion.mesh().map_err(described)?;
    if mesh.positions.is_empty() {
        return Err(
            Error::fit("the frames have no surface in common with the voxels")
                .hint("give larger voxels with --voxel, or check the unit of depths and poses"),
        );
    }
    if args.points {
        mesh = mesh.into_points();
    }
    let up = args.up.or(fused.up);
    write_atomically(&args.output, |out| match up {
        Some(up) if glb => mesh.write_glb(up, out),
        _ => mesh.write_ply(out),
    })?;
    let summary = Summary {
        args,
        total,
        without_pose: without.len(),
        failed,
        report: fused.fusion.report(),
        size: fused.size,
        mesh: &mesh,
        up: up.filter(|_| glb),
    };
    if args.json {
        ui::print(&summary.json().to_string());
    } else {
        summary.lines().iter().for_each(|line| ui::tell(line));
    }
    Ok(if failed > 0 {
        Exit::Partial
    } else {
        Exit::Done
    })
}

fn settings(args: &Fuse) -> Result<Settings> {
    let defaults = Settings::default();
    let gib = args
        .max_memory
        .unwrap_or(defaults.max_memory as f64 / f64::from(1 << 30));
    if !(gib > 0.0 && gib.is_finite()) {
        return Err(Error::config(format!(
            "`--max-memory {gib}` is not above 0"
        )));
    }
    let settings = Settings {
        voxel: args.voxel,
        max_depth: args.max_depth.unwrap_or(defaults.max_depth),
        max_deviation: args.max_deviation.unwrap_or(DeviationLimits::MEASURED),
        max_memory: (gib * f64::from(1 << 30)) as usize,
        ..defaults
    };
    Fusion::new(settings.clone()).map_err(described)?;
    Ok(settings)
}

/// An error of the library with its hint.
fn described(error: lsdc_fusion::Error) -> Error {
    match error {
        lsdc_fusion::Error::Core(error) => error.into(),
        error => {
            let found = Error::config(error.to_string());
            match error.hint() {
                Some(hint) => found.hint(hint),
                None => found,
            }
        }
    }
}

/// Frames that are fused.
struct Run<'a> {
    args: &'a Fuse,
    poses: &'a Poses,
    frames: &'a [Source],
    stop: &'a AtomicBool,
    /// Frames that could not be read.
    failed: usize,
}

/// The result of fusing all frames.
struct Fused {
    fusion: Fusion,
    /// How the voxel size was derived, if it was not given.
    size: Option<VoxelSize>,
    up: Option<Up>,
}

impl Run<'_> {
    /// Fuses all frames, in voxels that fit into the memory; `None` if it was interrupted.
    fn fused(&mut self, mut settings: Settings) -> Result<Option<Fused>> {
        let size = match settings.voxel {
            Some(_) => None,
            None => Some(self.voxel_size(&settings)?),
        };
        settings.voxel = settings.voxel.or(size.map(|size| size.edge));
        loop {
            let edge = settings.voxel.unwrap_or_default();
            match self.pass(&settings) {
                Err(error @ lsdc_fusion::Error::Memory { .. }) if size.is_some() => {
                    ui::warn(&format!(
                        "warning: {error}; all frames are fused again in voxels of {}",
                        length(2.0 * edge)
                    ));
                    settings.voxel = Some(2.0 * edge);
                }
                Err(error) => return Err(described(error)),
                Ok(None) => return Ok(None),
                Ok(Some((fusion, up))) => return Ok(Some(Fused { fusion, size, up })),
            }
        }
    }

    /// The size of voxels for frames at equal intervals.
    fn voxel_size(&self, settings: &Settings) -> Result<VoxelSize> {
        let step = self.frames.len().div_ceil(SAMPLED);
        let sampled = self.frames.iter().step_by(step);
        let loaded: Vec<Loaded> = sampled
            .filter_map(|one| one.load(self.poses, self.args).ok())
            .collect();
        let frames: Vec<Frame<'_>> = loaded.iter().map(|one| one.frame(None)).collect();
        voxel_size(&frames, settings).map_err(described)
    }

    /// Fuses all frames once, and returns which axis is up; frames that cannot be read are reported and counted.
    fn pass(&mut self, settings: &Settings) -> lsdc_fusion::Result<Option<(Fusion, Option<Up>)>> {
        let mut fusion = Fusion::new(settings.clone())?;
        let mut cameras = Vec::with_capacity(self.frames.len());
        let mut told = BTreeSet::new();
        self.failed = 0;
        let bar = ui::bar(self.frames.len(), "frames");
        for source in self.frames {
            if ui::unless(self.stop).is_break() {
                bar.finish_and_clear();
                return Ok(None);
            }
            let loaded = match source.load(self.poses, self.args) {
                Ok(loaded) => loaded,
                Err(error) => {
                    ui::print_failure(source.name.as_ref(), &error);
                    self.failed += 1;
                    continue;
                }
            };
            for remark in &loaded.remarks {
                if told.insert(remark.clone()) {
                    ui::warn(&format!("warning: {}: {remark}", source.name));
                }
            }
            match loaded.integrate(&mut fusion) {
                Ok(()) => cameras.push(loaded.camera),
                Err(error @ lsdc_fusion::Error::Memory { .. }) => {
                    bar.finish_and_clear();
                    return Err(error);
                }
                Err(error) => {
                    ui::print_failure(source.name.as_ref(), &described(error));
                    self.failed += 1;
                }
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(Some((fusion, Up::of_cameras(&cameras))))
    }
}

impl Loaded {
    fn frame<'a>(&'a self, image: Option<&'a Image<'a>>) -> Frame<'a> {
        Frame {
            depth: &self.depth,
            deviation: self.deviation.as_ref().map(DepthMap::values),
            camera: &self.camera,
            image,
        }
    }

    fn integrate(&self, fusion: &mut Fusion) -> lsdc_fusion::Result<()> {
        let rgb = self.image.as_ref();
        let image = rgb.map(|rgb| {
            let (width, height) = (rgb.width() as usize, rgb.height() as usize);
            Image::new(width, height, Channels::Rgb, rgb.as_raw())
        });
        let image = image.transpose()?;
        fusion.integrate(&self.frame(image.as_ref()))
    }
}

/// The printed summary of a surface.
struct Summary<'a> {
    args: &'a Fuse,
    total: usize,
    without_pose: usize,
    failed: usize,
    report: &'a Report,
    size: Option<VoxelSize>,
    mesh: &'a Mesh,
    up: Option<Up>,
}

impl Summary<'_> {
    fn lines(&self) -> Vec<String> {
        let report = self.report;
        let others = [
            (self.without_pose, "without a pose"),
            (self.failed, "failed"),
        ];
        let others = others.into_iter().filter(|(count, _)| *count > 0);
        let mut frames = vec![format!("frames    {} of {}", report.frames, self.total)];
        frames.extend(others.map(|(count, what)| format!("{count} {what}")));
        let frames = frames.join(", ");
        let derived = self.size.map_or(String::new(), |size| {
            let deviation = size.deviation.map_or(String::new(), |deviation| {
                format!(", of a standard deviation {}", length(deviation))
            });
            format!(
                " (median width of a pixel {}{deviation})",
                length(size.footprint)
            )
        });
        let reasons = report.left_out.reasons().into_iter();
        let reasons: Vec<String> = reasons
            .filter(|(_, count)| *count > 0)
            .map(|(reason, count)| format!("{count} {reason}"))
            .collect();
        let mut lines = vec![
            frames,
            format!("voxels    {}{derived}", length(report.voxel)),
            format!(
                "memory    {}, {} MiB",
                ui::counted(report.blocks, "block"),
                report.memory >> 20
            ),
            format!(
                "pixels    {} fused, {} left out",
                report.pixels,
                report.left_out.total()
            ),
        ];
        if !reasons.is_empty() {
            lines.push(format!("left out  {}", reasons.join(", ")));
        }
        let vertices = self.mesh.positions.len();
        lines.push(if self.args.points {
            format!("points    {vertices}")
        } else {
            let triangles = self.mesh.triangles.len();
            format!("surface   {vertices} vertices, {triangles} triangles")
        });
        if self.mesh.colours.is_some() && self.mesh.uncoloured > 0 {
            lines.push(format!(
                "colours   {} vertices have none: grey",
                self.mesh.uncoloured
            ));
        }
        if let Some(up) = self.up {
            let source = if self.args.up.is_some() {
                "--up"
            } else {
                "the cameras"
            };
            lines.push(format!(
                "up        {up} of the world, by {source}; y in the file"
            ));
        }
        lines.push(format!("written   {}", self.args.output.display()));
        lines
    }

    fn json(&self) -> serde_json::Value {
        let report = self.report;
        let left_out: serde_json::Map<String, serde_json::Value> = report
            .left_out
            .reasons()
            .into_iter()
            .map(|(reason, count)| (reason.replace(' ', "_"), json!(count)))
            .collect();
        json!({
            "frames": report.frames, "frames_found": self.total,
            "frames_without_pose": self.without_pose, "frames_failed": self.failed,
            "voxel": report.voxel,
            "pixel_footprint": self.size.map(|size| size.footprint),
            "median_deviation": self.size.and_then(|size| size.deviation),
            "blocks": report.blocks, "memory": report.memory,
            "pixels": report.pixels, "pixels_left_out": left_out,
            "vertices": self.mesh.positions.len(), "triangles": self.mesh.triangles.len(),
            "uncoloured_vertices": self.mesh.uncoloured,
            "up": self.up.map(|up| up.to_string()),
            "file": self.args.output.display().to_string(),
        })
    }
}

/// A length in metres, to three digits.
fn length(metres: f64) -> String {
    let digits = (2.0 - metres.abs().max(f64::MIN_POSITIVE).log10().floor()).clamp(0.0, 9.0);
    format!("{metres:.*} m", digits as usize)
}
