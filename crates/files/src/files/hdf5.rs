//! HDF5 arrays, read a few rows at a time. This is the only file that depends on the HDF5 library.

use super::{LARGEST, check_unfolded, plausible};
use crate::DepthMap;
use crate::checks::{NumberType, Warning, depth_array, name_warning, quoted};
use crate::error::{Error, Result};
use crate::raster::Raster;
use half::f16;
use hdf5_pure::{
    AttrValue, Chunk, ChunkIndex, DType, Dataset, Datatype, DatatypeByteOrder, File, Object,
};
use image::{Rgb, RgbImage};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Largest side of an image.
const LONGEST: usize = 1 << 14;

/// Largest chunk of an array, in bytes.
const LARGEST_CHUNK: u64 = 32 << 20;

/// An open file. Only requested data is read.
pub struct Hdf5 {
    path: PathBuf,
    file: File,
}

impl Hdf5 {
    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Opens a file; a user block, as in MATLAB v7.3 files, is skipped.
    ///
    /// # Errors
    /// The file cannot be read, or is not HDF5.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open_streaming(path).map_err(|e| match e {
            hdf5_pure::Error::Io(io) => Error::read(path, io),
            other => Error::format(path, "is not a readable HDF5 file")
                .because(other)
                .hint("check that the file is complete; an old MATLAB file is v5, not v7.3"),
        })?;
        Ok(Self {
            path: path.to_owned(),
            file,
        })
    }

    /// Returns the names of the arrays at the root.
    ///
    /// # Errors
    /// The file is damaged.
    pub fn names(&self) -> Result<Vec<String>> {
        let mut names = self.file.root().datasets().map_err(|e| self.damaged(e))?;
        names.sort_unstable();
        Ok(names)
    }

    /// Returns the shape of an array, starting with the number of rows.
    ///
    /// # Errors
    /// The array does not exist, or is damaged.
    pub fn shape(&self, name: &str) -> Result<Vec<usize>> {
        self.array(name)?
            .shape()
            .map_err(|e| self.damaged(e))?
            .into_iter()
            .map(|n| {
                usize::try_from(n)
                    .map_err(|_| Error::format(&self.path, format!("`{name}` is too large")))
            })
            .collect()
    }

    /// Reads rows `start..start + count` of an array of bytes whose rows have shape `row`.
    ///
    /// # Errors
    /// No array of bytes has this name and shape, or it is damaged.
    pub fn rows_u8(
        &self,
        name: &str,
        row: &[usize],
        start: usize,
        count: usize,
    ) -> Result<Vec<u8>> {
        let array = self.checked(name, row, start..start + count, &[DType::U8])?;
        array
            .read_u8_rows(start as u64, count as u64)
            .map_err(|e| self.damaged(e))
            .and_then(|values| self.counted(name, values, row, count))
    }

    /// Reads rows `start..start + count` of an array of floats whose rows have shape `row`.
    ///
    /// # Errors
    /// No array of floats has this name and shape, or it is damaged.
    pub fn rows_f32(
        &self,
        name: &str,
        row: &[usize],
        start: usize,
        count: usize,
    ) -> Result<Vec<f32>> {
        let rows = start..start + count;
        if let Some(big) = self.half(name)? {
            // The library does not support 16-bit floats.
            let element = self.array(name)?.dtype().map_err(|e| self.damaged(e))?;
            let array = self.checked(name, row, rows, &[element])?;
            let bytes = array.read_raw_rows(start as u64, count as u64);
            let bytes = bytes.map_err(|e| self.damaged(e))?;
            let value = |bytes: &[u8; 2]| {
                if big {
                    f16::from_be_bytes(*bytes)
                } else {
                    f16::from_le_bytes(*bytes)
                }
            };
            let values = bytes.as_chunks::<2>().0.iter();
            let values = values.map(|bytes| value(bytes).to_f32()).collect();
            return self.counted(name, values, row, count);
        }
        let array = self.checked(name, row, rows, &[DType::F32, DType::F64])?;
        array
            .read_f32_rows(start as u64, count as u64)
            .map_err(|e| self.damaged(e))
            .and_then(|values| self.counted(name, values, row, count))
    }

    /// Whether an array of 16-bit floats is big-endian; `None` for other types.
    fn half(&self, name: &str) -> Result<Option<bool>> {
        /// Bits of the mantissa of IEEE 754's binary16.
        const MANTISSA: u8 = 10;
        Ok(
            match self.array(name)?.datatype().map_err(|e| self.damaged(e))? {
                Datatype::FloatingPoint {
                    size: 2,
                    byte_order,
                    layout,
                } if layout.mantissa_size == MANTISSA => {
                    Some(byte_order == DatatypeByteOrder::BigEndian)
                }
                _ => None,
            },
        )
    }

    /// Reads the texts of a MATLAB cell array of strings.
    ///
    /// # Errors
    /// The array does not exist, has more than `most` texts, or is damaged.
    pub fn texts(&self, name: &str, most: usize) -> Result<Vec<String>> {
        let cells = self.array(name)?;
        let shape = cells.shape().map_err(|e| self.damaged(e))?;
        if shape.iter().product::<u64>() > most as u64 {
            return Err(Error::format(&self.path, format!("`{name}` is too long")));
        }
        let objects = cells.dereference().map_err(|e| self.damaged(e))?;
        let no_texts = || Error::format(&self.path, format!("`{name}` holds no texts"));
        objects
            .into_iter()
            .map(|object| {
                let Object::Dataset(text) = object else {
                    return Err(no_texts());
                };
                let length: u64 = text.shape().map_err(|e| self.damaged(e))?.iter().product();
                if length > 1000 {
                    return Err(no_texts());
                }
                let units = text.read_u16().map_err(|e| self.damaged(e))?;
                Ok(String::from_utf16_lossy(&units))
            })
            .collect()
    }

    /// Returns an array after checking its declared shape and type, which bounds the memory that reading allocates.
    fn checked(
        &self,
        name: &str,
        row: &[usize],
        rows: Range<usize>,
        types: &[DType],
    ) -> Result<Dataset> {
        let array = self.array(name)?;
        let shape = self.shape(name)?;
        let element = array.dtype().map_err(|e| self.damaged(e))?;
        let fits = shape.first().is_some_and(|&n| n >= rows.end)
            && shape[1..] == *row
            && row.iter().all(|&n| n <= LONGEST)
            && types.contains(&element);
        if !fits {
            return Err(Error::format(
                &self.path,
                format!(
                    "`{name}` is {element} of shape {shape:?}, expected {} with rows of shape \
                     {row:?} and at least {} of them",
                    types[0], rows.end
                ),
            ));
        }
        let bytes = 8 * rows.len() as u64 * row.iter().product::<usize>() as u64;
        if !plausible(bytes, self.file.file_size()) {
            return Err(Error::format(
                &self.path,
                format!(
                    "`{name}` declares shape {shape:?} but the file is only {} bytes long",
                    self.file.file_size()
                ),
            )
            .hint("the file is cut off or damaged"));
        }
        check_unfolded(
            &self.path,
            &format!("the values of `{name}`"),
            bytes,
            LARGEST,
        )?;
        if let Some(chunk) = array.chunk_shape().map_err(|e| self.damaged(e))? {
            let bytes = chunk
                .iter()
                .try_fold(8_u64, |size, &n| size.checked_mul(n))
                .unwrap_or(u64::MAX);
            if bytes > LARGEST_CHUNK {
                return Err(Error::format(
                    &self.path,
                    format!("`{name}` declares chunks of shape {chunk:?}"),
                )
                .hint("the file is damaged"));
            }
        }
        self.check_chunks(name, &array)?;
        Ok(array)
    }

    /// Rejects stored chunks that cannot fit in the file: the library allocates the declared sizes before it reads. (It
    /// cannot list the chunks of a version 2 B-tree.)
    fn check_chunks(&self, name: &str, array: &Dataset) -> Result<()> {
        match array.chunk_index().map_err(|e| self.damaged(e))? {
            None | Some(ChunkIndex::BTreeV2) => return Ok(()),
            Some(_) => {}
        }
        let size = self.file.file_size();
        let chunks = array.chunks().map_err(|e| self.damaged(e))?;
        let beyond = |chunk: &Chunk| {
            let end = chunk.address.checked_add(chunk.storage_size);
            end.is_none_or(|end| end > size)
        };
        if chunks.iter().any(beyond) {
            return Err(Error::format(
                &self.path,
                format!("`{name}` has chunks beyond the file's end"),
            )
            .hint("the file is cut off or damaged"));
        }
        Ok(())
    }

    fn counted<T>(&self, name: &str, values: Vec<T>, row: &[usize], rows: usize) -> Result<Vec<T>> {
        if values.len() == rows * row.iter().product::<usize>() {
            Ok(values)
        } else {
            Err(Error::format(&self.path, format!("`{name}` is cut off")))
        }
    }

    fn array(&self, name: &str) -> Result<Dataset> {
        self.file.dataset(name).map_err(|e| {
            let found = self.names().unwrap_or_default().join(", ");
            Error::format(&self.path, format!("has no array `{name}`; found: {found}")).because(e)
        })
    }

    fn damaged(&self, cause: hdf5_pure::Error) -> Error {
        Error::format(&self.path, "is damaged").because(cause)
    }
}

