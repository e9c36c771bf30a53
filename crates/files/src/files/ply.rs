//! Point clouds in Stanford's PLY, text and binary.

use super::{PointVisitor, encoded, write_atomically};
use crate::error::{Error, Result};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Property, PropertyAccess, PropertyAccessResult, PropertyType,
};
use std::fs::File;
use std::io::{BufRead as _, BufReader, Write};
use std::path::Path;

/// The position of a vertex; other properties are ignored.
struct Vertex([f64; 3]);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self([f64::NAN; 3])
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let axis = match name {
            "x" => 0,
            "y" => 1,
            "z" => 2,
            _ => return PropertyAccessResult::Ignored,
        };
        self.0[axis] = match property {
            Property::Char(value) => f64::from(value),
            Property::UChar(value) => f64::from(value),
            Property::Short(value) => f64::from(value),
            Property::UShort(value) => f64::from(value),
            Property::Int(value) => f64::from(value),
            Property::UInt(value) => f64::from(value),
            Property::Float(value) => f64::from(value),
            Property::Double(value) => value,
            _ => return PropertyAccessResult::Ignored,
        };
        PropertyAccessResult::Set
    }
}

/// Visits every vertex.
pub(super) fn read_ply(path: &Path, visit: &mut PointVisitor<'_>) -> Result<()> {
    let damaged = |e: ply_rs_bw::parser::ParseError| {
        Error::format(path, "is no sound PLY file").because(std::io::Error::from(e))
    };
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let size = file.metadata().map_err(|e| Error::read(path, e))?.len();
    let parser = Parser::<Vertex>::new();
    let mut reader = Reader::new(BufReader::new(file));
    let header = parser.read_header(&mut reader).map_err(damaged)?;
    let mut line = String::new();
    let mut number = header_lines(path)?;
    for (name, element) in &header.elements {
        check(path, element, size)?;
        let is_vertex = name == "vertex";
        for _ in 0..element.count {
            let source = reader.get_mut();
            let position = match header.encoding {
                Encoding::Ascii => {
                    line.clear();
                    number += 1;
                    let length = source.read_line(&mut line);
                    length.map_err(|e| Error::read(path, e))?;
                    place_in(&line, element)
                        .map_err(|what| Error::format(path, format!("line {number}: {what}")))?
                }
                Encoding::BinaryBigEndian => {
                    let vertex = parser.read_big_endian_element(source, element);
                    vertex.map_err(damaged)?.0
                }
                Encoding::BinaryLittleEndian => {
                    let vertex = parser.read_little_endian_element(source, element);
                    vertex.map_err(damaged)?.0
                }
            };
            if is_vertex {
                visit(position);
            }
        }
        if is_vertex {
            return Ok(());
        }
    }
    Err(Error::format(path, "has no vertices"))
}

/// Returns the number of lines of the header.
fn header_lines(path: &Path) -> Result<usize> {
    let unreadable = |e| Error::read(path, e);
    let mut file = BufReader::new(File::open(path).map_err(unreadable)?);
    let mut line = Vec::new();
    let mut lines = 0;
    loop {
        line.clear();
        let length = file.read_until(b'\n', &mut line).map_err(unreadable)?;
        lines += 1;
        if length == 0 || line.trim_ascii() == b"end_header" {
            return Ok(lines);
        }
    }
}

/// Parses x, y and z from the line of an element. The library rejects numbers that C prints and reads: nan, inf, `.5` and
/// `5.`.
fn place_in(line: &str, element: &ElementDef) -> std::result::Result<[f64; 3], String> {
    let mut words = line.split_ascii_whitespace();
    let mut next = |name: &str| -> std::result::Result<f64, String> {
        let word = words.next().ok_or_else(|| format!("`{name}` is missing"))?;
        let value = word.parse();
        value.map_err(|_| format!("`{word}` in the place of `{name}` is not a number"))
    };
    let mut position = [f64::NAN; 3];
    for (name, property) in &element.properties {
        let value = next(name)?;
        match (&property.data_type, &name[..]) {
            (PropertyType::List(..), _) => {
                // An entry takes at least a digit and a space.
                if !(value >= 0.0 && value <= line.len() as f64) {
                    return Err(format!("`{name}` cannot have {value} entries"));
                }
                for _ in 0..value as usize {
                    next(name)?;
                }
            }
            (_, "x") => position[0] = value,
            (_, "y") => position[1] = value,
            (_, "z") => position[2] = value,
            _ => {}
        }
    }
    Ok(position)
}

