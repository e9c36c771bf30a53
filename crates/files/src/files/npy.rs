//! NumPy `.npy` arrays of depths.

use super::{encoded, write_atomically};
use crate::DepthMap;
use crate::checks::NumberType;
use crate::error::{Error, Result};
use crate::raster::Raster;
use npyz::{DType, NpyFile, Order, WriterBuilder as _};
use std::io::Write;
use std::path::Path;

/// Reads a depth map of shape `[height, width]`, with or without an axis of length 1 before or after them, as metres =
/// value x `scale`.
///
/// Element types: float16, float32, float64, uint8 to uint64, int8 to int64, bool. NaN, infinite and negative values mean
/// no measurement, as do the values of [`crate::checks::leave_out_marks`].
///
/// # Errors
/// The file is not `.npy`, has another shape or element type, or has fewer bytes than its header declares.
pub fn read_npy(path: &Path, scale: f64) -> Result<DepthMap> {
    let (depth, _) = read_array(path)?.depth(scale)?;
    Ok(depth)
}

/// Reads an array of shape `[rows, columns]`, with or without another axis of length 1 before or after them.
pub(crate) fn read_array(path: &Path) -> Result<Raster> {
    let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
    parse(path, &bytes)
}

/// A list of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct NumberList {
    /// The numbers, in order.
    pub values: Vec<f32>,
    /// The stored type.
    pub numbers: NumberType,
}

/// Parses a list from the bytes of the `.npy` file `name` in the archive at `path`.
pub(super) fn parse_list(path: &Path, name: &str, bytes: &[u8]) -> Result<NumberList> {
    let npy = open(bytes).map_err(|source| {
        let error = Error::format(path, format!("`{name}` is not a NumPy array"));
        source.into_iter().fold(error, Error::because)
    })?;
    let [length] = npy.shape()[..] else {
        let what = format!(
            "`{name}` has shape {:?}, expected one number for each point",
            npy.shape()
        );
        return Err(Error::format(path, what).hint("save one list: shape (n,)"));
    };
    let wrong = |element: &str| {
        let what = format!("`{name}` holds `{element}` values, expected numbers");
        Error::format(path, what)
    };
    let DType::Plain(element) = npy.dtype() else {
        return Err(wrong("record"));
    };
    let size = bytes.len() as u64;
    if element
        .size_field()
        .checked_mul(length)
        .is_none_or(|n| n > size)
    {
        let what = format!("`{name}` declares {length} values but is only {size} bytes long");
        return Err(Error::format(path, what).hint("the file is cut off; write it again"));
    }
    let element = element.to_string();
    let numbers = number_type(&element);
    if numbers == NumberType::Booleans {
        return Err(wrong(&element));
    }
    let values = decode(npy, &element)
        .map_err(|e| Error::format(path, format!("`{name}` is damaged")).because(e))?
        .ok_or_else(|| wrong(&element))?;
    Ok(NumberList { values, numbers })
}

/// Parses an array from the bytes of an `.npy` file, which may be in the archive at `path`.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Result<Raster> {
    let size = bytes.len() as u64;
    let npy = open(bytes).map_err(|source| {
        let error = Error::format(path, "is not a NumPy array")
            .hint("save the depths with `numpy.save`, as a float32 array of shape (height, width)");
        source.into_iter().fold(error, Error::because)
    })?;
    let (rows, columns) = match npy.shape()[..] {
        [rows, columns] | [1, rows, columns] | [rows, columns, 1] => (rows, columns),
        ref other => {
            return Err(Error::format(
                path,
                format!("has shape {other:?}, expected (height, width)"),
            )
            .hint("save one depth per pixel of the image; 0 where there is no measurement"));
        }
    };
    let DType::Plain(element) = npy.dtype() else {
        return Err(Error::format(path, "holds records, expected plain numbers")
            .hint("save the depths as a float32 array"));
    };
    let bytes = element
        .size_field()
        .checked_mul(rows)
        .and_then(|n| n.checked_mul(columns));
    if rows == 0 || columns == 0 || bytes.is_none_or(|n| n > size) {
        return Err(Error::format(
            path,
            format!("declares {rows}x{columns} values but is only {size} bytes long"),
        )
        .hint("the file is empty or cut off; write it again"));
    }
    let fortran = npy.order() == Order::Fortran;
    let element = element.to_string();
    let stored = decode(npy, &element)
        .map_err(|e| Error::format(path, "is damaged").because(e))?
        .ok_or_else(|| {
            Error::format(path, format!("holds `{element}` values, expected numbers"))
                .hint("save the depths as a float32 array")
        })?;
    let (rows, columns) = (rows as usize, columns as usize);
    let values = if fortran {
        let position = |i: usize| (i % columns) * rows + i / columns;
        (0..stored.len()).map(|i| stored[position(i)]).collect()
    } else {
        stored
    };
    let numbers = number_type(&element);
    Ok(Raster::new((columns, rows), values, numbers))
}

