//! 7-Scenes (Shotton et al. 2013): `frame-NNNNNN` with colour, depth in millimetres, and a camera-to-world matrix.

use crate::data::{DepthMap, Frame, PosedFrame, Sequence, read_depth_png, read_rgb};
use lsdc_core::Camera;
use lsdc_files::error::{Error, Result};
use std::path::{Path, PathBuf};

const POSE: &str = ".pose.txt";
/// File name suffixes of colours and depths, in the dataset and in copies of it.
const COLOURS: [&str; 4] = [".color.png", ".color.jpg", ".jpg", ".png"];
const DEPTHS: [&str; 2] = [".depth.png", "_depth.png"];
/// Depth value, in metres, that marks pixels without a measurement, as does 0.
const NO_MEASUREMENT: f32 = 65.535;
/// Intrinsics of the dataset's camera, if a folder has no `camera-intrinsics.txt`.
const FOCAL: f64 = 585.0;
const CENTER: [f64; 2] = [320.0, 240.0];

/// Reads every `step`-th frame of a folder of 7-Scenes, up to `limit` frames, sorted by name.
///
/// The camera is the depth camera. The colours of the dataset are not registered to the depths: they are some pixels off at
/// edges.
///
/// # Errors
/// A folder or file cannot be read, a pose or the intrinsics are not a matrix, there are fewer than two frames, or colour or
/// depth of a frame is missing.
pub fn seven_scenes(root: &Path, step: usize, limit: usize) -> Result<Sequence> {
    let entries = std::fs::read_dir(root).map_err(|e| Error::read(root, e))?;
    let mut names = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|e| Error::read(root, e))?;
        let name = entry.file_name().to_string_lossy().into_owned();
        names.extend(name.strip_suffix(POSE).map(str::to_owned));
    }
    names.sort();
    let camera = intrinsics(&root.join("camera-intrinsics.txt"))?;
    let frames = names.into_iter().step_by(step.max(1)).take(limit);
    let frames: Result<Vec<_>> = frames.map(|name| read(root, name, &camera)).collect();
    Sequence::new(format!("7-Scenes `{}`", root.display()), frames?)
}

fn read(root: &Path, name: String, camera: &Camera) -> Result<PosedFrame> {
    let file = |endings: &[&str], what: &str| {
        let paths = endings
            .iter()
            .map(|ending| root.join(format!("{name}{ending}")));
        let found: Option<PathBuf> = paths.into_iter().find(|path| path.is_file());
        found.ok_or_else(|| {
            Error::config(format!(
                "frame `{name}` in `{}` has no {what}",
                root.display()
            ))
            .hint(format!(
                "it is named {name}{}",
                endings.join(&format!(" or {name}"))
            ))
        })
    };
    let rgb = read_rgb(&file(&COLOURS, "colours")?)?;
    let depth = read_depth_png(&file(&DEPTHS, "depths")?, 0.001)?;
    let (width, height) = (depth.width(), depth.height());
    let mut values = depth.into_values();
    for value in values.iter_mut().filter(|value| **value >= NO_MEASUREMENT) {
        *value = 0.0;
    }
    let depth = DepthMap::new(width, height, values)?;
    let pose = matrix::<4>(&root.join(format!("{name}{POSE}")))?;
    // The inverse of a rotation is its transpose.
    let rotation = [0, 1, 2].map(|column| [0, 1, 2].map(|row: usize| pose[row][column]));
    let translation = rotation.map(|row| -(0..3).map(|i| row[i] * pose[i][3]).sum::<f64>());
    Ok(PosedFrame {
        frame: Frame::new(name, rgb, depth)?,
        camera: camera.clone().with_pose(rotation, translation),
    })
}

fn intrinsics(path: &Path) -> Result<Camera> {
    if !path.is_file() {
        return Ok(Camera::pinhole([FOCAL; 2], CENTER));
    }
    let [x, y, _] = matrix::<3>(path)?;
    Ok(Camera::pinhole([x[0], y[1]], [x[2], y[2]]))
}

/// Reads a square matrix of whitespace-separated numbers, row by row.
fn matrix<const N: usize>(path: &Path) -> Result<[[f64; N]; N]> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
    let wrong = || Error::format(path, format!("is no matrix of {N}x{N} numbers"));
    let numbers: std::result::Result<Vec<f64>, _> =
        text.split_whitespace().map(str::parse).collect();
    let numbers = numbers.map_err(|_| wrong())?;
    let rows: Vec<[f64; N]> = numbers.as_chunks().0.to_vec();
    if numbers.len() != N * N {
        return Err(wrong());
    }
    rows.try_into().map_err(|_| wrong())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{write_depth_png, write_rgb};
    use image::RgbImage;

    #[test]
    fn frames_have_inverted_poses_and_no_depth_where_there_is_a_mark() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (name, x) in [("frame-000000", 0.0), ("frame-000005", 0.25)] {
            write_rgb(&path(&format!("{name}.color.png")), &RgbImage::new(4, 2)).unwrap();
            let values = vec![0.0, 1.0, 65.535, 2.0, 2.0, 2.0, 2.0, 2.0];
            let depth = DepthMap::new(4, 2, values).unwrap();
            write_depth_png(&path(&format!("{name}.depth.png")), &depth, 0.001).unwrap();
            // The camera looks along the x axis of the world, from (x, 0.5, 0).
            let pose = format!("0 0 1 {x}\n0 1 0 0.5\n-1 0 0 0\n0 0 0 1\n");
            std::fs::write(path(&format!("{name}.pose.txt")), pose).unwrap();
        }
        let sequence = seven_scenes(folder.path(), 1, 10).unwrap();
        assert_eq!(sequence.frames().len(), 2);
        let PosedFrame { frame, camera } = &sequence.frames()[1];
        assert_eq!(frame.depth.values()[..4], [0.0, 1.0, 0.0, 2.0]);
        let (pixel, depth) = camera.project([2.25, 0.5, 0.0]).unwrap();
        assert_eq!((pixel, depth), ([320.0, 240.0], 2.0));
        assert!(seven_scenes(folder.path(), 2, 10).is_err());
        std::fs::write(path("camera-intrinsics.txt"), "1 0 2 0 1 2 0 0").unwrap();
        assert!(seven_scenes(folder.path(), 1, 10).is_err());
    }
}
