//! Sequences: frames of one scene, each with the calibrated pose of its camera.

use super::{DepthMap, Frame, write_atomically, write_npy, write_rgb};
use lsdc_core::Camera;
use lsdc_files::error::{Error, Result};
use serde_json::json;
use std::path::Path;

/// A frame and its camera.
#[derive(Clone, Debug)]
pub struct PosedFrame {
    /// Image and true depth.
    pub frame: Frame,
    /// The camera that took it, with its pose in the world of the sequence, in metres.
    pub camera: Camera,
}

/// Frames of one scene in the order of time.
#[derive(Clone, Debug)]
pub struct Sequence {
    description: String,
    frames: Vec<PosedFrame>,
}

/// Timestamp of the first frame in written files, in seconds; file names are timestamps.
const START: f64 = 1000.0;
const INTERVAL: f64 = 0.1;

impl Sequence {
    /// Creates a sequence from the frames of a scene, with a description.
    ///
    /// # Errors
    /// Fewer than two frames, or a camera with invalid parameters.
    pub fn new(description: String, frames: Vec<PosedFrame>) -> Result<Self> {
        if frames.len() < 2 {
            let count = frames.len();
            return Err(Error::config(format!(
                "{description}: a sequence has at least 2 frames, not {count}"
            )));
        }
        for PosedFrame { frame, camera } in &frames {
            camera.check().map_err(|error| {
                Error::config(format!("frame `{}` has no valid camera", frame.id)).because(error)
            })?;
        }
        Ok(Self {
            description,
            frames,
        })
    }

    /// Returns the description.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// Returns the frames in the order of time; at least two.
    pub fn frames(&self) -> &[PosedFrame] {
        &self.frames
    }

    /// Writes the sequence below a folder, for other programs: `images/TIME.png`, the sparse depths `points/TIME.npy`, the
    /// true depths `depth/TIME.npy` (metres), `poses.txt` (a TUM trajectory: time, position, and quaternion x, y, z, w, from
    /// camera to world) and `camera.json`, the intrinsics. Times are seconds, 0.1 s apart. `sparse` has a map for each frame.
    ///
    /// # Errors
    /// The numbers of maps and frames differ, cameras have different intrinsics or a distortion, or files cannot be written.
    pub fn write(&self, folder: &Path, sparse: &[DepthMap]) -> Result<()> {
        if sparse.len() != self.frames.len() {
            return Err(Error::shape(format!(
                "{} maps of sparse depths for {} frames",
                sparse.len(),
                self.frames.len()
            )));
        }
        let Intrinsics { focal, center } = self.intrinsics()?;
        for part in ["images", "points", "depth"] {
            let path = folder.join(part);
            std::fs::create_dir_all(&path).map_err(|e| Error::write(&path, e))?;
        }
        let mut trajectory = String::from("# time tx ty tz qx qy qz qw, camera to world\n");
        for (index, (posed, sparse)) in self.frames.iter().zip(sparse).enumerate() {
            let time = format!("{:.6}", START + INTERVAL * index as f64);
            let file =
                |part: &str, ending: &str| folder.join(part).join(format!("{time}.{ending}"));
            write_rgb(&file("images", "png"), &posed.frame.rgb)?;
            write_npy(&file("points", "npy"), sparse)?;
            write_npy(&file("depth", "npy"), &posed.frame.depth)?;
            let (rotation, translation) = posed.camera.pose();
            let columns = [0, 1, 2].map(|column| rotation.map(|row| row[column]));
            let place = columns.map(|row| -(0..3).map(|i| row[i] * translation[i]).sum::<f64>());
            let pose = place
                .iter()
                .chain(&quaternion(columns))
                .fold(time, |line, number| format!("{line} {number:.9}"));
            trajectory += &pose;
            trajectory.push('\n');
        }
        write_atomically(&folder.join("poses.txt"), |out| {
            out.write_all(trajectory.as_bytes())
        })?;
        let (width, height) = self.frames[0].frame.rgb.dimensions();
        let camera = json!({
            "width": width,
            "height": height,
            "fx": focal[0],
            "fy": focal[1],
            "cx": center[0],
            "cy": center[1],
        });
        write_atomically(&folder.join("camera.json"), |out| {
            writeln!(out, "{camera:#}")
        })
    }

