//! The files of a result.

use super::Complete;
use super::frame::Completed;
use crate::cli::args::Format;
use crate::data::{self, DepthMap, Sparse, Unit};
use crate::error::{Error, Result};
use crate::report::coloured;
use std::path::{Path, PathBuf};

/// The files of a result.
pub(super) struct Outputs {
    folder: PathBuf,
    depths: Vec<(Format, PathBuf)>,
    /// Of maps of standard deviations, and of lists of outliers.
    sigma: Option<PathBuf>,
    outliers: Option<PathBuf>,
    force: bool,
}

impl Outputs {
    /// Of a frame of that name, in a folder.
    pub(super) fn new(args: &Complete, folder: &Path, stem: &str) -> Self {
        let path = |end: &str| folder.join(format!("{stem}_{end}"));
        let depths = args.formats.iter().map(|&format| {
            let end = match format {
                Format::Npy => "depth.npy",
                Format::Npz => "depth.npz",
                Format::Png => "depth.png",
                Format::Tiff => "depth.tiff",
                Format::Exr => "depth.exr",
                Format::Pfm => "depth.pfm",
                Format::Color => "depth_color.png",
            };
            (format, path(end))
        });
        Self {
            folder: folder.to_owned(),
            depths: depths.collect(),
            sigma: args.uncertainty.then(|| path("sigma.npy")),
            outliers: args.outliers.then(|| path("outliers.csv")),
            force: args.force,
        }
    }

    /// The file that is named first.
    pub(super) fn first(&self) -> &Path {
        self.depths.first().map_or(&self.folder, |(_, path)| path)
    }

    /// Whether all files are there.
    pub(super) fn exist(&self) -> bool {
        let depths = self.depths.iter().map(|(_, path)| path);
        let mut all = depths.chain(&self.sigma).chain(&self.outliers);
        all.all(|path| path.exists())
    }

    /// Writes what was asked for. An existing file is replaced only by an equal one, or with
    /// `--force`; else nothing is written. So what an interrupted run has left is no obstacle.
    pub(super) fn write(&self, found: &Completed, sparse: &DepthMap) -> Result<()> {
        let depth = &found.depth;
        let fitted = found.fitted.as_ref();
        let deviations = fitted.and_then(|fitted| fitted.deviations.as_ref());
        let sigma = self.sigma.as_deref().zip(deviations);
        let list = self.outliers.as_deref().zip(fitted);
        let list = list.map(|(path, fitted)| (path, fitted.outliers(sparse)));

        for (format, path) in &self.depths {
            self.replaceable(path, format.is_same(path, depth))?;
        }
        let same =
            |path: &Path, map: &DepthMap| data::read_npy(path, 1.0).is_ok_and(|old| old == *map);
        if let Some((path, map)) = sigma {
            self.replaceable(path, same(path, map))?;
        }
        if let Some((path, text)) = &list {
            let old = std::fs::read_to_string(path);
            self.replaceable(path, old.is_ok_and(|old| old == *text))?;
        }

        std::fs::create_dir_all(&self.folder).map_err(|e| Error::write(&self.folder, e))?;
        for (format, path) in &self.depths {
            match format {
                Format::Npy => data::write_npy(path, depth),
                Format::Npz => {
                    let maps = [("depth", Some(depth)), ("sigma", deviations)];
                    let maps = maps
                        .into_iter()
                        .filter_map(|(name, map)| Some((name, map?)));
                    data::write_npz(path, &maps.collect::<Vec<_>>())
                }
                Format::Png => data::write_depth_png(path, depth, Unit::MILLIMETRE.metres()),
                Format::Tiff => data::write_tiff(path, depth),
                Format::Exr => data::write_exr(path, depth, deviations),
                Format::Pfm => data::write_pfm(path, depth),
                Format::Color => {
                    let (low, high) = depth.range().unwrap_or((0.0, 1.0));
                    data::write_rgb(path, &coloured(depth, low, high))
                }
            }?;
        }
        if let Some((path, map)) = sigma {
            data::write_npy(path, map)?;
        }
        if let Some((path, text)) = list {
            data::write_atomically(path, |out| out.write_all(text.as_bytes()))?;
        }
        Ok(())
    }

    fn replaceable(&self, path: &Path, same: bool) -> Result<()> {
        if self.force || same || !path.exists() {
            return Ok(());
        }
        Err(Error::config(format!("`{}` exists", path.display()))
            .hint("give --force to replace it, or -o DIR to write elsewhere"))
    }
}

impl Format {
    /// Whether a file holds a depth map, as exactly as the format does.
    fn is_same(self, path: &Path, depth: &DepthMap) -> bool {
        let size = (depth.width(), depth.height());
        match self {
            Self::Color => {
                let (low, high) = depth.range().unwrap_or((0.0, 1.0));
                data::read_rgb(path).is_ok_and(|old| old == coloured(depth, low, high))
            }
            Self::Png => data::read_depth_png(path, Unit::MILLIMETRE.metres()).is_ok_and(|old| {
                /// What 16 bits of millimetres hold, and half of the last.
                const MOST: f32 = 65.5355;
                let stored = depth
                    .values()
                    .iter()
                    .map(|&v| if v < MOST { v } else { 0.0 });
                let mut pairs = old.values().iter().zip(stored);
                (old.width(), old.height()) == size && pairs.all(|(a, b)| (a - b).abs() < 6e-4)
            }),
            Self::Npy | Self::Npz | Self::Tiff | Self::Exr | Self::Pfm => {
                Sparse::read(path, Some(Unit::METRE), size).is_ok_and(|old| old.depth == *depth)
            }
        }
    }
}