/// Reads a frame of the sparse-to-dense tree (Ma and Karaman 2018): `rgb` of shape `[3, H, W]` as
/// bytes, `depth` of shape `[H, W]` in metres.
///
/// # Errors
/// The file is missing, damaged, or has other arrays.
pub fn read_pair(path: &Path) -> Result<(RgbImage, DepthMap)> {
    let file = Hdf5::open(path)?;
    let (height, width) = match file.shape("depth")?[..] {
        [height, width] => (height, width),
        ref other => {
            return Err(Error::format(
                path,
                format!("`depth` has shape {other:?}, expected (height, width)"),
            ));
        }
    };
    let depths = file.rows_f32("depth", &[width], 0, height)?;
    let planes = file.rows_u8("rgb", &[height, width], 0, 3)?;
    Ok((
        from_planes(&planes, width, height, |x, y| y * width + x)?,
        DepthMap::new(width, height, depths)?,
    ))
}

/// Converts three planes of bytes to an image. `at` returns the index of a pixel in a plane.
///
/// # Errors
/// The number of bytes differs.
pub fn from_planes(
    planes: &[u8],
    width: usize,
    height: usize,
    at: impl Fn(usize, usize) -> usize,
) -> Result<RgbImage> {
    let area = width * height;
    if planes.len() != 3 * area {
        return Err(Error::shape(format!(
            "{} bytes do not make three planes of {width}x{height}",
            planes.len()
        )));
    }
    Ok(RgbImage::from_fn(width as u32, height as u32, |x, y| {
        let i = at(x as usize, y as usize);
        Rgb([planes[i], planes[area + i], planes[2 * area + i]])
    }))
}

