//! Files in the formats of other programs.

use crate::camera::{Camera, Lens, Sight};
use crate::vector::Vector;
use image::codecs::png::PngEncoder;
use image::{ImageEncoder as _, RgbImage};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Formats of a cloud.
pub(crate) const CLOUDS: [&str; 4] = ["ply", "xyz", "csv", "npy"];

/// Writes a cloud as `cloud.<form>`.
pub(crate) fn write_cloud(folder: &Path, form: &str, points: &[Vector]) -> PathBuf {
    let path = folder.join(format!("cloud.{form}"));
    if form == "npy" {
        let values = points.iter().flatten().map(|&v| v as f32).collect();
        write_npy(&path, [points.len(), 3], values);
        return path;
    }
    let (mut text, between) = match form {
        "ply" => {
            let head = format!(
                "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
                 property double z\nend_header\n",
                points.len()
            );
            (head, ' ')
        }
        "csv" => ("x,y,z\n".to_owned(), ','),
        _ => (String::new(), ' '),
    };
    for [x, y, z] in points {
        writeln!(text, "{x}{between}{y}{between}{z}").unwrap();
    }
    std::fs::write(&path, text).unwrap();
    path
}

/// Writes a table u, v, depth.
pub(crate) fn write_table(folder: &Path, sights: &[Sight]) -> PathBuf {
    let path = folder.join("table.csv");
    let mut text = "u,v,depth\n".to_owned();
    for Sight { place, depth } in sights {
        writeln!(text, "{},{},{depth}", place[0], place[1]).unwrap();
    }
    std::fs::write(&path, text).unwrap();
    path
}

/// Writes an array of rows and columns (NumPy's format 1.0).
pub(crate) fn write_npy(path: &Path, [rows, columns]: [usize; 2], values: Vec<f32>) {
    assert_eq!(values.len(), rows * columns);
    let head =
        format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({rows}, {columns}), }}");
    let head = format!("{head:<117}\n");
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((head.len() as u16).to_le_bytes());
    file.extend(head.as_bytes());
    file.extend(values.into_iter().flat_map(f32::to_le_bytes));
    std::fs::write(path, file).unwrap();
}

/// Writes a camera as `camera.toml`.
pub(crate) fn write_camera(folder: &Path, camera: &Camera) -> PathBuf {
    let path = folder.join("camera.toml");
    let Camera {
        size: (width, height),
        focal: [fx, fy],
        center: [cx, cy],
        ..
    } = camera;
    let lens = match camera.lens {
        Lens::Pinhole => "model = \"pinhole\"".to_owned(),
        Lens::Radtan(k) => format!("model = \"radtan\"\ndistortion = {k:?}"),
        Lens::Fisheye(k) => format!("model = \"fisheye\"\ndistortion = {k:?}"),
    };
    let text = format!(
        "width = {width}\nheight = {height}\nfx = {fx:?}\nfy = {fy:?}\ncx = {cx:?}\ncy = {cy:?}\n\
         {lens}\nworld_to_camera = {:?}\n",
        camera.world_to_camera()
    );
    std::fs::write(&path, text).unwrap();
    path
}

/// Writes a COLMAP model with one image, `photo.png`, which sees these points. COLMAP has the centre of the first pixel at 0.5.
pub(crate) fn write_model(folder: &Path, camera: &Camera, points: &[Vector]) -> PathBuf {
    let model = folder.join("model");
    std::fs::create_dir_all(&model).unwrap();
    let ((width, height), [fx, fy]) = (camera.size, camera.focal);
    let [cx, cy] = camera.center.map(|v| v + 0.5);
    let (kind, k) = match camera.lens {
        Lens::Pinhole => ("PINHOLE", String::new()),
        Lens::Radtan([k1, k2, p1, p2]) => ("OPENCV", format!(" {k1} {k2} {p1} {p2}")),
        Lens::Fisheye([k1, k2, k3, k4]) => ("OPENCV_FISHEYE", format!(" {k1} {k2} {k3} {k4}")),
    };
    let cameras = format!("1 {kind} {width} {height} {fx} {fy} {cx} {cy}{k}\n");
    let ([w, a, b, c], [x, y, z]) = (camera.rotation.0, camera.translation());
    let mut images = format!("1 {w} {a} {b} {c} {x} {y} {z} 1 photo.png\n");
    let mut landmarks = String::new();
    for (i, &point) in points.iter().enumerate() {
        let [u, v] = camera.see_inside(point).unwrap().place.map(|v| v + 0.5);
        write!(images, "{u} {v} {} ", i + 1).unwrap();
        let [x, y, z] = point;
        writeln!(landmarks, "{} {x} {y} {z} 0 0 0 0.5 1 {i}", i + 1).unwrap();
    }
    images.push('\n');
    for (name, text) in [
        ("cameras", cameras),
        ("images", images),
        ("points3D", landmarks),
    ] {
        std::fs::write(model.join(format!("{name}.txt")), text).unwrap();
    }
    model
}

/// Writes a PNG whose EXIF record has only an orientation.
pub(crate) fn write_photo(folder: &Path, image: &RgbImage, orientation: u8) -> PathBuf {
    let path = folder.join("photo.png");
    let head = [b'I', b'I', 42, 0, 8, 0, 0, 0, 1, 0];
    let tag = [0x12, 0x01, 3, 0, 1, 0, 0, 0, orientation, 0, 0, 0];
    let mut file = Vec::new();
    let mut encoder = PngEncoder::new(&mut file);
    let exif = [&head[..], &tag, &[0; 4]].concat();
    encoder.set_exif_metadata(exif).unwrap();
    image.write_with_encoder(encoder).unwrap();
    std::fs::write(&path, file).unwrap();
    path
}
