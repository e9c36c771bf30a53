//! The `camera_info` of ROS, and its YAML forms: the output of `camera_calibration`, `rostopic echo` and `ros2 topic echo`.

use super::Camera;
use super::stored::{CameraFile, LensModel, intrinsics};
use std::collections::HashMap;

/// Camera parameters of ROS.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo {
    /// Width and height of the image, if known.
    pub size: Option<(usize, usize)>,
    /// Name of the distortion model.
    pub model: String,
    /// Distortion coefficients.
    pub distortion: Vec<f64>,
    /// K, row by row: intrinsics of the full sensor, before rectification.
    pub matrix: [f64; 9],
    /// R, row by row: rotation from the axes of the camera to those of the rectified image.
    pub rotation: Option<[f64; 9]>,
    /// P, row by row: projection after rectification.
    pub projection: Option<[f64; 12]>,
    /// Region of interest on the sensor: first column, first row, width and height; 0 means the full sensor.
    pub window: [usize; 4],
    /// Binning: sensor pixels per image pixel, across and down; 0 means 1.
    pub binning: [usize; 2],
}

impl CameraInfo {
    /// Returns the camera of the unrectified image: K and D.
    ///
    /// # Errors
    /// The camera is invalid; the text follows its name.
    pub fn camera(&self) -> Result<Camera, String> {
        self.stored()?.try_into()
    }

    /// Returns the camera of the rectified image, which has no distortion: the first three columns of P. For the fourth see
    /// [`Self::baseline`].
    ///
    /// # Errors
    /// The camera is invalid; the text follows its name.
    pub fn rectified(&self) -> Result<Camera, String> {
        self.check_whole()?;
        let projection = self.projection.filter(|p| p.iter().any(|&v| v != 0.0));
        let rows = projection
            .map(columns)
            .ok_or("has no P, which rectified images need")?;
        let numbers = intrinsics(rows).map_err(|what| format!("has a P {what}"))?;
        let mut stored = self.of(LensModel::Pinhole, &[], numbers);
        stored.assumed = self.unused("P", true);
        stored.try_into()
    }

    /// Returns the position of the optical centre in the camera's frame by the fourth column of P, in metres along x and y.
    /// It is not 0 for the second camera of a stereo pair, because both use the frame of the first.
    pub fn baseline(&self) -> [f64; 2] {
        let Some([fx, _, _, tx, _, fy, _, ty, ..]) = self.projection else {
            return [0.0; 2];
        };
        let part = |shift: f64, focal: f64| if shift == 0.0 { 0.0 } else { -shift / focal };
        [part(tx, fx), part(ty, fy)]
    }

    fn stored(&self) -> Result<CameraFile, String> {
        self.check_whole()?;
        let [a, b, c, d, e, f, g, h, i] = self.matrix;
        let rows = [[a, b, c], [d, e, f], [g, h, i]];
        let numbers = intrinsics(rows).map_err(|what| format!("has a K {what}"))?;
        let straight = !self.is_bent();
        let mut assumed = self.unused("K and D", false);
        let (model, distortion) = match self.model.as_str() {
            "equidistant" | "fisheye" => (LensModel::Fisheye, &self.distortion[..]),
            "" | "plumb_bob" | "rational_polynomial" | "radtan" if straight => {
                (LensModel::Pinhole, &[][..])
            }
            "plumb_bob" | "rational_polynomial" | "radtan" => {
                (LensModel::Radtan, &self.distortion[..])
            }
            "" => {
                assumed.push(format!(
                    "the camera names no distortion model: its {} coefficients are taken for plumb_bob (k1, k2, p1, p2, ...), \
                     not for a fisheye lens; add `distortion_model`",
                    self.distortion.len()
                ));
                (LensModel::Radtan, &self.distortion[..])
            }
            other if straight => {
                assumed.push(format!(
                    "the distortion model `{other}` is not known; as all coefficients are 0, the lens is taken for one without \
                     distortion"
                ));
                (LensModel::Pinhole, &[][..])
            }
            other => {
                return Err(format!(
                    "has the distortion_model `{other}`, which is not known"
                ));
            }
        };
        let stored = self.of(model, distortion, numbers);
        Ok(CameraFile { assumed, ..stored })
    }

