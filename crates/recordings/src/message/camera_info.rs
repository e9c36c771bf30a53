//! `sensor_msgs/msg/CameraInfo`: the camera of an image.

use super::{Header, MessageType, read_message};
use crate::cdr::{CdrReader, CdrWriter, damaged};
use lsdc_core::Lens;
use lsdc_files::error::Result;
use lsdc_files::{Camera, CameraInfo};
use std::sync::Arc;

/// The camera of a message, with its header.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StampedCamera {
    pub(crate) header: Header,
    /// Camera at the origin.
    pub(crate) camera: Camera,
    /// Possible offset of the camera in its frame, along x and y in metres: the second camera of a rectified stereo pair is
    /// not at the origin.
    pub(crate) baseline: [f64; 2],
    /// The message as received.
    pub(crate) message: Arc<[u8]>,
}

/// Reads the camera of a message, for images before or after rectification.
///
/// # Errors
/// The message is damaged, or the camera is uncalibrated or has an unknown lens model.
pub(crate) fn camera_of(message: &[u8], rectified: bool) -> Result<StampedCamera> {
    read_message(MessageType::CameraInfo, message, |reader| {
        let header = Header::read(reader)?;
        let info = read_info(reader)?;
        let camera = if rectified {
            info.rectified()
        } else {
            info.camera()
        };
        Ok(StampedCamera {
            header,
            camera: camera.map_err(damaged)?,
            baseline: if rectified { info.baseline() } else { [0.0; 2] },
            message: message.into(),
        })
    })
}

fn read_info(reader: &mut CdrReader<'_>) -> Result<CameraInfo> {
    let [height, width] = [reader.u32()?, reader.u32()?].map(|v| v as usize);
    let model = reader.string()?;
    let count = reader.length(8)?;
    let distortion = (0..count).map(|_| reader.f64()).collect::<Result<_>>()?;
    let matrix = reader.array()?;
    let rotation = reader.array()?;
    let projection = reader.array()?;
    let binning = [reader.u32()?, reader.u32()?].map(|v| v as usize);
    let [x, y, rows, columns] =
        [reader.u32()?, reader.u32()?, reader.u32()?, reader.u32()?].map(|v| v as usize);
    Ok(CameraInfo {
        size: (width > 0 && height > 0).then_some((width, height)),
        model,
        distortion,
        matrix,
        rotation: Some(rotation),
        projection: Some(projection),
        window: [x, y, columns, rows],
        binning,
    })
}

/// Returns the message with another header.
///
/// # Errors
/// The message is damaged.
pub(crate) fn restamped_camera_info(message: &[u8], header: &Header) -> Result<Vec<u8>> {
    read_message(MessageType::CameraInfo, message, |reader| {
        Header::read(reader)?;
        let mut writer = CdrWriter::with_capacity(message.len() + header.frame.len());
        header.write(&mut writer);
        for _ in 0..2 {
            writer.u32(reader.u32()?);
        }
        writer.string(&reader.string()?);
        let count = reader.length(8)?;
        writer.u32(count as u32);
        // D, then K, R and P.
        for _ in 0..count + 9 + 9 + 12 {
            writer.f64(reader.f64()?);
        }
        // Binning and region of interest of the sensor.
        for _ in 0..6 {
            writer.u32(reader.u32()?);
        }
        writer.u8(reader.u8()?);
        Ok(writer.finish())
    })
}

/// Writes a camera as `sensor_msgs/msg/CameraInfo` for images of this width and height: K, D and P, without its pose.
/// `None` if the conventions of ROS have no name for its lens.
pub fn write_camera_info(
    header: &Header,
    camera: &Camera,
    (width, height): (usize, usize),
) -> Option<Vec<u8>> {
    let [fx, fy, cx, cy] = camera.intrinsics();
    let lens = camera.optics().lens();
    let model = match lens {
        Lens::Pinhole => "plumb_bob",
        Lens::Radtan { .. } => "rational_polynomial",
        Lens::Fisheye { .. } => "equidistant",
        _ => return None,
    };
    let coefficients = match lens.coefficients() {
        [] => &[0.0; 5][..],
        found => found,
    };
    let mut writer = CdrWriter::with_capacity(512);
    header.write(&mut writer);
    writer.u32(height as u32);
    writer.u32(width as u32);
    writer.string(model);
    writer.u32(coefficients.len() as u32);
    let matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
    let rotation = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let projection = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0];
    let all = coefficients.iter().chain(&matrix).chain(&rotation);
    all.chain(&projection).for_each(|&value| writer.f64(value));
    // The full sensor without binning.
    (0..6).for_each(|_| writer.u32(0));
    writer.u8(0);
    Some(writer.finish())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_that_is_written_is_read_again() {
        let header = Header {
            stamp: 1_500_000_000,
            frame: "camera".to_owned(),
        };
        for lens in [
            Lens::Pinhole,
            Lens::radial_tangential([-0.1, 0.02, 0.001, -0.0005, 0.003, 0.0, 0.0, 0.0]),
            Lens::fisheye([0.1, -0.02, 0.001, 0.0]),
        ] {
            let optics = lsdc_core::Camera::pinhole([500.0, 490.0], [320.0, 239.5]).with_lens(lens);
            let camera = Camera::new(optics, Some((640, 480)));
            let message = write_camera_info(&header, &camera, (640, 480)).unwrap();
            for rectified in [false, true] {
                let found = camera_of(&message, rectified).unwrap();
                assert_eq!(found.header, header);
                assert_eq!(found.camera.intrinsics(), camera.intrinsics());
                assert_eq!(
                    (found.camera.size(), found.baseline),
                    (camera.size(), [0.0; 2])
                );
            }
            let found = camera_of(&message, false).unwrap();
            assert_eq!(found.camera.optics(), camera.optics());
        }
    }

    #[test]
    fn another_header_changes_nothing_else() {
        let mut writer = CdrWriter::with_capacity(0);
        let header = |frame: &str| Header {
            stamp: 7,
            frame: frame.to_owned(),
        };
        header("a").write(&mut writer);
        writer.u32(480);
        writer.u32(640);
        writer.string("plumb_bob");
        writer.u32(5);
        (0..5).for_each(|i| writer.f64(f64::from(i) / 100.0));
        for row in [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]] {
            for value in row {
                writer.f64(value);
            }
        }
        (0..21).for_each(|i| writer.f64(f64::from(i)));
        for value in [0, 0, 0, 0, 480, 640] {
            writer.u32(value);
        }
        writer.u8(1);
        let message = writer.finish();
        let longer = restamped_camera_info(&message, &header("camera_optical_frame")).unwrap();
        let (before, after) = (
            camera_of(&message, false).unwrap(),
            camera_of(&longer, false).unwrap(),
        );
        assert_eq!(before.camera, after.camera);
        assert_eq!(after.header, header("camera_optical_frame"));
        assert_eq!(
            restamped_camera_info(&longer, &header("a")).unwrap(),
            message
        );
        assert!(restamped_camera_info(&message[..message.len() - 1], &header("a")).is_err());
    }
}
