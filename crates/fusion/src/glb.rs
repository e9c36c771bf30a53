//! Export of meshes to binary glTF 2.0 (Khronos Group 2021; ISO/IEC 12113:2022).

use crate::mesh::{Mesh, Up};
use serde_json::{Value, json};
use std::io::{Error, ErrorKind, Write};

/// Numeric codes of the standard for component types, buffer targets and primitive modes.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_SHORT: u32 = 5123;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;
const POINTS: u32 = 0;
const TRIANGLES: u32 = 4;

/// The binary data of a file: views of one buffer, each with its accessor.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds values, whose size is a multiple of 4 bytes, and returns the index of their accessor.
    fn add(
        &mut self,
        bytes: impl IntoIterator<Item = u8>,
        target: u32,
        mut accessor: Value,
    ) -> usize {
        let index = self.views.len();
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        let length = self.bytes.len() - start;
        self.views.push(json!({
            "buffer": 0, "byteOffset": start, "byteLength": length, "target": target,
        }));
        accessor["bufferView"] = json!(index);
        self.accessors.push(accessor);
        index
    }
}

pub(crate) fn write(mesh: &Mesh, up: Up, out: &mut dyn Write) -> std::io::Result<()> {
    let mut buffer = Buffer::default();
    let mut root = json!({
        "asset": { "version": "2.0", "generator": "lsdc" },
        "scene": 0,
        "scenes": [{}],
    });
    // The standard does not allow empty accessors.
    if !mesh.positions.is_empty() {
        describe(mesh, up, &mut buffer, &mut root);
    }
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    // The file header, and the header of each chunk.
    let total = 12 + 8 + text.len() + 8 + buffer.bytes.len();
    let length = |bytes: usize| {
        u32::try_from(bytes).map(u32::to_le_bytes).map_err(|_| {
            Error::new(
                ErrorKind::InvalidInput,
                "GLB files have at most 4 GiB; write PLY",
            )
        })
    };
    out.write_all(b"glTF")?;
    out.write_all(&2_u32.to_le_bytes())?;
    out.write_all(&length(total)?)?;
    out.write_all(&length(text.len())?)?;
    out.write_all(b"JSON")?;
    out.write_all(&text)?;
    out.write_all(&length(buffer.bytes.len())?)?;
    out.write_all(b"BIN\0")?;
    out.write_all(&buffer.bytes)
}

/// Fills the buffer, and adds everything that refers to it.
fn describe(mesh: &Mesh, up: Up, buffer: &mut Buffer, root: &mut Value) {
    let count = mesh.positions.len();
    let origin = origin(mesh);
    let positions: Vec<[f32; 3]> = mesh
        .positions
        .iter()
        .map(|position| [0, 1, 2].map(|axis| (position[axis] - origin[axis]) as f32))
        .collect();
    let bound = |most: fn(f32, f32) -> f32| {
        positions
            .iter()
            .copied()
            .reduce(|a, b| [0, 1, 2].map(|axis| most(a[axis], b[axis])))
    };
    let vectors = json!({ "componentType": FLOAT, "count": count, "type": "VEC3" });
    let mut bounded = vectors.clone();
    bounded["min"] = json!(bound(f32::min));
    bounded["max"] = json!(bound(f32::max));
    let floats = |values: &[[f32; 3]]| -> Vec<u8> {
        values
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes())
            .collect()
    };
    let mut attributes = json!({
        "POSITION": buffer.add(floats(&positions), VERTICES, bounded),
        "NORMAL": buffer.add(floats(&mesh.normals), VERTICES, vectors),
    });
    if let Some(colours) = &mesh.colours {
        let linear: Vec<u16> = (0..=u8::MAX).map(linear).collect();
        let colours = colours.iter().flat_map(|colour| {
            let [r, g, b] = colour.map(|v| linear[usize::from(v)]);
            [r, g, b, u16::MAX].map(u16::to_le_bytes)
        });
        let accessor = json!({
            "componentType": UNSIGNED_SHORT, "normalized": true, "count": count, "type": "VEC4",
        });
        attributes["COLOR_0"] = json!(buffer.add(colours.flatten(), VERTICES, accessor));
    }
    let mut primitive = json!({ "attributes": attributes, "material": 0, "mode": POINTS });
    if !mesh.triangles.is_empty() {
        let accessor = json!({
            "componentType": UNSIGNED_INT, "count": 3 * mesh.triangles.len(), "type": "SCALAR",
        });
        let indices = mesh
            .triangles
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes());
        primitive["indices"] = json!(buffer.add(indices, INDICES, accessor));
        primitive["mode"] = json!(TRIANGLES);
    }
    let mut material = json!({
        "doubleSided": true,
        "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 1.0 },
    });
    // Colours from images include the lighting.
    if mesh.colours.is_some() {
        material["extensions"] = json!({ "KHR_materials_unlit": {} });
        root["extensionsUsed"] = json!(["KHR_materials_unlit"]);
    }
    root["scenes"] = json!([{ "nodes": [0] }]);
    root["nodes"] = json!([{ "mesh": 0, "matrix": matrix(up, origin) }]);
    root["meshes"] = json!([{ "primitives": [primitive] }]);
    root["materials"] = json!([material]);
    root["buffers"] = json!([{ "byteLength": buffer.bytes.len() }]);
    root["bufferViews"] = json!(buffer.views);
    root["accessors"] = json!(buffer.accessors);
}