    fn is_bent(&self) -> bool {
        self.distortion.iter().any(|&k| k != 0.0)
    }

    /// Returns remarks about the parameters that are not used, if they contradict those that `used` names. `rectified` is
    /// whether the image is taken for rectified.
    fn unused(&self, used: &str, rectified: bool) -> Vec<String> {
        /// Tolerance in pixels; files contain rounded numbers.
        const NEAR: f64 = 0.01;
        let Some(projection) = self.projection.filter(|p| p[0] != 0.0) else {
            return Vec::new();
        };
        let near = |a: &f64, b: &f64| (a - b).abs() <= NEAR;
        let mut differ = Vec::new();
        let matrix = columns(projection).concat();
        if !matrix.iter().zip(&self.matrix).all(|(a, b)| near(a, b)) {
            differ.push(format!(
                "P (fx {}, cx {}) differs from K (fx {}, cx {})",
                projection[0], projection[2], self.matrix[0], self.matrix[2]
            ));
        }
        let angle = self.rotation.map_or(0.0, angle);
        if angle > 1e-4 {
            differ.push(format!(
                "R is a rotation of {:.2} degrees",
                angle.to_degrees()
            ));
        }
        let [x, y] = self.baseline();
        if !rectified && (x != 0.0 || y != 0.0) {
            differ.push(format!(
                "the fourth column of P is a stereo baseline of {:.4} m",
                x.hypot(y)
            ));
        }
        if rectified && self.is_bent() {
            differ.push("D is not 0".to_owned());
        }
        let (is, not) = if rectified {
            ("rectified", "R and D are not applied")
        } else {
            ("unrectified", "R and P are not applied")
        };
        if differ.is_empty() {
            return Vec::new();
        }
        vec![format!(
            "the image is taken for {is}: {used} of the camera are used, {not}, though {}",
            differ.join(", and ")
        )]
    }

    fn of(&self, model: LensModel, distortion: &[f64], intrinsics: [f64; 4]) -> CameraFile {
        CameraFile {
            width: self.size.map(|(width, _)| width),
            height: self.size.map(|(_, height)| height),
            distortion: distortion.to_vec(),
            model,
            ..CameraFile::pinhole(intrinsics)
        }
    }

    /// Checks that the parameters apply to the images: they differ for a region of interest or with binning.
    fn check_whole(&self) -> Result<(), String> {
        let [x, y, columns, rows] = self.window;
        let [across, down] = self.binning;
        let (width, height) = (self.size.map(|size| size.0), self.size.map(|size| size.1));
        for (name, value, whole) in [
            ("roi.x_offset", x, None),
            ("roi.y_offset", y, None),
            ("roi.width", columns, width),
            ("roi.height", rows, height),
            ("binning_x", across, Some(1)),
            ("binning_y", down, Some(1)),
        ] {
            if value != 0 && Some(value) != whole {
                return Err(format!(
                    "has {name} {value}, so that its K is not that of the images: give fx, fy, cx, cy, \
                     width and height of these"
                ));
            }
        }
        Ok(())
    }
}

/// Returns the first three columns of P, row by row.
fn columns(projection: [f64; 12]) -> [[f64; 3]; 3] {
    let [a, b, c, _, d, e, f, _, g, h, i, _] = projection;
    [[a, b, c], [d, e, f], [g, h, i]]
}

/// Returns the angle of a rotation in radians; 0 for zeros, which mean no rotation.
fn angle(rotation: [f64; 9]) -> f64 {
    let [a, b, c, d, e, f, g, h, i] = rotation;
    // Twice the sine and the cosine, which is also exact for small angles.
    let sine = (h - f).hypot(c - g).hypot(d - b);
    let cosine = a + e + i - 1.0;
    if rotation.iter().all(|&v| v == 0.0) {
        return 0.0;
    }
    sine.atan2(cosine)
}