    /// Returns the intrinsics shared by all frames.
    fn intrinsics(&self) -> Result<Intrinsics> {
        let of = |posed: &PosedFrame| {
            let camera = &posed.camera;
            (
                camera.focal(),
                camera.center(),
                posed.frame.rgb.dimensions(),
            )
        };
        let first = &self.frames[0];
        let pinhole = |posed: &PosedFrame| posed.camera.lens().coefficients().is_empty();
        if self
            .frames
            .iter()
            .all(|posed| pinhole(posed) && of(posed) == of(first))
        {
            let (focal, center, _) = of(first);
            return Ok(Intrinsics { focal, center });
        }
        Err(Error::config(format!(
            "{}: only a sequence of one pinhole camera can be written",
            self.description
        )))
    }
}

struct Intrinsics {
    focal: [f64; 2],
    center: [f64; 2],
}

/// Returns the quaternion x, y, z, w of a rotation matrix, given row by row (Shepperd 1978): divides by the largest component.
fn quaternion(m: [[f64; 3]; 3]) -> [f64; 4] {
    let trace = m[0][0] + m[1][1] + m[2][2];
    let largest = (0..3).fold(None, |best: Option<usize>, i| {
        let than = best.map_or(trace, |b| m[b][b]);
        if m[i][i] > than { Some(i) } else { best }
    });
    let mut q = [0.0; 4];
    match largest {
        None => {
            let axes = [0, 1, 2].map(|i| {
                let (j, k) = ((i + 1) % 3, (i + 2) % 3);
                m[k][j] - m[j][k]
            });
            q[..3].copy_from_slice(&axes);
            q[3] = 1.0 + trace;
        }
        Some(i) => {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            q[i] = 1.0 + m[i][i] - m[j][j] - m[k][k];
            q[j] = m[j][i] + m[i][j];
            q[k] = m[k][i] + m[i][k];
            q[3] = m[k][j] - m[j][k];
        }
    }
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / length)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;
    use lsdc_files::rotation_matrix;

    /// Each component is the largest one once.
    const QUATERNIONS: [[f64; 4]; 4] = [
        [0.8, 0.4, 0.2, 0.4],
        [0.1, -0.7, 0.5, 0.5],
        [-0.1, 0.3, 0.9, 0.3],
        [0.1, 0.1, -0.7, 0.7],
    ];

    #[test]
    fn quaternions_are_those_of_the_matrix() {
        for q in QUATERNIONS {
            let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            let q = q.map(|v| v / length);
            let found = quaternion(rotation_matrix(q));
            let same: f64 = q.iter().zip(found).map(|(a, b)| a * b).sum();
            assert!((same.abs() - 1.0).abs() < 1e-12, "{q:?} {found:?}");
        }
    }

    #[test]
    fn written_files_are_read_back() {
        let folder = tempfile::tempdir().unwrap();
        // 90 degrees about y: the camera looks along the x axis of the world.
        let rotation = [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]];
        let frame = |i: usize| PosedFrame {
            frame: Frame::new(
                format!("{i}"),
                RgbImage::new(4, 2),
                DepthMap::new(4, 2, vec![1.5 + i as f32; 8]).unwrap(),
            )
            .unwrap(),
            camera: Camera::pinhole([3.0, 3.5], [1.5, 0.5])
                .with_pose(rotation, [0.0, 0.0, -(i as f64)]),
        };
        let sequence = Sequence::new("two".into(), vec![frame(0), frame(1)]).unwrap();
        let sparse = [0, 1].map(|_| DepthMap::empty(4, 2));
        sequence.write(folder.path(), &sparse).unwrap();
        assert!(sequence.write(folder.path(), &sparse[..1]).is_err());
        let poses = std::fs::read_to_string(folder.path().join("poses.txt")).unwrap();
        let last: Vec<f64> = poses
            .lines()
            .last()
            .unwrap()
            .split(' ')
            .map(|number| number.parse().unwrap())
            .collect();
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let expected = [1000.1, 1.0, 0.0, 0.0, 0.0, half, 0.0, half];
        assert_eq!(last.len(), 8);
        assert!(
            last.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-8),
            "{last:?}"
        );
        let camera = std::fs::read_to_string(folder.path().join("camera.json")).unwrap();
        let camera: serde_json::Value = serde_json::from_str(&camera).unwrap();
        assert_eq!(
            (camera["fy"].as_f64(), camera["width"].as_u64()),
            (Some(3.5), Some(4))
        );
        let depth = super::super::read_npy(&folder.path().join("depth/1000.100000.npy"), 1.0);
        assert_eq!(depth.unwrap(), sequence.frames()[1].frame.depth);
    }
}
