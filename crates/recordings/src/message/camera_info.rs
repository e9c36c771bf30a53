//! `sensor_msgs/msg/CameraInfo`: the camera of an image.

use super::{Header, MessageType, read_message};
use crate::cdr::{CdrReader, damaged};
use lsdc_files::error::Result;
use lsdc_files::{Camera, CameraInfo};

/// The camera of a message, with its header.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct StampedCamera {
    pub(crate) header: Header,
    /// At the origin.
    pub(crate) camera: Camera,
    /// Where the camera may be in its frame, along x and y in metres: the second of a stereo pair, whose images are
    /// rectified, is not at the origin.
    pub(crate) baseline: [f64; 2],
}

/// The camera that a message describes: of the image before it was rectified, or after.
///
/// # Errors
/// A damaged message, and a camera that is not calibrated or of a lens that is not known.
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