/// Reads the camera of the unrectified image: `K` and `D`, which refer to the full sensor.
pub(super) fn parse(text: &str) -> Result<CameraFile, String> {
    let values = flatten(text);
    let find = |names: &[&str]| names.iter().find_map(|name| values.get(*name));
    let numbers = |names: &[&str]| -> Result<Option<Vec<f64>>, String> {
        let number = |text: &String| {
            text.parse()
                .map_err(|_| format!("`{text}` is not a number"))
        };
        let found = find(names).map(|texts| texts.iter().map(number).collect());
        found.transpose()
    };
    let length = |names: &[&str]| -> Result<Option<usize>, String> {
        Ok(numbers(names)?.and_then(|n| n.first().map(|&n| n as usize)))
    };
    let count = |name: &str| Ok::<_, String>(length(&[name])?.unwrap_or(0));
    let window = [
        count("roi.x_offset")?,
        count("roi.y_offset")?,
        count("roi.width")?,
        count("roi.height")?,
    ];
    let binning = [count("binning_x")?, count("binning_y")?];
    let sides = (
        length(&["image_width", "width"])?,
        length(&["image_height", "height"])?,
    );
    let matrix = numbers(&["camera_matrix.data", "K", "k"])?;
    let Some(&matrix) = matrix
        .as_deref()
        .and_then(|m| <&[f64; 9]>::try_from(m).ok())
    else {
        return Err("has no camera_matrix or K of 9 numbers".to_owned());
    };
    let one = |name: &str| find(&[name]).and_then(|texts| texts.first());
    // The format of `cv2.FileStorage`, used by OpenCV's calibration program.
    let fisheye = one("fisheye_model").map(|flag| match flag.as_str() {
        "0" => Ok("plumb_bob".to_owned()),
        "1" => Ok("fisheye".to_owned()),
        other => Err(format!("has the fisheye_model `{other}`, expected 0 or 1")),
    });
    let model = match (one("distortion_model"), fisheye.transpose()?) {
        (Some(named), _) => named.clone(),
        (None, Some(flagged)) => flagged,
        (None, None) => String::new(),
    };
    let info = CameraInfo {
        size: sides.0.zip(sides.1),
        model,
        distortion: numbers(&["distortion_coefficients.data", "D", "d"])?.unwrap_or_default(),
        matrix,
        rotation: numbers(&["rectification_matrix.data", "R", "r"])?
            .and_then(|r| r.try_into().ok()),
        projection: numbers(&["projection_matrix.data", "P", "p"])?.and_then(|p| p.try_into().ok()),
        window,
        binning,
    };
    let mut stored = info.stored()?;
    if stored.assumed.is_empty() && info.is_bent() && info.projection.is_some() {
        let remark = "the image is taken for unrectified: K and D of the camera are used, R and P are not applied";
        stored.assumed.push(remark.to_owned());
    }
    Ok(CameraFile {
        width: sides.0,
        height: sides.1,
        ..stored
    })
}

/// Returns names (`outer.inner`) and their values, several for a list. Only this subset of YAML is used.
fn flatten(text: &str) -> HashMap<String, Vec<String>> {
    let mut values: HashMap<String, Vec<String>> = HashMap::new();
    let (mut outer, mut name) = (String::new(), String::new());
    for line in text.lines() {
        let line = line.split('#').next().unwrap_or_default();
        let inner = line.starts_with([' ', '\t']);
        let mut rest = line.trim();
        if let Some((key, value)) = rest.split_once(':') {
            if !inner {
                key.clone_into(&mut outer);
            }
            name = if inner {
                format!("{outer}.{key}")
            } else {
                outer.clone()
            };
            rest = value;
        }
        let rest = rest.trim().trim_start_matches("- ");
        let words = rest.split([',', '[', ']', '"', '\'', ' ']);
        let words = words.filter(|word| !word.is_empty() && *word != "---");
        values
            .entry(name.clone())
            .or_default()
            .extend(words.map(str::to_owned));
    }
    values
}
