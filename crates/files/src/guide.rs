//! Dense depth predictions of other programs, as guides of a completion.

use super::file_unit::FileUnit;
use super::files::{has_ending, stored_unit};
use super::stored::read_raster;
use crate::checks::{Warning, marks_in_guide};
use crate::error::{Error, Result};
use lsdc_core::{DepthGuide, GuideKind};
use std::fmt::{Display, Formatter};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// A file with a guide, or a folder of such files, and the meaning of their values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GuideSource {
    /// The file or folder.
    pub path: PathBuf,
    /// Meaning of the values.
    pub kind: GuideKind,
}

const KINDS: [(&str, GuideKind); 3] = [
    ("depth", GuideKind::Depth),
    ("disparity", GuideKind::Disparity),
    ("log", GuideKind::Log),
];

/// File extensions of guides.
pub const GUIDE_ENDINGS: [&str; 9] = [
    "npy", "npz", "png", "tiff", "tif", "exr", "pfm", "h5", "hdf5",
];

impl FromStr for GuideSource {
    type Err = Error;

    /// `FILE`, `FILE:depth`, `FILE:disparity` or `FILE:log`.
    fn from_str(text: &str) -> Result<Self> {
        let named = text.rsplit_once(':').and_then(|(path, name)| {
            let (_, kind) = KINDS.iter().find(|(known, _)| *known == name)?;
            Some((path, *kind))
        });
        let (path, kind) = named.unwrap_or((text, GuideKind::Depth));
        if path.is_empty() {
            return Err(Error::config("the guide has no path").hint("as in map.npy:disparity"));
        }
        Ok(Self {
            path: path.into(),
            kind,
        })
    }
}

impl Display for GuideSource {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let name = KINDS.iter().find(|(_, kind)| *kind == self.kind);
        write!(
            f,
            "{}:{}",
            self.path.display(),
            name.map_or("", |(name, _)| name)
        )
    }
}

impl GuideSource {
    /// Returns the guide of an image by its name: a file below the folder, or the path itself if it is a file.
    ///
    /// # Errors
    /// The folder has no guide of that name, or several.
    pub fn file_for(&self, name: &Path) -> Result<PathBuf> {
        if !self.path.is_dir() {
            return Ok(self.path.clone());
        }
        let path = self.path.join(name);
        let files = GUIDE_ENDINGS
            .into_iter()
            .map(|ending| path.with_extension(ending));
        let files: Vec<PathBuf> = files.filter(|file| file.exists()).collect();
        match &files[..] {
            [file] => Ok(file.clone()),
            [] => Err(Error::config(format!(
                "there is no guide of that name in `{}`",
                self.path.display()
            ))
            .hint(format!("guides end in {}", GUIDE_ENDINGS.join(", ")))),
            [one, other, ..] => Err(Error::config(format!(
                "`{}` and `{}` may both be its guide",
                one.display(),
                other.display()
            ))
            .hint("take one away")),
        }
    }

    /// Reads the guide of a frame of this name from the folder.
    ///
    /// # Errors
    /// As [`Self::file_for`] and [`Self::read`].
    pub fn read_for(&self, frame: &str) -> Result<(DepthGuide, Vec<Warning>)> {
        // Anything after the last dot of the name of an image is taken for its extension.
        self.read(&self.file_for(Path::new(&format!("{frame}.")))?)
    }

    /// Reads a file as a guide, with warnings. Pixels have no value if they are 0 in files other than NumPy's, or have a
    /// value that marks missing measurements (except for logarithms).
    ///
    /// # Errors
    /// The file cannot be read, is not a map, or does not have two different values.
    pub fn read(&self, file: &Path) -> Result<(DepthGuide, Vec<Warning>)> {
        let numpy = has_ending(file, "npy") || has_ending(file, "npz");
        if self.kind == GuideKind::Log && !numpy {
            return Err(Error::format(
                file,
                "cannot hold logarithms of depths, which may be negative",
            )
            .hint("save them with `numpy.save`"));
        }
        let Some((mut raster, _)) = read_raster(file).map_err(|e| self.advised(e))? else {
            return Err(Error::format(file, "is a table of points, not a map"));
        };
        let mut warnings = std::mem::take(&mut raster.warnings);
        warnings.retain(|warning| !warning.is_of_kind());
        if self.kind != GuideKind::Log {
            let (numbers, declared) = (raster.numbers, raster.declared);
            warnings.extend(marks_in_guide(&mut raster.values, numbers, declared));
        }
        let (columns, rows) = (raster.columns, raster.rows);
        let values = if numpy {
            raster.values
        } else {
            // The unit does not matter.
            let unit = FileUnit::new(stored_unit(file), raster.numbers).unit;
            let value = |v: f32| if v > 0.0 { v } else { f32::NAN };
            let map = raster.scaled(unit.metres())?;
            map.into_values().into_iter().map(value).collect()
        };
        let guide = DepthGuide::new(self.kind, columns, rows, &values)
            .map_err(|e| Error::of_core(e, format!("`{}`", file.display())))?;
        Ok((guide, warnings))
    }

