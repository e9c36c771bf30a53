//! Cameras: where points appear in the image, and where pixels lie in space.

use crate::error::{Error, Result};
use serde::Deserialize;
use std::path::Path;
use std::str::FromStr;

/// A calibrated camera at its place in the world. Pixels count from the centre of the first, as in
/// OpenCV; x points to the right, y down, z forwards.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Width and height of the image that it was calibrated for, if they are known.
    size: Option<(usize, usize)>,
    focal: [f64; 2],
    center: [f64; 2],
    lens: Lens,
    /// From the world to the camera.
    pose: Pose,
}

/// A rotation, row by row, and a translation.
type Pose = ([[f64; 3]; 3], [f64; 3]);

/// How a lens moves the picture of a point.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Lens {
    Pinhole,
    /// Brown's radial and tangential distortion as in OpenCV: k1, k2, p1, p2, k3, k4, k5, k6.
    /// Beyond the radius (the tangent of the angle), pictures fold back.
    Radtan {
        coefficients: [f64; 8],
        radius: f64,
    },
    /// Kannala and Brandt (2006) as in OpenCV's fisheye module: k1 to k4.
    Fisheye([f64; 4]),
}

/// Newton's steps to find where a pixel came from.
const STEPS: usize = 20;

impl Camera {
    /// A camera without distortion at the origin.
    pub fn pinhole(focal: [f64; 2], center: [f64; 2]) -> Self {
        Self {
            size: None,
            focal,
            center,
            lens: Lens::Pinhole,
            pose: (IDENTITY, [0.0; 3]),
        }
    }

    /// Reads a camera from TOML or JSON: `fx, fy, cx, cy`, or `intrinsic_matrix` of 9 numbers column
    /// by column as `Open3D` writes it; `width, height`; `model` (`pinhole`, `radtan`, `fisheye`) with
    /// its `distortion`; `world_to_camera` or `camera_to_world`, 3 or 4 rows of 4 numbers.
    ///
    /// # Errors
    /// A file that is missing or no camera.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|e| Error::read(path, e))?;
        let stored: Stored = if super::files::has_ending(path, "json") {
            serde_json::from_str(&text).map_err(|e| Error::format(path, "is no camera").because(e))
        } else {
            toml::from_str(&text).map_err(|e| Error::format(path, "is no camera").because(e))
        }
        .map_err(|e| e.hint("a camera is TOML or JSON with fx, fy, cx, cy; see docs/guide.md"))?;
        Self::try_from(stored).map_err(|what| Error::format(path, what))
    }

    pub(super) fn with_lens(self, lens: Lens) -> Self {
        Self { lens, ..self }
    }

    pub(super) fn with_size(self, size: (usize, usize)) -> Self {
        Self {
            size: Some(size),
            ..self
        }
    }

    pub(super) fn with_pose(self, rotation: [[f64; 3]; 3], translation: [f64; 3]) -> Self {
        Self {
            pose: (rotation, translation),
            ..self
        }
    }

    /// Pixels from edge to edge of a radian straight ahead, the mean of both axes.
    pub(super) fn focal(&self) -> f64 {
        f64::midpoint(self.focal[0], self.focal[1])
    }

    /// The camera of the same image at another size.
    #[must_use]
    pub fn resized(&self, size: (usize, usize)) -> Self {
        let from = self.size.unwrap_or(size);
        let factors = [
            size.0 as f64 / from.0.max(1) as f64,
            size.1 as f64 / from.1.max(1) as f64,
        ];
        let mut camera = self.clone().with_size(size);
        for (axis, factor) in factors.into_iter().enumerate() {
            camera.focal[axis] *= factor;
            camera.center[axis] = (camera.center[axis] + 0.5) * factor - 0.5;
        }
        camera
    }

    /// Pixel (column, row) and depth of a point of the world; `None` behind the camera and where the
    /// lens does not look.
    pub fn project(&self, point: [f64; 3]) -> Option<([f64; 2], f64)> {
        let (rotation, translation) = &self.pose;
        let mut place = *translation;
        for (coordinate, row) in place.iter_mut().zip(rotation) {
            *coordinate += dot(*row, point);
        }
        let [x, y, z] = place;
        if !(z > 0.0 && z.is_finite()) {
            return None;
        }
        let seen = self.lens.distort([x / z, y / z])?;
        let pixel = [0, 1].map(|axis| self.focal[axis] * seen[axis] + self.center[axis]);
        pixel.iter().all(|v| v.is_finite()).then_some((pixel, z))
    }

    /// The point of the world at a pixel (column, row) and depth; `None` where the lens does not
    /// look.
    pub fn unproject(&self, pixel: [f64; 2], depth: f64) -> Option<[f64; 3]> {
        let seen = [0, 1].map(|axis| (pixel[axis] - self.center[axis]) / self.focal[axis]);
        let [x, y] = self.lens.undistort(seen)?;
        let (rotation, translation) = &self.pose;
        let place = [
            x * depth - translation[0],
            y * depth - translation[1],
            depth - translation[2],
        ];
        // The inverse of a rotation is its transpose.
        Some([0, 1, 2].map(|axis| dot([0, 1, 2].map(|row| rotation[row][axis]), place)))
    }
}

