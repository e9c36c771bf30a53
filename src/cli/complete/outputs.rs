//! The files of a result.

use super::Complete;
use super::frame::Completed;
use crate::data::{self, DepthMap, Unit};
use crate::error::{Error, Result};
use crate::report::coloured;
use std::path::{Path, PathBuf};

/// The files of a result.
pub(super) struct Outputs {
    pub(super) npy: PathBuf,
    png: PathBuf,
    colour: PathBuf,
    sigma: PathBuf,
    outliers: PathBuf,
    force: bool,
}

impl Outputs {
    /// Of a frame of that name, in a folder.
    pub(super) fn new(folder: &Path, stem: &str, force: bool) -> Self {
        let path = |end: &str| folder.join(format!("{stem}_{end}"));
        Self {
            npy: path("depth.npy"),
            png: path("depth.png"),
            colour: path("depth_color.png"),
            sigma: path("sigma.npy"),
            outliers: path("outliers.csv"),
            force,
        }
    }

    /// Writes the depth in three forms, and what was asked for beside it; the depth as npy last, so
    /// that a frame that has it has everything. An existing result is replaced only by an equal one,
    /// or with `--force`; else nothing is written.
    pub(super) fn write(
        &self,
        args: &Complete,
        found: &Completed,
        sparse: &DepthMap,
    ) -> Result<()> {
        let depth = &found.depth;
        let fitted = found.fitted.as_ref();
        let deviations = fitted.and_then(|fitted| fitted.deviations.as_ref());
        let list = fitted.filter(|_| args.outliers);
        let outliers = list.map(|fitted| fitted.outliers(sparse));
        let maps = [(&self.sigma, deviations), (&self.npy, Some(depth))];
        for (path, map) in maps {
            let same = |map: &DepthMap| data::read_npy(path, 1.0).is_ok_and(|old| old == *map);
            self.replaceable(path, map.is_none_or(same))?;
        }
        let same =
            |text: &str| std::fs::read_to_string(&self.outliers).is_ok_and(|old| old == text);
        self.replaceable(&self.outliers, outliers.as_deref().is_none_or(same))?;

        if let Some(folder) = self.npy.parent() {
            std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        }
        data::write_depth_png(&self.png, depth, Unit::MILLIMETRE.metres())?;
        let (low, high) = depth.range().unwrap_or((0.0, 1.0));
        data::write_rgb(&self.colour, &coloured(depth, low, high))?;
        if let Some(text) = &outliers {
            data::write_atomically(&self.outliers, |out| out.write_all(text.as_bytes()))?;
        }
        maps.into_iter()
            .filter_map(|(path, map)| Some((path, map?)))
            .try_for_each(|(path, map)| data::write_npy(path, map))
    }

    fn replaceable(&self, path: &Path, same: bool) -> Result<()> {
        if self.force || same || !path.exists() {
            return Ok(());
        }
        Err(Error::config(format!("`{}` exists", path.display()))
            .hint("give --force to replace it, or -o DIR to write elsewhere"))
    }
}