    /// Adds the kinds of guides to the error of a file that cannot be read, if the path may name one after a colon.
    fn advised(&self, error: Error) -> Error {
        let named = self
            .path
            .to_string_lossy()
            .rsplit_once(':')
            .is_some_and(|(path, _)| Path::new(path).exists());
        if !named {
            return error;
        }
        error.hint(format!(
            "a guide is FILE or FILE:KIND, with one of these kinds: {}",
            KINDS.map(|(name, _)| name).join(", ")
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DepthMap, write_npy};

    #[test]
    fn the_kind_follows_the_last_colon() {
        let parsed = |text: &str| text.parse::<GuideSource>().unwrap();
        for (text, path, kind) in [
            ("a.npy", "a.npy", GuideKind::Depth),
            ("a.npy:disparity", "a.npy", GuideKind::Disparity),
            ("c:/a.npy:log", "c:/a.npy", GuideKind::Log),
            ("c:/a.npy", "c:/a.npy", GuideKind::Depth),
        ] {
            assert_eq!((parsed(text).path, parsed(text).kind), (path.into(), kind));
        }
        assert!(":log".parse::<GuideSource>().is_err());
        assert_eq!(parsed("a.npy:log").to_string(), "a.npy:log");
    }

    #[test]
    fn an_unknown_kind_lists_the_kinds() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("g.npy");
        write_npy(&file, &DepthMap::new(2, 1, vec![1.0, 3.0]).unwrap()).unwrap();
        let source: GuideSource = format!("{}:disp", file.display()).parse().unwrap();
        let error = source.read(&source.path).unwrap_err();
        assert!(
            error.advice().unwrap().contains("depth, disparity, log"),
            "{error:?}"
        );
    }

    #[test]
    fn marks_of_no_prediction_become_gaps() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("g.npy");
        let values = (0..100).map(|i| if i < 30 { 1e10 } else { 1.0 + i as f32 });
        write_npy(&file, &DepthMap::new(10, 10, values.collect()).unwrap()).unwrap();
        let source: GuideSource = file.to_str().unwrap().parse().unwrap();
        let (guide, warnings) = source.read(&file).unwrap();
        assert_eq!((guide.missing(), warnings.len()), (30, 1));
    }

    #[test]
    fn a_folder_holds_guides_by_the_names_of_images() {
        let folder = tempfile::tempdir().unwrap();
        let map = DepthMap::new(2, 1, vec![1.0, 3.0]).unwrap();
        let file = folder.path().join("left.npy");
        write_npy(&file, &map).unwrap();
        let source: GuideSource = folder.path().to_str().unwrap().parse().unwrap();
        assert_eq!(source.file_for(Path::new("left.jpg")).unwrap(), file);
        let missing = source.file_for(Path::new("right.jpg")).unwrap_err();
        assert!(missing.to_string().contains("no guide"), "{missing}");
        std::fs::copy(&file, folder.path().join("left.npz")).unwrap();
        let twice = source.file_for(Path::new("left.jpg")).unwrap_err();
        assert!(twice.to_string().contains("may both"), "{twice}");
        assert_eq!(source.read(&file).unwrap().0.missing(), 0);
        let flat = folder.path().join("flat.npy");
        write_npy(&flat, &DepthMap::new(2, 1, vec![2.0, 2.0]).unwrap()).unwrap();
        let error = source.read(&flat).unwrap_err().to_string();
        assert!(
            error.contains("the same") && error.contains("flat.npy"),
            "{error}"
        );
    }
}