/// Returns the origin of positions: the first position, rounded to whole units, if positions are far from the origin of the
/// world.
fn origin(mesh: &Mesh) -> [f64; 3] {
    match mesh.positions.first() {
        Some(first) if mesh.is_far() => first.map(f64::round),
        _ => [0.0; 3],
    }
}

/// Returns the matrix of the node, column by column.
fn matrix(up: Up, origin: [f64; 3]) -> [f64; 16] {
    let rotation = up.to_y();
    let translation = rotation.map(|row| (0..3).map(|axis| row[axis] * origin[axis]).sum());
    let mut columns = [[0.0; 4]; 4];
    for (row, values) in rotation.iter().enumerate() {
        for (column, value) in values.iter().enumerate() {
            columns[column][row] = *value;
        }
    }
    columns[3][..3].copy_from_slice(&translation);
    columns[3][3] = 1.0;
    let mut matrix = [0.0; 16];
    matrix.copy_from_slice(columns.as_flattened());
    matrix
}

/// Converts an sRGB value to linear light, as required by glTF (IEC 61966-2-1).
fn linear(value: u8) -> u16 {
    let value = f64::from(value) / 255.0;
    let linear = if value <= 0.04045 {
        value / 12.92
    } else {
        ((value + 0.055) / 1.055).powf(2.4)
    };
    (linear * f64::from(u16::MAX)).round() as u16
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(bytes: &[u8], at: usize) -> usize {
        u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize
    }

    #[test]
    fn chunks_and_accessors_describe_the_mesh() {
        let mesh = Mesh {
            positions: vec![[5000.25, 0.0, 1.0], [5001.0, 0.0, 2.0], [5000.0, 3.0, 1.0]],
            normals: vec![[0.0, 0.0, 1.0]; 3],
            colours: Some(vec![[0, 128, 255]; 3]),
            uncoloured: 0,
            triangles: vec![[0, 1, 2]],
        };
        let mut bytes = Vec::new();
        mesh.write_glb("z".parse().unwrap(), &mut bytes).unwrap();
        assert_eq!((&bytes[..4], number(&bytes, 4)), (&b"glTF"[..], 2));
        assert_eq!(number(&bytes, 8), bytes.len());
        let text = number(&bytes, 12);
        let root: Value = serde_json::from_slice(&bytes[20..20 + text]).unwrap();
        let data = &bytes[28 + text..];
        assert_eq!(number(&bytes, 20 + text), data.len());
        assert_eq!(root["buffers"][0]["byteLength"], data.len());
        // 3 vertices with two vectors and four shorts each, and 3 indices.
        assert_eq!(data.len(), 3 * (12 + 12 + 8) + 12);
        assert_eq!(root["accessors"][0]["min"], json!([0.0, 0.0, 0.0]));
        assert_eq!(root["accessors"][0]["max"], json!([1.0, 3.0, 1.0]));
        let views = root["bufferViews"].as_array().unwrap();
        let ends = views.iter().map(|view| {
            view["byteOffset"].as_u64().unwrap() + view["byteLength"].as_u64().unwrap()
        });
        assert_eq!(ends.max(), Some(data.len() as u64));
        // z of the world is y of the file; y is -z.
        let matrix: Vec<f64> = serde_json::from_value(root["nodes"][0]["matrix"].clone()).unwrap();
        assert_eq!(matrix[4..8], [0.0, 0.0, -1.0, 0.0]);
        assert_eq!(matrix[8..12], [0.0, 1.0, 0.0, 0.0]);
        assert_eq!(matrix[12..15], [5000.0, 1.0, 0.0]);
        // The luminance of sRGB's mid grey is 21.6 % of white.
        let green = u16::from_le_bytes([data[74], data[75]]);
        assert!((f64::from(green) / 65535.0 - 0.2159).abs() < 1e-4);
    }
}
