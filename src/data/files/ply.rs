//! Clouds in Stanford's PLY, text and binary.

use super::{Visit, write_atomically};
use crate::error::{Error, Result};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{ElementDef, Encoding, Property, PropertyAccess, PropertyAccessResult};
use std::fs::File;
use std::io::{BufRead as _, BufReader};
use std::path::Path;

/// A vertex, as far as it matters here.
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
pub(super) fn read_ply(path: &Path, visit: &mut Visit<'_>) -> Result<()> {
    let damaged = |e: ply_rs_bw::parser::ParseError| {
        Error::format(path, "is no sound PLY file").because(std::io::Error::from(e))
    };
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    let size = file.metadata().map_err(|e| Error::read(path, e))?.len();
    let parser = Parser::<Vertex>::new();
    let mut reader = Reader::new(BufReader::new(file));
    let header = parser.read_header(&mut reader).map_err(damaged)?;
    for (name, element) in &header.elements {
        check(path, element, size)?;
        let is_vertex = name == "vertex";
        let mut line = String::new();
        for _ in 0..element.count {
            let source = reader.get_mut();
            let vertex = match header.encoding {
                Encoding::Ascii => {
                    line.clear();
                    source
                        .read_line(&mut line)
                        .map_err(|e| Error::read(path, e))?;
                    parser.read_ascii_element(&line, element)
                }
                Encoding::BinaryBigEndian => parser.read_big_endian_element(source, element),
                Encoding::BinaryLittleEndian => parser.read_little_endian_element(source, element),
            };
            let vertex = vertex.map_err(damaged)?;
            if is_vertex {
                visit(vertex.0);
            }
        }
        if is_vertex {
            return Ok(());
        }
    }
    Err(Error::format(path, "has no vertices"))
}

/// Refuses more elements than the file has bytes, and vertices without a place.
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

/// A point of a cloud that is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colored {
    /// x, y, z in metres.
    pub place: [f64; 3],
    /// Red, green, blue.
    pub color: [u8; 3],
    /// Standard deviation of the depth in metres.
    pub sigma: Option<f32>,
}

/// Writes a binary cloud with colours, and with standard deviations if the first point has one.
///
/// # Errors
/// The file cannot be written.
pub fn write_ply(path: &Path, points: &[Colored]) -> Result<()> {
    let sigma = points.first().is_some_and(|point| point.sigma.is_some());
    let properties = [
        ("double", "x y z"),
        ("uchar", "red green blue"),
        ("float", if sigma { "sigma" } else { "" }),
    ];
    write_atomically(path, |out| {
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
            out.write_all(point.place.map(f64::to_le_bytes).as_flattened())?;
            out.write_all(&point.color)?;
            if sigma {
                out.write_all(&point.sigma.unwrap_or(f32::NAN).to_le_bytes())?;
            }
        }
        Ok(())
    })
}
