//! Depths as stored in files, before they are matched to an image: maps, and tables of points.

use super::files::{
    CLOUDS, ColumnMeaning, PointTable, TableRow, has_ending, read_array, read_exr, read_grey,
    read_h5, read_npz, read_npz_table, read_pfm, read_table, read_tiff, stored_unit,
};
use super::{DepthMap, DepthReadOptions, Unit};
use crate::checks::{NumberType, Warning, constant, name_warning};
use crate::error::{Error, Result};
use crate::file_unit::FileUnit;
use crate::foreign::check_foreign;
use crate::raster::Raster;
use std::path::Path;

/// A depth map.
#[derive(Clone, Debug)]
pub struct StoredMap {
    /// Depths in metres.
    pub depth: DepthMap,
    /// Standard deviation of each depth in metres, if the file has them.
    pub sigma: Option<DepthMap>,
    /// The unit of the file.
    pub unit: Unit,
    /// Whether the unit was inferred.
    pub guessed: bool,
    /// What should be checked, a sentence each.
    pub remarks: Vec<String>,
}

impl StoredMap {
    /// Creates a map from numbers, row by row, such as those of a message. Values that mark missing measurements are left
    /// out. Without a unit, integers are millimetres and other numbers metres. This is a standard (ROS REP 118) and not a
    /// guess, but there is a warning if the depths are implausible.
    ///
    /// # Errors
    /// The number of values differs from the number of pixels.
    pub fn of_numbers(
        (width, height): (usize, usize),
        values: Vec<f32>,
        numbers: NumberType,
        unit: Option<Unit>,
    ) -> Result<Self> {
        let known = FileUnit::new(unit, numbers);
        let raster = Raster::new((width, height), values, numbers);
        let (depth, warnings) = raster.depth(known.unit.metres())?;
        let warning = known.warning(depth.points().map(|point| point.depth).collect());
        Ok(Self {
            depth,
            sigma: None,
            unit: known.unit,
            guessed: false,
            remarks: warnings
                .iter()
                .map(ToString::to_string)
                .chain(warning)
                .collect(),
        })
    }
}

/// Contents of a file.
pub(super) enum DepthFile {
    Map(StoredMap),
    /// Points in the unit of the file.
    Table(PointTable, FileUnit),
}

/// File extensions of maps and tables.
pub(super) const DEPTHS: [&str; 13] = [
    "npy", "npz", "png", "tiff", "tif", "exr", "pfm", "pgm", "h5", "hdf5", "csv", "txt", "xyz",
];

/// File extensions of all files with depths.
pub(super) fn endings() -> impl Iterator<Item = &'static str> {
    DEPTHS.into_iter().chain(CLOUDS)
}

/// Reads a file by its extension. Arrays for which `is_table` returns true are tables. A unit declared in the file applies
/// if none is given.
pub(super) fn read_depth_file(
    path: &Path,
    options: DepthReadOptions,
    is_table: impl Fn(&Raster) -> bool,
) -> Result<DepthFile> {
    let in_file = options.unit.is_none().then(|| stored_unit(path)).flatten();
    let known = |numbers| FileUnit::new(options.unit.or(in_file), numbers);
    if has_ending(path, "npz")
        && let Some((table, numbers)) = read_npz_table(path)?
    {
        return Ok(DepthFile::Table(table, known(numbers)));
    }
    let Some((raster, sigma)) = read_raster(path)? else {
        return Ok(DepthFile::Table(
            read_table(path)?,
            known(NumberType::Floats),
        ));
    };
    let known = known(raster.numbers);
    let may_be_table = has_ending(path, "npy") || has_ending(path, "npz");
    if may_be_table && is_table(&raster) {
        return Ok(DepthFile::Table(table(&raster), known));
    }
    let metres = known.unit.metres();
    let sigma = sigma.map(|mut sigma| sigma.scaled(metres)).transpose()?;
    let (depth, mut warnings) = if in_file.is_some() {
        raster.depth(metres)?
    } else {
        raster.depth_in(known)?
    };
    if let Some(sigma) = &sigma {
        check_sizes(path, &depth, sigma)?;
    }
    warnings.extend(kind_by_name(path).filter(|_| !warnings.iter().any(Warning::is_of_kind)));
    warnings.retain(|warning| options.kind.is_none() || !warning.is_of_kind());
    warnings.extend(constant(depth.points().map(|point| point.depth)));
    let depths = depth.points().map(|point| point.depth).collect();
    let unit = known.warning(depths);
    let warnings = warnings.iter().map(ToString::to_string);
    Ok(DepthFile::Map(StoredMap {
        guessed: known.is_guessed() || unit.is_some(),
        remarks: warnings.chain(unit).collect(),
        depth,
        sigma,
        unit: known.unit,
    }))
}