impl FromStr for Camera {
    type Err = Error;

    /// `FX,FY,CX,CY`, or the path of a file.
    fn from_str(text: &str) -> Result<Self> {
        let numbers: Vec<Option<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
        let [fx @ Some(_), fy @ Some(_), cx @ Some(_), cy @ Some(_)] = numbers[..] else {
            return Self::read(Path::new(text));
        };
        let stored = Stored {
            fx,
            fy,
            cx,
            cy,
            ..Stored::default()
        };
        Self::try_from(stored).map_err(|what| Error::config(format!("`{text}` {what}")))
    }
}

impl Lens {
    pub(super) fn radtan(coefficients: [f64; 8]) -> Self {
        /// Of the search for the fold.
        const STEPS: usize = 1000;
        /// The tangent of 84 degrees.
        const LAST: f64 = 10.0;
        let radius = |step: usize| LAST * step as f64 / STEPS as f64;
        let seen = |step: usize| radius(step) * radial(&coefficients, radius(step).powi(2));
        let rising = (1..=STEPS).take_while(|&step| seen(step) > seen(step - 1));
        let last = rising.last().unwrap_or(0);
        Self::Radtan {
            coefficients,
            radius: if last == STEPS {
                f64::INFINITY
            } else {
                radius(last)
            },
        }
    }

    /// Where a ray through (x, y, 1) appears, in focal lengths from the centre.
    fn distort(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let square = x * x + y * y;
        match self {
            Self::Pinhole => Some([x, y]),
            Self::Radtan {
                coefficients,
                radius,
            } => {
                if square > radius * radius {
                    return None;
                }
                let [_, _, p1, p2, ..] = *coefficients;
                let radial = radial(coefficients, square);
                Some([
                    x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
                    y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
                ])
            }
            Self::Fisheye([k1, k2, k3, k4]) => {
                let radius = square.sqrt();
                if radius < 1e-12 {
                    return Some([x, y]);
                }
                let angle = radius.atan();
                let s = angle * angle;
                let seen = angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))));
                Some([x * seen / radius, y * seen / radius])
            }
        }
    }

    /// The ray that appears there, by Newton's method.
    fn undistort(&self, seen: [f64; 2]) -> Option<[f64; 2]> {
        const DIFFERENCE: f64 = 1e-6;
        const NEAR: f64 = 1e-9;
        if *self == Self::Pinhole {
            return Some(seen);
        }
        let mut ray = match self {
            // Straight ahead a fisheye sees angles, which tangents outgrow.
            Self::Fisheye(_) => {
                let angle = (seen[0].powi(2) + seen[1].powi(2)).sqrt();
                let factor = angle.clamp(1e-12, 1.5).tan() / angle.max(1e-12);
                seen.map(|v| v * factor)
            }
            _ => seen,
        };
        for _ in 0..STEPS {
            let here = self.distort(ray)?;
            let off = [here[0] - seen[0], here[1] - seen[1]];
            if off[0].abs().max(off[1].abs()) < NEAR {
                return Some(ray);
            }
            let right = self.distort([ray[0] + DIFFERENCE, ray[1]])?;
            let below = self.distort([ray[0], ray[1] + DIFFERENCE])?;
            let [a, c] = [0, 1].map(|axis| (right[axis] - here[axis]) / DIFFERENCE);
            let [b, d] = [0, 1].map(|axis| (below[axis] - here[axis]) / DIFFERENCE);
            let determinant = a * d - b * c;
            ray[0] -= (d * off[0] - b * off[1]) / determinant;
            ray[1] -= (a * off[1] - c * off[0]) / determinant;
        }
        None
    }
}

fn radial([k1, k2, _, _, k3, k4, k5, k6]: &[f64; 8], square: f64) -> f64 {
    (1.0 + square * (k1 + square * (k2 + square * k3)))
        / (1.0 + square * (k4 + square * (k5 + square * k6)))
}

const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// A camera as it is written in a file.
#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stored {
    width: Option<usize>,
    height: Option<usize>,
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    intrinsic_matrix: Option<[f64; 9]>,
    #[serde(default)]
    model: Model,
    #[serde(default)]
    distortion: Vec<f64>,
    world_to_camera: Option<Vec<[f64; 4]>>,
    camera_to_world: Option<Vec<[f64; 4]>>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Model {
    #[default]
    Pinhole,
    Radtan,
    Fisheye,
}