/// Usual names of depth arrays, in order of preference; otherwise a name that denotes depth, or the only numeric
/// two-dimensional array.
const DEPTHS: [&str; 4] = ["depth", "depths", "sparse", "dataset"];

/// Names of the attributes for values without a measurement (netCDF, CF conventions) and, below, for their scale.
const MARKS: [&str; 3] = ["_FillValue", "missing_value", "nodata"];
const SCALE: &str = "scale_factor";

/// Reads the numbers of an array of shape `(height, width)`, with or without axes of length 1.
pub(crate) fn read_h5(path: &Path) -> Result<Raster> {
    let file = Hdf5::open(path)?;
    let names = file.maps()?;
    let name = depth_array(&names, &DEPTHS).ok_or_else(|| {
        let all = file.arrays().unwrap_or_default();
        let what = if names.is_empty() {
            format!(
                "has no array of shape (height, width). Arrays: {}",
                quoted(&all)
            )
        } else {
            format!("has no array of depths. Arrays: {}", quoted(&names))
        };
        Error::format(path, what).hint("call the array of depths `depth`")
    })?;
    let mut raster = file.map(name)?;
    let others = names.iter().filter(|other| *other != name);
    let others = others.cloned().collect();
    let warning = Warning::chosen("array", format!("`{name}`"), others);
    raster.warnings.extend(warning);
    let warning = name_warning(name, || format!("an array called `{name}`"));
    raster.warnings.extend(warning);
    Ok(raster)
}