/// Reads the values of a file by its extension, and their standard deviations; `None` for tables.
pub(super) fn read_raster(path: &Path) -> Result<Option<(Raster, Option<Raster>)>> {
    let is = |ending: &str| has_ending(path, ending);
    let alone = |raster: Raster| (raster, None);
    let found = if is("png") || is("pgm") {
        read_grey(path).map(alone)
    } else if is("tif") || is("tiff") {
        read_tiff(path).map(alone)
    } else if is("exr") {
        read_exr(path)
    } else if is("pfm") {
        read_pfm(path).map(alone)
    } else if is("h5") || is("hdf5") {
        read_h5(path).map(alone)
    } else if is("npy") {
        read_array(path).map(alone)
    } else if is("npz") {
        read_npz(path)
    } else if is("csv") || is("txt") || is("xyz") {
        return Ok(None);
    } else {
        check_foreign(path)?;
        let known: Vec<&str> = endings().collect();
        return Err(
            Error::format(path, "is no kind of depth file").hint(format!(
                "depths are read from files that end in {}",
                known.join(", ")
            )),
        );
    };
    found.map(Some)
}

/// Returns a warning if a file name denotes distances along the ray or inverse depths, or is one of Hypersim.
fn kind_by_name(path: &Path) -> Option<Warning> {
    let name = path.file_stem()?.to_string_lossy();
    let hypersim =
        name.ends_with("depth_meters") && (has_ending(path, "hdf5") || has_ending(path, "h5"));
    if hypersim {
        let name = format!("`{name}` is called as a file of Hypersim, which");
        return Some(Warning::RayDistance { name });
    }
    name_warning(&name, || format!("a file called `{name}`"))
}

fn check_sizes(path: &Path, depth: &DepthMap, sigma: &DepthMap) -> Result<()> {
    let [a, b] = [depth, sigma].map(|map| (map.width(), map.height()));
    if a == b {
        return Ok(());
    }
    Err(Error::format(
        path,
        format!(
            "its depths are {}x{} but their standard deviations {}x{}",
            a.0, a.1, b.0, b.1
        ),
    ))
}

fn table(array: &Raster) -> PointTable {
    let rows = array.values.chunks_exact(array.columns).enumerate();
    let row = |(number, row): (usize, &[f32])| TableRow {
        number,
        values: [row[0], row[1], row[2]].map(f64::from),
        fourth: row.get(3).map(|&value| f64::from(value)),
    };
    PointTable {
        columns: ColumnMeaning::Unnamed,
        rows: rows.map(row).collect(),
        row: "row",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_ending_that_is_said_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let error = |name: &str| {
            let read = read_depth_file(
                &folder.path().join(name),
                DepthReadOptions::default(),
                |_| false,
            );
            read.err().map(|error| error.to_string())
        };
        for ending in DEPTHS {
            // No such file exists, but the extension has a reader.
            let text = error(&format!("a.{ending}")).unwrap();
            assert!(!text.contains("no kind of depth file"), "{text}");
        }
        // BMP has no 16-bit grey, and its reader supports only colours.
        for name in ["a.doc", "a.bmp"] {
            let text = error(name).unwrap();
            assert!(text.contains("no kind of depth file"), "{text}");
        }
    }
}