fn number_type(element: &str) -> NumberType {
    let (kind, length) = kind(element).split_at(1);
    let bits = 8 * length.parse().unwrap_or(1);
    match kind {
        "b" => NumberType::Booleans,
        "u" => NumberType::unsigned(bits),
        "i" => NumberType::signed(bits),
        _ => NumberType::Floats,
    }
}

/// Reads the header of an array; the error contains the one of npyz, if any.
fn open(bytes: &[u8]) -> std::result::Result<NpyFile<&[u8]>, Option<std::io::Error>> {
    if header_length(bytes).is_none_or(|length| length > bytes.len() as u64) {
        return Err(None);
    }
    NpyFile::new(bytes).map_err(Some)
}

/// Returns an element type without its byte order, such as `f4`.
fn kind(element: &str) -> &str {
    element.trim_start_matches(['<', '>', '|', '='])
}

/// Returns the declared length of the header, which npyz allocates before reading. `None` without a header (NumPy's format
/// 1.0 has a two-byte length, later ones four).
fn header_length(bytes: &[u8]) -> Option<u64> {
    let [.., version, _, a, b, c, d] = *bytes.first_chunk::<12>()?;
    Some(match version {
        1 => u64::from(u16::from_le_bytes([a, b])),
        _ => u64::from(u32::from_le_bytes([a, b, c, d])),
    })
}

/// Returns the values in file order, or `None` for an element type that is not a number.
fn decode(npy: NpyFile<&[u8]>, element: &str) -> std::io::Result<Option<Vec<f32>>> {
    macro_rules! as_f32 {
        ($t:ty) => {
            npy.into_vec::<$t>()?
                .into_iter()
                .map(|v| v as f32)
                .collect()
        };
    }
    Ok(Some(match kind(element) {
        "f2" => npy
            .into_vec::<half::f16>()?
            .into_iter()
            .map(half::f16::to_f32)
            .collect(),
        "f4" => npy.into_vec::<f32>()?,
        "f8" => as_f32!(f64),
        "u1" => as_f32!(u8),
        "u2" => as_f32!(u16),
        "u4" => as_f32!(u32),
        "u8" => as_f32!(u64),
        "i1" => as_f32!(i8),
        "i2" => as_f32!(i16),
        "i4" => as_f32!(i32),
        "i8" => as_f32!(i64),
        "b1" => npy.into_vec::<bool>()?.into_iter().map(f32::from).collect(),
        _ => return Ok(None),
    }))
}

/// Writes a depth map as float32 of shape `(height, width)`, in metres.
///
/// # Errors
/// The file cannot be written.
pub fn write_npy(path: &Path, depth: &DepthMap) -> Result<()> {
    write_atomically(path, |out| encode(out, depth))
}

/// Returns the bytes of the file that [`write_npy`] writes.
///
/// # Errors
/// None.
pub fn encode_npy(depth: &DepthMap) -> Result<Vec<u8>> {
    encoded("an npy array", |bytes| encode(bytes, depth))
}

/// Writes the contents of an `.npy` file, float32 of shape `(height, width)`.
pub(super) fn encode(out: &mut dyn Write, depth: &DepthMap) -> std::io::Result<()> {
    let mut writer = npyz::WriteOptions::new()
        .default_dtype()
        .shape(&[depth.height() as u64, depth.width() as u64])
        .writer(out)
        .begin_nd()?;
    writer.extend(depth.values().iter().copied())?;
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_of_length_one_may_stand_before_or_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.npy");
        for shape in [&[2_u64, 3][..], &[1, 2, 3], &[2, 3, 1]] {
            let mut file = Vec::new();
            let options = npyz::WriteOptions::new().default_dtype().shape(shape);
            let mut writer = options.writer(&mut file).begin_nd().unwrap();
            writer.extend((1..=6).map(|v| v as f32)).unwrap();
            writer.finish().unwrap();
            std::fs::write(&path, file).unwrap();
            let map = read_npy(&path, 1.0).unwrap();
            assert_eq!((map.width(), map.height(), map.at(2, 1)), (3, 2, 6.0));
        }
    }
}
