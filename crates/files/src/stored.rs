//! Depths as files hold them, before they meet an image: maps, and tables of points.

use super::files::{
    Array, CLOUDS, Columns, Numbers, Row, Table, has_ending, read_array, read_exr, read_grey,
    read_h5, read_npz, read_pfm, read_table, read_tiff, stored_unit,
};
use super::{DepthMap, Unit};
use crate::error::{Error, Result};
use std::path::Path;

/// A map of depths.
#[derive(Clone, Debug)]
pub struct StoredMap {
    /// In metres.
    pub depth: DepthMap,
    /// The standard deviation of each depth in metres, if the file has them.
    pub sigma: Option<DepthMap>,
    /// The unit of the file.
    pub unit: Unit,
    /// `true` if the unit was inferred.
    pub guessed: bool,
    /// What should be checked.
    pub remarks: Vec<String>,
}

/// What a file holds.
pub(super) enum Stored {
    Map(StoredMap),
    /// Points in the unit of the file.
    Table(Table, KnownUnit),
}

/// The unit of a file, and what it was inferred from.
#[derive(Clone, Copy, Debug)]
pub(super) struct KnownUnit {
    pub(super) unit: Unit,
    guessed_from: Option<Numbers>,
}

impl KnownUnit {
    /// What was said, or else millimetres for integers and metres for other numbers.
    pub(super) fn new(said: Option<Unit>, numbers: Numbers) -> Self {
        let usual = match numbers {
            Numbers::Bytes | Numbers::Integers => Unit::MILLIMETRE,
            Numbers::Floats | Numbers::Booleans => Unit::METRE,
        };
        Self {
            unit: said.unwrap_or(usual),
            guessed_from: said.is_none().then_some(numbers),
        }
    }

    /// Whether the unit is a guess. Metres of floats are none, as every form of them is documented to be in metres; they
    /// become one if there is a [doubt](Self::doubt).
    pub(super) fn is_guessed(self) -> bool {
        self.guessed_from
            .is_some_and(|numbers| numbers != Numbers::Floats)
    }

    /// Why the guess may be wrong, by the depths in metres that it leads to.
    pub(super) fn doubt(self, mut depths: Vec<f32>) -> Option<String> {
        /// No median of the depths of an image is so large, or so small.
        const FAR: f32 = 200.0;
        const NEAR: f32 = 0.02;
        let numbers = self.guessed_from?;
        if depths.is_empty() {
            return None;
        }
        let middle = depths.len() / 2;
        let median = *depths.select_nth_unstable_by(middle, f32::total_cmp).1;
        let unit = self.unit;
        match numbers {
            Numbers::Booleans => Some(
                "true and false are taken for depths of 1 and none: is this a mask?".to_owned(),
            ),
            Numbers::Bytes => Some(format!(
                "integers of 8 bits are taken for {unit}, at most 0.255 m; --depth-unit says otherwise"
            )),
            _ if !(NEAR..=FAR).contains(&median) => Some(format!(
                "the median depth is {median} m if these are {unit}; --depth-unit says otherwise"
            )),
            _ => None,
        }
    }
}

/// The endings of maps and tables.
pub(super) const DEPTHS: [&str; 13] = [
    "npy", "npz", "png", "tiff", "tif", "exr", "pfm", "pgm", "h5", "hdf5", "csv", "txt", "xyz",
];

/// The endings of everything that holds depths.
pub(super) fn endings() -> impl Iterator<Item = &'static str> {
    DEPTHS.into_iter().chain(CLOUDS)
}

