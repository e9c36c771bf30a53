//! NumPy `.npz` archives: ZIP files of `.npy` arrays.

use super::npy::{NumberList, encode, parse, parse_list};
use super::table::{ColumnMeaning, PointTable, TableRow};
use super::{LARGEST, check_unfolded, plausible, write_atomically};
use crate::DepthMap;
use crate::checks::{NumberType, Warning, depth_array, name_warning, quoted};
use crate::error::{Cause, Error, Result};
use crate::raster::Raster;
use std::fs::File;
use std::io::{BufReader, Cursor, Read as _};
use std::path::Path;
use zip::result::ZipError;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Names of depth arrays in archives, in order of preference.
const DEPTHS: [&str; 5] = ["depth", "depths", "sparse", "points", "arr_0"];
/// Names of arrays of standard deviations.
const SIGMAS: [&str; 2] = ["sigma", "std"];

/// The arrays of an archive, read on demand.
struct Arrays<'a> {
    path: &'a Path,
    /// Size of the file in bytes.
    size: u64,
    archive: ZipArchive<BufReader<File>>,
    names: Vec<String>,
}

impl<'a> Arrays<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::read(path, e))?;
        let size = file.metadata().map_err(|e| Error::read(path, e))?.len();
        let archive = ZipArchive::new(BufReader::new(file)).map_err(|e| damaged(path, e))?;
        let names = archive
            .file_names()
            .filter_map(|name| Some(name.ok()?.strip_suffix(".npy")?.to_owned()))
            .collect();
        Ok(Self {
            path,
            size,
            archive,
            names,
        })
    }

    /// Returns the bytes of the `.npy` file of an array.
    fn bytes(&mut self, name: &str) -> Result<Vec<u8>> {
        let path = self.path;
        let entry = self.archive.by_name(&format!("{name}.npy"));
        let entry = entry.map_err(|e| damaged(path, e))?;
        let length = entry.size();
        if !plausible(length, self.size) {
            let what = format!(
                "`{name}` declares {length} bytes, the file has {}",
                self.size
            );
            return Err(Error::format(path, what));
        }
        check_unfolded(path, &format!("the values of `{name}`"), length, LARGEST)?;
        let mut bytes = Vec::new();
        entry
            .take(length)
            .read_to_end(&mut bytes)
            .map_err(|e| damaged(path, e.into()))?;
        Ok(bytes)
    }
}

fn damaged(path: &Path, error: ZipError) -> Error {
    Error::format(path, "is no sound npz archive").because(error)
}

/// Reads lists of numbers, arrays of shape `[n]`, by their names; `None` for a name that is not in the archive.
///
/// Element types: float16, float32, float64, uint8 to uint64, int8 to int64, each converted to float32.
///
/// # Errors
/// The file cannot be read or is damaged, an array has another shape or element type, or an array has fewer bytes than its
/// header declares.
pub fn read_npz_lists<const N: usize>(
    path: &Path,
    names: [&str; N],
) -> Result<[Option<NumberList>; N]> {
    let mut arrays = Arrays::open(path)?;
    let mut lists = [const { None }; N];
    for (list, name) in lists.iter_mut().zip(names) {
        if arrays.names.iter().any(|known| known == name) {
            *list = Some(parse_list(path, name, &arrays.bytes(name)?)?);
        }
    }
    Ok(lists)
}