/// Rejects more elements than the file has bytes, and vertices without a position.
fn check(path: &Path, element: &ElementDef, size: u64) -> Result<()> {
    if element.count as u64 > size {
        let (name, count) = (&element.name, element.count);
        return Err(Error::format(
            path,
            format!("declares {count} elements `{name}` but is only {size} bytes long"),
        ));
    }
    let has = |name: &str| element.properties.contains_key(name);
    if element.name == "vertex" && !["x", "y", "z"].into_iter().all(has) {
        return Err(Error::format(path, "has vertices without x, y and z"));
    }
    Ok(())
}

/// A point of a cloud to be written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColoredPoint {
    /// x, y, z in metres.
    pub position: [f64; 3],
    /// Red, green, blue.
    pub color: [u8; 3],
    /// Standard deviation of the depth in metres.
    pub sigma: Option<f32>,
}

/// Whether any coordinate is beyond 1000 m, as in georeferenced maps, where float32 rounds by more than 0.03 mm.
pub fn are_far(points: &[ColoredPoint]) -> bool {
    let mut positions = points.iter().flat_map(|point| point.position);
    positions.any(|v| v.abs() > 1000.0)
}

/// Writes a binary cloud with colours, and with standard deviations if the first point has one. Coordinates are float32,
/// or float64 if [any is far](are_far).
///
/// # Errors
/// The file cannot be written.
pub fn write_ply(path: &Path, points: &[ColoredPoint]) -> Result<()> {
    write_atomically(path, |out| encode(out, points))
}

/// Returns the bytes of the file that [`write_ply`] writes.
///
/// # Errors
/// None.
pub fn encode_ply(points: &[ColoredPoint]) -> Result<Vec<u8>> {
    encoded("a PLY cloud", |bytes| encode(bytes, points))
}

fn encode(out: &mut dyn Write, points: &[ColoredPoint]) -> std::io::Result<()> {
    let sigma = points.first().is_some_and(|point| point.sigma.is_some());
    let far = are_far(points);
    let properties = [
        (if far { "double" } else { "float" }, "x y z"),
        ("uchar", "red green blue"),
        ("float", if sigma { "sigma" } else { "" }),
    ];
    writeln!(
        out,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}",
        points.len()
    )?;
    for (kind, names) in properties {
        for name in names.split_whitespace() {
            writeln!(out, "property {kind} {name}")?;
        }
    }
    writeln!(out, "end_header")?;
    for point in points {
        if far {
            out.write_all(point.position.map(f64::to_le_bytes).as_flattened())?;
        } else {
            let position = point.position.map(|v| (v as f32).to_le_bytes());
            out.write_all(position.as_flattened())?;
        }
        out.write_all(&point.color)?;
        if sigma {
            out.write_all(&point.sigma.unwrap_or(f32::NAN).to_le_bytes())?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(body: &str) -> Result<Vec<[f64; 3]>> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scan.ply");
        let head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
            property float z\nproperty list uchar int more\nend_header\n";
        std::fs::write(&path, format!("{head}{body}")).unwrap();
        let mut points = Vec::new();
        read_ply(&path, &mut |point| points.push(point)).map(|()| points)
    }

    /// A pixel takes 15 bytes without a standard deviation, or 27 far from the origin.
    #[test]
    fn coordinates_are_floats_where_that_is_enough() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cloud.ply");
        for (x, bytes) in [(999.987_65, 15), (431_234.567_89, 27)] {
            let point = ColoredPoint {
                position: [x, -0.125, 2.5],
                color: [1, 2, 3],
                sigma: None,
            };
            write_ply(&path, &[point; 2]).unwrap();
            let written = std::fs::read(&path).unwrap();
            let head = written
                .windows(11)
                .position(|w| w == b"end_header\n")
                .unwrap()
                + 11;
            assert_eq!(written.len() - head, 2 * bytes);
            let mut found = Vec::new();
            read_ply(&path, &mut |point| found.push(point)).unwrap();
            assert_eq!(found[0][1..], [-0.125, 2.5]);
            assert!((found[0][0] - x).abs() <= 4e-5, "{found:?}");
        }
    }

    #[test]
    fn text_may_hold_every_number_that_c_prints() {
        let found = read(".5 5. -1e-3 0\nnan inf 1 2 7 8\n-.25 +2 -inf 0\n").unwrap();
        assert_eq!(found[0], [0.5, 5.0, -1e-3]);
        assert!(found[1][0].is_nan() && found[1][1] == f64::INFINITY);
        assert_eq!(found[2], [-0.25, 2.0, f64::NEG_INFINITY]);
    }

    #[test]
    fn what_is_wrong_with_a_text_is_said_with_its_line() {
        for (body, what) in [
            (
                "1 2 3 0\n1 2 x 0\n1 2 3 0\n",
                "line 10: `x` in the place of `z`",
            ),
            ("1 2 3 0\n1 2 3 0\n1 2\n", "line 11: `z` is missing"),
            ("1 2 3 -4\n", "line 9: `more` cannot have -4 entries"),
        ] {
            let error = read(body).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
    }
}
