//! The `camera_info` of ROS, and as YAML: what `camera_calibration` writes, and what `rostopic echo` and
//! `ros2 topic echo` print.

use super::Camera;
use super::file::{Model, Stored};
use std::collections::HashMap;

/// What ROS says of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraInfo {
    /// Width and height of the image, if they are known.
    pub size: Option<(usize, usize)>,
    /// The name of the distortion.
    pub model: String,
    /// Its coefficients.
    pub distortion: Vec<f64>,
    /// K, row by row: of the whole sensor, before the image is rectified.
    pub matrix: [f64; 9],
    /// P, row by row: after that.
    pub projection: Option<[f64; 12]>,
    /// A window of the sensor: its first column and row, its width and its height; 0 stands for all.
    pub window: [usize; 4],
    /// Pixels of the sensor that are one of the image, across and down; 0 stands for 1.
    pub binning: [usize; 2],
}

impl CameraInfo {
    /// The camera of the image before it was rectified.
    ///
    /// # Errors
    /// What is wrong with it, to be said after its name.
    pub fn camera(&self) -> Result<Camera, String> {
        self.stored()?.try_into()
    }

    /// The camera of the image after it was rectified, which has no distortion.
    ///
    /// # Errors
    /// What is wrong with it, to be said after its name.
    pub fn rectified(&self) -> Result<Camera, String> {
        self.check_whole()?;
        let [fx, _, cx, _, _, fy, cy, ..] = self
            .projection
            .ok_or("has no P, which rectified images need")?;
        self.of(Model::Pinhole, &[], [fx, fy, cx, cy]).try_into()
    }

    fn stored(&self) -> Result<Stored, String> {
        self.check_whole()?;
        let [fx, _, cx, _, fy, cy, ..] = self.matrix;
        let straight = self.distortion.iter().all(|&k| k == 0.0);
        let (model, distortion) = match self.model.as_str() {
            _ if straight => (Model::Pinhole, &[][..]),
            "plumb_bob" | "rational_polynomial" | "" => (Model::Radtan, &self.distortion[..]),
            "equidistant" | "fisheye" => (Model::Fisheye, &self.distortion[..]),
            other => {
                return Err(format!(
                    "has the distortion_model `{other}`, which is not known"
                ));
            }
        };
        Ok(self.of(model, distortion, [fx, fy, cx, cy]))
    }

    fn of(&self, model: Model, distortion: &[f64], [fx, fy, cx, cy]: [f64; 4]) -> Stored {
        Stored {
            width: self.size.map(|(width, _)| width),
            height: self.size.map(|(_, height)| height),
            fx: Some(fx),
            fy: Some(fy),
            cx: Some(cx),
            cy: Some(cy),
            distortion: distortion.to_vec(),
            model,
            ..Stored::default()
        }
    }

    /// Checks that the numbers are those of the images: a window and a binning have others.
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

/// Of the image before it was rectified: `K` and `D`, which are those of the whole sensor.
pub(super) fn parse(text: &str) -> Result<Stored, String> {
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
    let named = find(&["distortion_model"]).and_then(|texts| texts.first());
    let info = CameraInfo {
        size: sides.0.zip(sides.1),
        model: named.cloned().unwrap_or_default(),
        distortion: numbers(&["distortion_coefficients.data", "D", "d"])?.unwrap_or_default(),
        matrix,
        projection: None,
        window,
        binning,
    };
    let stored = info.stored()?;
    Ok(Stored {
        width: sides.0,
        height: sides.1,
        ..stored
    })
}

/// Names (`outer.inner`) and their values, of which a list has several. That much of YAML is used.
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