/// Reads a table of points from the lists `u`, `v` and `depth`, and `sigma` or `std` if it is there; `None` for other archives.
pub(crate) fn read_npz_table(path: &Path) -> Result<Option<(PointTable, NumberType)>> {
    let [Some(u), Some(v)] = read_npz_lists(path, ["u", "v"])? else {
        return Ok(None);
    };
    let [depth] = read_npz_lists(path, ["depth"])?;
    let [sigma, std] = read_npz_lists(path, SIGMAS)?;
    let sigma = sigma.or(std);
    let Some(depth) = depth else {
        return Err(Error::format(path, "has `u` and `v`, but no `depth`"));
    };
    let count = u.values.len();
    let lists = [
        ("v", Some(&v)),
        ("depth", Some(&depth)),
        ("sigma", sigma.as_ref()),
    ];
    for (name, list) in lists {
        let length = list.map_or(count, |list| list.values.len());
        if length != count {
            let what = format!("`{name}` has {length} values, but `u` has {count}");
            return Err(Error::format(path, what));
        }
    }
    let row = |number: usize| TableRow {
        number,
        values: [&u, &v, &depth].map(|list| f64::from(list.values[number])),
        fourth: sigma.as_ref().map(|sigma| f64::from(sigma.values[number])),
    };
    let table = PointTable {
        columns: ColumnMeaning::Pixels,
        rows: (0..count).map(row).collect(),
        row: "entry",
    };
    Ok(Some((table, depth.numbers)))
}

/// Reads the depths of an archive, and their standard deviations if it has them.
pub(crate) fn read_npz(path: &Path) -> Result<(Raster, Option<Raster>)> {
    let mut arrays = Arrays::open(path)?;
    let names = arrays.names.clone();
    let depths = depth_array(&names, &DEPTHS).ok_or_else(|| {
        let what = format!("has no array of depths. Arrays: {}", quoted(&names));
        Error::format(path, what).hint("save the depths as `depth`, their deviations as `sigma`")
    })?;
    let mut read = |name: &str| parse(path, &arrays.bytes(name)?);
    let mut array = read(depths)?;
    let deviations = SIGMAS
        .iter()
        .find_map(|known| names.iter().find(|name| name == known));
    let sigma = deviations.map(|name| read(name)).transpose()?;
    let warning = name_warning(depths, || format!("an array called `{depths}`"));
    array.warnings.extend(warning);
    let others = names
        .iter()
        .filter(|name| *name != depths && Some(*name) != deviations);
    let others = others.cloned().collect();
    let warning = Warning::chosen("array", format!("`{depths}`"), others);
    array.warnings.extend(warning);
    Ok((array, sigma))
}

/// Writes maps of the same size under their names, as float32 of shape `(height, width)`, compressed.
///
/// # Errors
/// The file cannot be written.
pub fn write_npz(path: &Path, maps: &[(&str, &DepthMap)]) -> Result<()> {
    let bytes = encode_npz(maps)?;
    write_atomically(path, |out| out.write_all(&bytes))
}