impl TryFrom<Stored> for Camera {
    type Error = String;

    fn try_from(stored: Stored) -> std::result::Result<Self, String> {
        let numbers = [stored.fx, stored.fy, stored.cx, stored.cy];
        let [fx, fy, cx, cy] = match (numbers, stored.intrinsic_matrix) {
            ([Some(fx), Some(fy), Some(cx), Some(cy)], None) => [fx, fy, cx, cy],
            ([None, None, None, None], Some(m)) => [m[0], m[4], m[6], m[7]],
            _ => return Err("needs fx, fy, cx and cy, or an intrinsic_matrix".to_owned()),
        };
        let sound = fx > 0.0 && fy > 0.0 && [fx, fy, cx, cy].iter().all(|v| v.is_finite());
        if !sound {
            return Err(format!("cannot have fx {fx}, fy {fy}, cx {cx}, cy {cy}"));
        }
        let mut camera = Self::pinhole([fx, fy], [cx, cy]);
        camera.size = match (stored.width, stored.height) {
            (Some(width), Some(height)) if width > 0 && height > 0 => Some((width, height)),
            (None, None) => None,
            _ => return Err("needs both width and height, or neither".to_owned()),
        };
        camera.lens = stored.model.lens(&stored.distortion)?;
        camera.pose = match (stored.world_to_camera, stored.camera_to_world) {
            (None, None) => camera.pose,
            (Some(rows), None) => pose(&rows)?,
            (None, Some(rows)) => inverse(pose(&rows)?),
            (Some(_), Some(_)) => {
                return Err("has both world_to_camera and camera_to_world".to_owned());
            }
        };
        Ok(camera)
    }
}

impl Model {
    fn lens(self, distortion: &[f64]) -> std::result::Result<Lens, String> {
        let few = |counts: &str| {
            let found = distortion.len();
            Err(format!(
                "has {found} distortion coefficients, {self:?} takes {counts}"
            ))
        };
        if let Some(bad) = distortion.iter().find(|v| !v.is_finite()) {
            return Err(format!("cannot have a distortion of {bad}"));
        }
        match (self, distortion.len()) {
            (Self::Pinhole, 0) => Ok(Lens::Pinhole),
            (Self::Pinhole, _) => few("none; say model radtan or fisheye"),
            (Self::Radtan, 4 | 5 | 8) => {
                let mut coefficients = [0.0; 8];
                coefficients[..distortion.len()].copy_from_slice(distortion);
                Ok(Lens::radtan(coefficients))
            }
            (Self::Radtan, _) => few("4, 5 or 8: k1, k2, p1, p2, k3, k4, k5, k6"),
            (Self::Fisheye, _) => match *distortion {
                [k1, k2, k3, k4] => Ok(Lens::Fisheye([k1, k2, k3, k4])),
                _ => few("4: k1 to k4"),
            },
        }
    }
}

/// A pose in the rows of a matrix, whose rotation is one.
fn pose(rows: &[[f64; 4]]) -> std::result::Result<Pose, String> {
    /// How far the product with its transpose may be from one; files round.
    const NEAR: f64 = 1e-3;
    let (Some(&[a, b, c]), 3 | 4) = (rows.first_chunk(), rows.len()) else {
        return Err(format!(
            "has a pose of {} rows, expected 3 or 4",
            rows.len()
        ));
    };
    let rotation = [a, b, c].map(|row| [row[0], row[1], row[2]]);
    for i in 0..3 {
        for j in 0..3 {
            let off = (dot(rotation[i], rotation[j]) - IDENTITY[i][j]).abs();
            if off.is_nan() || off > NEAR {
                return Err("has a pose whose first three columns are no rotation".to_owned());
            }
        }
    }
    Ok((rotation, [a[3], b[3], c[3]]))
}