impl Hdf5 {
    /// Returns the paths of all arrays, those at the root first.
    fn arrays(&self) -> Result<Vec<String>> {
        /// Limits; files of depths have few levels and groups.
        const LEVELS: usize = 6;
        const GROUPS: usize = 1000;
        let mut arrays = self.names()?;
        let mut groups = vec![String::new()];
        let mut visited = 0;
        for _ in 0..LEVELS {
            let mut below = Vec::new();
            for path in std::mem::take(&mut groups) {
                let group = if path.is_empty() {
                    Ok(self.file.root())
                } else {
                    self.file.group(&path)
                };
                let group = group.map_err(|e| self.damaged(e))?;
                let within = |name: &String| {
                    format!("{path}{}{name}", if path.is_empty() { "" } else { "/" })
                };
                if !path.is_empty() {
                    let names = group.datasets().map_err(|e| self.damaged(e))?;
                    arrays.extend(names.iter().map(within));
                }
                let names = group.groups().map_err(|e| self.damaged(e))?;
                below.extend(names.iter().map(within));
                visited += 1;
                if visited > GROUPS {
                    return Ok(arrays);
                }
            }
            below.sort_unstable();
            groups = below;
        }
        Ok(arrays)
    }

    /// Returns the numeric two-dimensional arrays.
    fn maps(&self) -> Result<Vec<String>> {
        let mut maps = self.arrays()?;
        maps.retain(|name| self.is_map(name));
        Ok(maps)
    }

    fn is_map(&self, name: &str) -> bool {
        let element = self.array(name).ok().and_then(|array| array.dtype().ok());
        let half = self.half(name).is_ok_and(|half| half.is_some());
        (half || element.is_some_and(|element| numbers(&element).is_some()))
            && self.shape(name).is_ok_and(|shape| plane(&shape).is_some())
    }

    /// Reads the numbers of an array in rows and columns.
    fn map(&self, name: &str) -> Result<Raster> {
        let shape = self.shape(name)?;
        let Some((rows, columns)) = plane(&shape) else {
            let what = format!("`{name}` has shape {shape:?}, expected (height, width)");
            return Err(Error::format(&self.path, what));
        };
        let array = self.array(name)?;
        let element = array.dtype().map_err(|e| self.damaged(e))?;
        let stored = numbers(&element).unwrap_or(NumberType::Floats);
        let values = if self.half(name)?.is_some() {
            self.rows_f32(name, &shape[1..], 0, shape[0])?
        } else {
            let array = self.checked(name, &shape[1..], 0..shape[0], &[element])?;
            let values = array.read_f32_rows(0, shape[0] as u64);
            let values = values.map_err(|e| self.damaged(e))?;
            self.counted(name, values, &shape[1..], shape[0])?
        };
        let mut raster = Raster::new((columns, rows), values, stored);
        let attributes = array.attrs().unwrap_or_default();
        let attribute = |name: &str| attributes.get(name).and_then(scalar);
        let fill = || array.fill_value::<f64>().ok().flatten();
        raster.declared = MARKS.iter().find_map(|name| attribute(name)).or_else(fill);
        if let Some(scale) = attribute(SCALE).filter(|scale| *scale != 1.0) {
            raster.warnings.push(Warning::Scale(scale));
        }
        Ok(raster)
    }
}

/// Returns the rows and columns of a shape of two axes, apart from axes of length 1.
fn plane(shape: &[usize]) -> Option<(usize, usize)> {
    match shape {
        &[rows, columns] | &[1, rows, columns] | &[rows, columns, 1] | &[1, 1, rows, columns]
            if rows > 0 && columns > 0 =>
        {
            Some((rows, columns))
        }
        _ => None,
    }
}

/// Returns the number type; `None` for other elements.
fn numbers(element: &DType) -> Option<NumberType> {
    Some(match element {
        DType::F32 | DType::F64 => NumberType::Floats,
        DType::U8 => NumberType::unsigned(8),
        DType::U16 => NumberType::unsigned(16),
        DType::U32 => NumberType::unsigned(32),
        DType::U64 => NumberType::unsigned(64),
        DType::I8 => NumberType::signed(8),
        DType::I16 => NumberType::signed(16),
        DType::I32 => NumberType::signed(32),
        DType::I64 => NumberType::signed(64),
        _ => return None,
    })
}