/// Returns the bytes of the file that [`write_npz`] writes.
///
/// # Errors
/// Two maps have the same name.
pub fn encode_npz(maps: &[(&str, &DepthMap)]) -> Result<Vec<u8>> {
    let archive = || -> std::io::Result<Vec<u8>> {
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, map) in maps {
            let options =
                SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
            archive.start_file(format!("{name}.npy"), options)?;
            encode(&mut archive, map)?;
        }
        Ok(archive.finish()?.into_inner())
    };
    archive().map_err(|e| Error::new(Cause::Write, "cannot make an npz archive").because(e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Sparse, Unit};
    use npyz::WriterBuilder as _;
    use std::io::Write;

    /// An archive of float32 or int16 arrays with these shapes and values.
    fn archive(arrays: &[(&str, &[u64], Values)]) -> tempfile::NamedTempFile {
        let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, shape, values) in arrays {
            let options = SimpleFileOptions::default();
            archive.start_file(format!("{name}.npy"), options).unwrap();
            match values {
                Values::Floats(values) => write(&mut archive, shape, values),
                Values::Integers(values) => write(&mut archive, shape, values),
                Values::Flags(values) => write(&mut archive, shape, values),
            }
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), archive.finish().unwrap().into_inner()).unwrap();
        file
    }

    fn write<T: npyz::AutoSerialize + Copy>(out: &mut dyn Write, shape: &[u64], values: &[T]) {
        let options = npyz::WriteOptions::new().default_dtype().shape(shape);
        let mut writer = options.writer(out).begin_nd().unwrap();
        writer.extend(values.iter().copied()).unwrap();
        writer.finish().unwrap();
    }

    #[derive(Clone, Copy)]
    enum Values {
        Floats(&'static [f32]),
        Integers(&'static [i16]),
        Flags(&'static [bool]),
    }
    use Values::{Flags, Floats, Integers};

    #[test]
    fn lists_are_found_by_their_names() {
        let file = archive(&[
            ("ring", &[3], Integers(&[-1, 0, 31])),
            ("u", &[3], Floats(&[0.5, -2.0, f32::INFINITY])),
        ]);
        let [u, ring, v] = read_npz_lists(file.path(), ["u", "ring", "v"]).unwrap();
        let (u, ring) = (u.unwrap(), ring.unwrap());
        assert_eq!(
            (u.values, u.numbers),
            (vec![0.5, -2.0, f32::INFINITY], NumberType::Floats)
        );
        assert_eq!(
            (ring.values, ring.numbers),
            (vec![-1.0, 0.0, 31.0], NumberType::signed(16))
        );
        assert!(v.is_none());
    }

    #[test]
    fn lists_of_positions_and_depths_are_points() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan_points.npz");
        let read = |arrays: &[(&str, &[u64], Values)]| {
            std::fs::copy(archive(arrays).path(), &path).unwrap();
            Sparse::read(&path, None, None, (40, 30))
        };
        let (u, v) = (Floats(&[3.25, 39.0, 50.0]), Floats(&[0.0, 29.25, 1.0]));
        let (ring, sigma) = (Integers(&[-1, 0, 31]), Floats(&[0.5, 0.25, 1.0]));
        let arrays = |depth| [("u", u), ("v", v), ("depth", depth), ("ring", ring)];
        let found = |points: &Sparse| -> Vec<_> {
            let points = points.points.iter();
            points.map(|p| (p.u, p.v, p.depth, p.sigma)).collect()
        };
        let metres = arrays(Floats(&[7.0, 80.0, 9.0])).map(|(name, list)| (name, &[3][..], list));
        let points = read(&metres).unwrap();
        assert_eq!((points.outside, points.unit), (1, Unit::METRE));
        assert_eq!(
            found(&points),
            [(3.25, 0.0, 7.0, None), (39.0, 29.25, 80.0, None)]
        );
        let millimetres = arrays(Integers(&[7000, 8000, 9000]));
        let mut millimetres = millimetres
            .map(|(name, list)| (name, &[3][..], list))
            .to_vec();
        millimetres.push(("std", &[3], sigma));
        let points = read(&millimetres).unwrap();
        let expected = [
            (3.25, 0.0, 7.0, Some(5e-4)),
            (39.0, 29.25, 8.0, Some(2.5e-4)),
        ];
        assert_eq!(found(&points), expected);

        let short = [
            ("u", &[3][..], u),
            ("v", &[3], v),
            ("depth", &[1], Floats(&[7.0])),
        ];
        let error = read(&short).unwrap_err().to_string();
        assert!(
            error.contains("`depth` has 1 values, but `u` has 3"),
            "{error}"
        );
        let error = read(&short[..2]).unwrap_err().to_string();
        assert!(error.contains("no `depth`"), "{error}");
    }

    #[test]
    fn lists_of_other_shapes_and_types_and_damaged_archives_are_errors() {
        let text = |file: &tempfile::NamedTempFile| {
            let error = read_npz_lists(file.path(), ["u"]).unwrap_err();
            assert_eq!(error.cause(), Cause::Format);
            error.to_string()
        };
        let square = archive(&[("u", &[1, 2], Floats(&[1.0, 2.0]))]);
        assert!(text(&square).contains("`u` has shape [1, 2]"));
        let flags = archive(&[("u", &[2], Flags(&[true, false]))]);
        assert!(text(&flags).contains("numbers"));
        let intact = archive(&[("u", &[2], Floats(&[1.0, 2.0]))]);
        let bytes = std::fs::read(intact.path()).unwrap();
        for length in [0, 10, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(intact.path(), &bytes[..length]).unwrap();
            assert!(text(&intact).contains("no sound npz archive"));
        }
    }
}