/// Reads a file by its ending. Arrays for which `is_table` are tables. A unit that the file itself says
/// stands where none is given.
pub(super) fn read_stored(
    path: &Path,
    said: Option<Unit>,
    is_table: impl Fn(&Array) -> bool,
) -> Result<Stored> {
    let is = |ending: &str| has_ending(path, ending);
    let said = said.or_else(|| stored_unit(path));
    let known = |numbers| KnownUnit::new(said, numbers);
    let metres = |numbers| known(numbers).unit.metres();
    let floats = || metres(Numbers::Floats);
    let (depth, sigma, numbers) = if is("png") || is("pgm") {
        let (depth, numbers) = read_grey(path, metres)?;
        (depth, None, numbers)
    } else if is("tif") || is("tiff") {
        let (depth, numbers) = read_tiff(path, metres)?;
        (depth, None, numbers)
    } else if is("exr") {
        let (depth, sigma) = read_exr(path, floats())?;
        (depth, sigma, Numbers::Floats)
    } else if is("pfm") {
        (read_pfm(path, floats())?, None, Numbers::Floats)
    } else if is("h5") || is("hdf5") {
        (read_h5(path, floats())?, None, Numbers::Floats)
    } else if is("csv") || is("txt") || is("xyz") {
        return Ok(Stored::Table(read_table(path)?, known(Numbers::Floats)));
    } else if is("npy") || is("npz") {
        let (array, sigma) = if is("npy") {
            (read_array(path)?, None)
        } else {
            read_npz(path)?
        };
        let numbers = array.numbers;
        if is_table(&array) {
            return Ok(Stored::Table(table(&array), known(numbers)));
        }
        let scale = metres(numbers);
        let sigma = sigma.map(|sigma| map(&sigma, scale)).transpose()?;
        (map(&array, scale)?, sigma, numbers)
    } else {
        let known: Vec<&str> = endings().collect();
        return Err(
            Error::format(path, "is no kind of depth file").hint(format!(
                "depths are read from files that end in {}",
                known.join(", ")
            )),
        );
    };
    if let Some(sigma) = &sigma {
        check_sizes(path, &depth, sigma)?;
    }
    let known = known(numbers);
    let doubt = known.doubt(depth.points().map(|point| point.depth).collect());
    Ok(Stored::Map(StoredMap {
        depth,
        sigma,
        unit: known.unit,
        guessed: known.is_guessed() || doubt.is_some(),
        remarks: doubt.into_iter().collect(),
    }))
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

fn map(array: &Array, scale: f64) -> Result<DepthMap> {
    let metres = |value: &f32| (f64::from(*value) * scale) as f32;
    let values = array.values.iter().map(metres).collect();
    Ok(DepthMap::new(array.columns, array.rows, values)?)
}

fn table(array: &Array) -> Table {
    let rows = array.values.chunks_exact(array.columns).enumerate();
    let row = |(number, row): (usize, &[f32])| Row {
        number,
        values: [row[0], row[1], row[2]].map(f64::from),
        fourth: row.get(3).map(|&value| f64::from(value)),
    };
    Table {
        columns: Columns::Unnamed,
        rows: rows.map(row).collect(),
        row: "row",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is doubted of a guess.
    fn doubted(numbers: Numbers, depths: &[f32]) -> bool {
        KnownUnit::new(None, numbers)
            .doubt(depths.to_vec())
            .is_some()
    }

    #[test]
    fn every_ending_that_is_said_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let error = |name: &str| {
            let read = read_stored(&folder.path().join(name), None, |_| false);
            read.err().map(|error| error.to_string())
        };
        for ending in DEPTHS {
            // There is no such file, but a reader for it.
            let said = error(&format!("a.{ending}")).unwrap();
            assert!(!said.contains("no kind of depth file"), "{said}");
        }
        // BMP has no grey of 16 bits, and its reader knows colours only.
        for name in ["a.doc", "a.bmp"] {
            let said = error(name).unwrap();
            assert!(said.contains("no kind of depth file"), "{said}");
        }
    }

    #[test]
    fn implausible_units_are_doubted() {
        assert!(doubted(Numbers::Bytes, &[0.1, 0.2]));
        assert!(doubted(Numbers::Booleans, &[1.0, 1.0]));
        assert!(doubted(Numbers::Floats, &[1785.0, 2900.0, 6042.0]));
        assert!(doubted(Numbers::Integers, &[0.002, 0.004, 0.005]));
        assert!(!doubted(Numbers::Floats, &[1.7, 2.9, 6.0]));
        assert!(!doubted(Numbers::Integers, &[1.7, 2.9, 6.0]));
        assert!(!doubted(Numbers::Floats, &[]));
        let said = KnownUnit::new(Some(Unit::METRE), Numbers::Floats);
        assert_eq!(said.doubt(vec![5000.0]), None);
    }
}
