//! Models as text: one line per camera or point, two lines per image.

use super::calibration::CameraRecord;
use super::records::{ImageRecord, Landmark, Parsed, RigFrames, Rigs, pose};
use crate::pose::Pose;
use std::collections::HashMap;
use std::str::FromStr;

/// Sensor type of cameras.
const CAMERA: &str = "CAMERA";

/// `CAMERA_ID MODEL WIDTH HEIGHT PARAMS...`
pub(super) fn cameras(text: &str) -> Parsed<HashMap<u32, CameraRecord>> {
    let mut cameras = HashMap::new();
    for (number, line) in lines(text) {
        let mut fields = Fields::new(number, line);
        let id = fields.next("a camera")?;
        let model: String = fields.next("a model")?;
        let size = (fields.next("a width")?, fields.next("a height")?);
        let mut parameters = Vec::new();
        while !fields.is_over() {
            parameters.push(fields.next("a parameter")?);
        }
        cameras.insert(id, CameraRecord::new(&model, size, &parameters)?);
    }
    Ok(cameras)
}

/// `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`, then repeated `X Y POINT3D_ID`, which may be an empty line.
pub(super) fn images(text: &str) -> Parsed<Vec<ImageRecord>> {
    let mut images = Vec::new();
    let mut lines = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.starts_with('#'));
    while let Some((number, line)) = lines.next() {
        if line.trim().is_empty() {
            continue;
        }
        let mut fields = Fields::new(number, line);
        let id = fields.next("an image")?;
        let pose = fields.pose()?;
        let camera = fields.next("a camera")?;
        let name = fields.rest();
        let mut keypoints = Vec::new();
        if let Some((number, line)) = lines.next() {
            let mut fields = Fields::new(number, line);
            while !fields.is_over() {
                let position = [fields.next("a column")?, fields.next("a row")?];
                // -1 if the keypoint has no point.
                if let Ok(point) = u64::try_from(fields.next::<i64>("a point")?) {
                    keypoints.push((position, point));
                }
            }
        }
        images.push(ImageRecord {
            id,
            pose,
            camera,
            name,
            keypoints,
        });
    }
    Ok(images)
}

/// `RIG_ID NUM_SENSORS REF_SENSOR_TYPE REF_SENSOR_ID`, then repeated `SENSOR_TYPE SENSOR_ID HAS_POSE`, each with a pose if
/// it has one.
pub(super) fn rigs(text: &str) -> Parsed<Rigs> {
    let mut rigs = Rigs::default();
    for (number, line) in lines(text) {
        let mut fields = Fields::new(number, line);
        let rig = fields.next("a rig")?;
        let sensors: u32 = fields.next("a number of sensors")?;
        for number in 0..sensors {
            let kind = fields.take();
            let sensor = fields.next("a sensor")?;
            // The first sensor is the origin of the rig.
            let pose = match number {
                0 => Some(Pose::IDENTITY),
                _ if fields.next::<u8>("whether there is a pose")? == 0 => None,
                _ => Some(fields.pose()?),
            };
            if kind == CAMERA {
                rigs.insert((rig, sensor), pose);
            }
        }
    }
    Ok(rigs)
}

/// `FRAME_ID RIG_ID QW QX QY QZ TX TY TZ NUM_DATA_IDS`, then repeated `SENSOR_TYPE SENSOR_ID DATA_ID`.
pub(super) fn frames(text: &str) -> Parsed<RigFrames> {
    let mut frames = RigFrames::default();
    for (number, line) in lines(text) {
        let mut fields = Fields::new(number, line);
        fields.skip();
        let rig = fields.next("a rig")?;
        let pose = fields.pose()?;
        let data: u32 = fields.next("a number of images")?;
        for _ in 0..data {
            let kind = fields.take();
            let (sensor, image) = (fields.next("a sensor")?, fields.next("an image")?);
            if kind == CAMERA {
                frames.insert(image, ((rig, sensor), pose));
            }
        }
    }
    Ok(frames)
}

/// `POINT3D_ID X Y Z R G B ERROR`, then repeated `IMAGE_ID POINT2D_IDX`.
pub(super) fn landmarks(text: &str) -> Parsed<HashMap<u64, Landmark>> {
    let mut landmarks = HashMap::new();
    for (number, line) in lines(text) {
        let mut fields = Fields::new(number, line);
        let id = fields.next("a point")?;
        let mut position = [0.0; 3];
        for value in &mut position {
            *value = fields.next("a place")?;
        }
        (0..3).for_each(|_| fields.skip());
        let error = fields.next("an error")?;
        let mut images = Vec::new();
        while !fields.is_over() {
            images.push(fields.next("an image")?);
            // The index of the keypoint.
            fields.skip();
        }
        landmarks.insert(
            id,
            Landmark {
                position,
                error,
                images,
            },
        );
    }
    Ok(landmarks)
}

/// Returns the lines that are not comments, with their indices.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = text.lines().enumerate();
    lines.filter(|(_, line)| !line.starts_with('#') && !line.trim().is_empty())
}

/// The fields of a line.
struct Fields<'a> {
    line: usize,
    rest: &'a str,
}

impl<'a> Fields<'a> {
    /// Creates the fields of the line with this index, from 0.
    fn new(number: usize, line: &'a str) -> Self {
        Self {
            line: number + 1,
            rest: line.trim(),
        }
    }

    fn take(&mut self) -> &'a str {
        let (field, rest) = self
            .rest
            .split_once(char::is_whitespace)
            .unwrap_or((self.rest, ""));
        self.rest = rest.trim_start();
        field
    }

    fn next<T: FromStr>(&mut self, what: &str) -> Parsed<T> {
        let field = self.take();
        field
            .parse()
            .map_err(|_| format!("line {}: `{field}` in the place of {what}", self.line))
    }

    /// Reads a quaternion w, x, y, z and a translation.
    fn pose(&mut self) -> Parsed<Pose> {
        let mut numbers = [0.0; 7];
        for value in &mut numbers {
            *value = self.next("a pose")?;
        }
        pose(numbers).map_err(|what| format!("line {}: {what}", self.line))
    }

    fn skip(&mut self) {
        self.take();
    }

    fn is_over(&self) -> bool {
        self.rest.is_empty()
    }

    /// Returns the rest of the line, because names may contain spaces.
    fn rest(self) -> String {
        self.rest.to_owned()
    }
}