fn inverse((rotation, translation): Pose) -> Pose {
    let transposed = [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation[j][i]));
    (transposed, transposed.map(|row| -dot(row, translation)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stored(text: &str) -> std::result::Result<Camera, String> {
        let stored: Stored = toml::from_str(text).map_err(|e| e.to_string())?;
        Camera::try_from(stored)
    }

    const RADTAN: &str = "fx = 500\nfy = 510\ncx = 320\ncy = 240\nmodel = 'radtan'\n\
        distortion = [-0.28, 0.07, 0.0002, 0.00002, 0.0]\n";
    const FISHEYE: &str = "fx = 380\nfy = 380\ncx = 319.5\ncy = 239.5\nmodel = 'fisheye'\n\
        distortion = [-0.01, 0.02, -0.015, 0.003]\n";

    /// Answers of cv2.projectPoints and cv2.fisheye.projectPoints (OpenCV 5.0).
    #[test]
    fn points_appear_where_opencv_says() {
        for (text, expected) in [(RADTAN, OPENCV_RADTAN), (FISHEYE, OPENCV_FISHEYE)] {
            let camera = stored(text).unwrap();
            for (point, pixel) in POINTS.into_iter().zip(expected) {
                let (found, depth) = camera.project(point).unwrap();
                assert_eq!(depth, point[2]);
                for axis in 0..2 {
                    assert!(
                        (found[axis] - pixel[axis]).abs() < 1e-6,
                        "{found:?} {pixel:?}"
                    );
                }
            }
        }
    }

    const POINTS: [[f64; 3]; 3] = [[0.3, -0.2, 1.5], [-1.0, 0.7, 2.0], [0.0, 0.0, 3.0]];
    const OPENCV_RADTAN: [[f64; 2]; 3] = [
        [418.401_634_567_901_2, 173.093_174_716_049_4],
        [93.620_490_625, 401.675_624_343_75],
        [320.0, 240.0],
    ];
    const OPENCV_FISHEYE: [[f64; 2]; 3] = [
        [394.047_958_355_071_96, 189.801_361_096_618_68],
        [149.179_457_827_459_34, 358.724_379_521_836_85],
        [319.5, 239.5],
    ];

    #[test]
    fn pixels_lie_where_points_were() {
        let turned = "camera_to_world = [[0,0,1,2],[-1,0,0,3],[0,-1,0,1.5]]\n";
        for text in [RADTAN, FISHEYE] {
            let camera = stored(&format!("{text}{turned}")).unwrap();
            for [x, y] in [[0.0, 0.0], [100.0, 400.0], [639.0, 479.0]] {
                let point = camera.unproject([x, y], 2.5).unwrap();
                let ([u, v], depth) = camera.project(point).unwrap();
                assert!((u - x).abs() + (v - y).abs() < 1e-5, "{u} {v}");
                assert!((depth - 2.5).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn poses_lead_from_the_world() {
        // The camera stands at (2, 3, 1.5) and looks along the world's x, whose z is up.
        let camera = stored(
            "fx = 100\nfy = 100\ncx = 50\ncy = 40\n\
             camera_to_world = [[0,0,1,2],[-1,0,0,3],[0,-1,0,1.5],[0,0,0,1]]\n",
        )
        .unwrap();
        let (pixel, depth) = camera.project([6.0, 2.0, 2.5]).unwrap();
        assert!((depth - 4.0).abs() < 1e-12);
        assert!((pixel[0] - 75.0).abs() < 1e-9 && (pixel[1] - 15.0).abs() < 1e-9);
        assert!(camera.project([1.0, 3.0, 1.5]).is_none(), "behind it");
    }

    /// r (1 + k r^2) rises up to r = 1 / sqrt(-3 k), here 1.091.
    #[test]
    fn beyond_the_fold_nothing_is_seen() {
        let lens = "model = 'radtan'\ndistortion = [-0.28, 0.0, 0.0, 0.0]";
        let camera = stored(&format!("fx = 500\nfy = 500\ncx = 0\ncy = 0\n{lens}")).unwrap();
        for (x, seen) in [(0.5, true), (1.07, true), (1.11, false), (5.0, false)] {
            assert_eq!(camera.project([x, 0.0, 1.0]).is_some(), seen, "{x}");
        }
    }

    #[test]
    fn another_size_is_the_same_view() {
        let camera = stored(&format!("{RADTAN}width = 640\nheight = 480\n")).unwrap();
        let half = camera.resized((320, 240));
        let [full, half] = [camera, half].map(|c| c.project([0.3, -0.2, 1.5]).unwrap().0);
        for axis in 0..2 {
            assert!((0.5 * (full[axis] + 0.5) - 0.5 - half[axis]).abs() < 1e-9);
        }
    }

    #[test]
    fn what_is_no_camera_is_refused() {
        for (text, what) in [
            ("fx = 1\nfy = 1\ncx = 0", "needs fx"),
            ("fx = 0\nfy = 1\ncx = 0\ncy = 0", "cannot have fx 0"),
            (
                "fx = 1\nfy = 1\ncx = 0\ncy = 0\ndistortion = [1.0]",
                "radtan or fisheye",
            ),
            (
                "fx = 1\nfy = 1\ncx = 0\ncy = 0\nwidth = 3",
                "both width and height",
            ),
            (
                "fx = 1\nfy = 1\ncx = 0\ncy = 0\nworld_to_camera = [[2,0,0,0],[0,1,0,0],[0,0,1,0]]",
                "no rotation",
            ),
            ("fx = 1\nfy = 1\ncx = 0\ncy = 0\nk1 = 3", "unknown field"),
        ] {
            let error = stored(text).unwrap_err();
            assert!(error.contains(what), "{error}");
        }
    }
}
