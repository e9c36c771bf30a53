//! Export of meshes to Stanford's binary PLY format.

use crate::mesh::Mesh;
use std::io::Write;

pub(crate) fn write(mesh: &Mesh, out: &mut dyn Write) -> std::io::Result<()> {
    let far = mesh.is_far();
    let real = if far { "double" } else { "float" };
    writeln!(
        out,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}",
        mesh.positions.len()
    )?;
    for name in ["x", "y", "z"] {
        writeln!(out, "property {real} {name}")?;
    }
    for name in ["nx", "ny", "nz"] {
        writeln!(out, "property float {name}")?;
    }
    if mesh.colours.is_some() {
        for name in ["red", "green", "blue"] {
            writeln!(out, "property uchar {name}")?;
        }
    }
    if !mesh.triangles.is_empty() {
        let count = mesh.triangles.len();
        writeln!(
            out,
            "element face {count}\nproperty list uchar uint vertex_indices"
        )?;
    }
    writeln!(out, "end_header")?;
    for (index, position) in mesh.positions.iter().enumerate() {
        if far {
            out.write_all(position.map(f64::to_le_bytes).as_flattened())?;
        } else {
            out.write_all(position.map(|v| (v as f32).to_le_bytes()).as_flattened())?;
        }
        out.write_all(mesh.normals[index].map(f32::to_le_bytes).as_flattened())?;
        if let Some(colours) = &mesh.colours {
            out.write_all(&colours[index])?;
        }
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        out.write_all(triangle.map(u32::to_le_bytes).as_flattened())?;
    }
    Ok(())
}
