//! HDF5 arrays, read a few rows at a time. The only file that knows the library behind it.

use super::{LARGEST, check_unfolded, plausible};
use crate::DepthMap;
use crate::error::{Error, Result};
use half::f16;
use hdf5_pure::{Chunk, ChunkIndex, DType, Dataset, Datatype, DatatypeByteOrder, File, Object};
use image::{Rgb, RgbImage};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// No image of any dataset is longer on a side.
const LONGEST: usize = 1 << 14;

/// No chunk of any dataset holds more bytes.
const LARGEST_CHUNK: u64 = 32 << 20;

/// An open file, of which nothing but what is asked for is read.
pub struct Hdf5 {
    path: PathBuf,
    file: File,
}

impl Hdf5 {
    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Opens a file; a user block, as in MATLAB v7.3 files, is skipped.
    ///
    /// # Errors
    /// A file that cannot be read, or is no HDF5.
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

    /// The names of the arrays at the root.
    ///
    /// # Errors
    /// A damaged file.
    pub fn names(&self) -> Result<Vec<String>> {
        let mut names = self.file.root().datasets().map_err(|e| self.damaged(e))?;
        names.sort_unstable();
        Ok(names)
    }

    /// The shape of an array: the number of rows first.
    ///
    /// # Errors
    /// No array of this name, or a damaged one.
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

    /// Rows `start..start + count` of an array of bytes whose rows have shape `row`.
    ///
    /// # Errors
    /// No array of bytes of this name and shape, or a damaged one.
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

    /// Rows `start..start + count` of an array of floats whose rows have shape `row`.
    ///
    /// # Errors
    /// No array of floats of this name and shape, or a damaged one.
    pub fn rows_f32(
        &self,
        name: &str,
        row: &[usize],
        start: usize,
        count: usize,
    ) -> Result<Vec<f32>> {
        let rows = start..start + count;
        if let Some(big) = self.half(name)? {
            // The library knows no floats of 16 bits.
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

    /// Whether an array of floats of 16 bits is big-endian; nothing if it holds others.
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

    /// The texts of a MATLAB cell array of strings.
    ///
    /// # Errors
    /// No such array, more than `most` texts, or a damaged file.
    pub fn texts(&self, name: &str, most: usize) -> Result<Vec<String>> {
        let cells = self.array(name)?;
        let shape = cells.shape().map_err(|e| self.damaged(e))?;
        if shape.iter().product::<u64>() > most as u64 {
            return Err(Error::format(&self.path, format!("`{name}` is too long")));
        }
        let objects = cells.dereference().map_err(|e| self.damaged(e))?;
        objects
            .into_iter()
            .map(|object| {
                let Object::Dataset(text) = object else {
                    return Err(Error::format(
                        &self.path,
                        format!("`{name}` holds no texts"),
                    ));
                };
                let length: u64 = text.shape().map_err(|e| self.damaged(e))?.iter().product();
                if length > 1000 {
                    return Err(Error::format(
                        &self.path,
                        format!("`{name}` holds no texts"),
                    ));
                }
                let units = text.read_u16().map_err(|e| self.damaged(e))?;
                Ok(String::from_utf16_lossy(&units))
            })
            .collect()
    }

    /// An array after its declared shape and type were found to be as expected, so that reading
    /// asks for no more memory than that.
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

    /// Refuses stored chunks that cannot lie in the file: the library makes room for what the index
    /// promises before it reads. (It cannot list the chunks of a version 2 B-tree.)
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
/// A file that is missing, damaged, or of other arrays.
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

/// An image from three planes of bytes, in each of which `at` finds a pixel.
///
/// # Errors
/// Another number of bytes.
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

/// What an array of depths is called, the first that is there counts; an only array may have any name.
const DEPTHS: [&str; 4] = ["depth", "depths", "sparse", "dataset"];

/// Reads an array of floats of shape `(height, width)` as depth: metres = value x `scale`.
pub(crate) fn read_h5(path: &Path, scale: f64) -> Result<DepthMap> {
    let file = Hdf5::open(path)?;
    let names = file.names()?;
    let known = DEPTHS.iter().find(|name| names.iter().any(|n| n == *name));
    let only = names.first().filter(|_| names.len() == 1);
    let name = known.copied().or(only.map(String::as_str)).ok_or_else(|| {
        let found = names.join(", ");
        Error::format(path, format!("holds {found}, none of which says depth"))
            .hint("call the array of depths `depth`")
    })?;
    let [height, width] = file.shape(name)?[..] else {
        return Err(Error::format(
            path,
            format!("`{name}` has another shape than (height, width)"),
        ));
    };
    let values = file.rows_f32(name, &[width], 0, height)?;
    let metres = |value: f32| (f64::from(value) * scale) as f32;
    Ok(DepthMap::new(
        width,
        height,
        values.into_iter().map(metres).collect(),
    )?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hdf5_pure::{FileBuilder, FloatingPointLayout};

    /// As h5py writes numpy.float16.
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
        let depth = read_h5(&path, 2.0).unwrap();
        assert_eq!(depth.values(), [2.0, 3.0, 4.0, 0.0, 0.0, 1.0]);
        assert_eq!(depth.ignored(), 1);
    }
}