/// Returns the number of an attribute, a scalar or the first of an array.
fn scalar(value: &AttrValue) -> Option<f64> {
    Some(match value {
        AttrValue::F32(v) => f64::from(*v),
        AttrValue::F64(v) => *v,
        AttrValue::I16(v) => f64::from(*v),
        AttrValue::I32(v) => f64::from(*v),
        AttrValue::I64(v) => *v as f64,
        AttrValue::U8(v) => f64::from(*v),
        AttrValue::U16(v) => f64::from(*v),
        AttrValue::U32(v) => f64::from(*v),
        AttrValue::F32Array(v) => f64::from(*v.first()?),
        AttrValue::F64Array(v) => *v.first()?,
        AttrValue::I16Array(v) => f64::from(*v.first()?),
        AttrValue::I32Array(v) => f64::from(*v.first()?),
        AttrValue::I64Array(v) => *v.first()? as f64,
        AttrValue::U16Array(v) => f64::from(*v.first()?),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use hdf5_pure::{FileBuilder, FloatingPointLayout};

    /// Floats as h5py writes numpy.float16.
    #[test]
    fn depths_may_be_floats_of_16_bits() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.h5");
        let element = Datatype::FloatingPoint {
            size: 2,
            byte_order: DatatypeByteOrder::LittleEndian,
            layout: FloatingPointLayout {
                bit_offset: 0,
                bit_precision: 16,
                exponent_location: 10,
                exponent_size: 5,
                mantissa_location: 0,
                mantissa_size: 10,
                exponent_bias: 15,
            },
        };
        // 1, 1.5, 2, 0, -2 and 0.5 in binary16.
        let bits = [0x3c00_u16, 0x3e00, 0x4000, 0, 0xc000, 0x3800];
        let bytes = bits.map(u16::to_le_bytes).concat();
        let mut builder = FileBuilder::new();
        let array = builder.create_dataset("dataset");
        array.with_raw_data(element, bytes, 6).with_shape(&[2, 3]);
        builder.write(&path).unwrap();
        let found = read_h5(&path).unwrap();
        assert_eq!(found.values, [1.0, 1.5, 2.0, 0.0, -2.0, 0.5]);
        assert_eq!(found.warnings, []);
    }

    #[test]
    fn integers_in_groups_are_read_with_their_mark_of_no_measurement() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frame.h5");
        let mut builder = FileBuilder::new();
        builder
            .create_dataset("rgb")
            .with_u8_data(&[1; 18])
            .with_shape(&[2, 3, 3]);
        builder
            .create_dataset("mask")
            .with_u8_data(&[1; 6])
            .with_shape(&[2, 3]);
        let array = builder.create_dataset("depth");
        array
            .with_u16_data(&[1000, 2000, 9999, 0, 5, 6])
            .with_shape(&[2, 3])
            .with_fill_value(9999_u16);
        builder.write(&path).unwrap();
        let found = read_h5(&path).unwrap();
        assert_eq!(found.values, [1000.0, 2000.0, 9999.0, 0.0, 5.0, 6.0]);
        assert_eq!(
            (found.numbers, found.declared),
            (NumberType::unsigned(16), Some(9999.0))
        );
        let chosen = Warning::Chosen {
            what: "array",
            name: "`depth`".to_owned(),
            others: vec!["mask".to_owned()],
        };
        assert_eq!(found.warnings, [chosen]);
    }

    #[test]
    fn files_without_an_array_of_depths_name_their_arrays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frame.h5");
        let mut builder = FileBuilder::new();
        for name in ["red", "green"] {
            builder
                .create_dataset(name)
                .with_f32_data(&[1.0; 6])
                .with_shape(&[2, 3]);
        }
        builder.write(&path).unwrap();
        let error = read_h5(&path).unwrap_err().to_string();
        assert!(error.contains("Arrays: `green`, `red`"), "{error}");
    }
}
