//! The `camera_info` of ROS as YAML: what `camera_calibration` writes, and what `rostopic echo` and
//! `ros2 topic echo` print.

use super::file::{Model, Stored};
use std::collections::HashMap;

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
    let (width, height) = (
        length(&["image_width", "width"])?,
        length(&["image_height", "height"])?,
    );
    // A window or a binning of the sensor; 0 stands for none.
    for (name, whole) in [
        ("roi.x_offset", None),
        ("roi.y_offset", None),
        ("roi.width", width),
        ("roi.height", height),
        ("binning_x", Some(1)),
        ("binning_y", Some(1)),
    ] {
        let value = length(&[name])?.filter(|&value| value != 0 && Some(value) != whole);
        if let Some(value) = value {
            return Err(format!(
                "has {name} {value}, so that its K is not that of the images: give fx, fy, cx, cy, \
                 width and height of these"
            ));
        }
    }
    let matrix = numbers(&["camera_matrix.data", "K", "k"])?;
    let Some(&[fx, _, cx, _, fy, cy, _, _, _]) = matrix.as_deref() else {
        return Err("has no camera_matrix or K of 9 numbers".to_owned());
    };
    let distortion = numbers(&["distortion_coefficients.data", "D", "d"])?.unwrap_or_default();
    let named = find(&["distortion_model"]).and_then(|texts| texts.first());
    let named = named.map_or("", String::as_str);
    let straight = distortion.iter().all(|&k| k == 0.0);
    let model = match named {
        _ if straight => Model::Pinhole,
        "plumb_bob" | "rational_polynomial" | "" => Model::Radtan,
        "equidistant" | "fisheye" => Model::Fisheye,
        other => {
            return Err(format!(
                "has the distortion_model `{other}`, which is not known"
            ));
        }
    };
    Ok(Stored {
        width,
        height,
        fx: Some(fx),
        fy: Some(fy),
        cx: Some(cx),
        cy: Some(cy),
        distortion: if straight { Vec::new() } else { distortion },
        model,
        ..Stored::default()
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
