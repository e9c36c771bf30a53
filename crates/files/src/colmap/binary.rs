//! Models in binary form, little-endian, as written by COLMAP's `reconstruction_io`.

use super::calibration::{CameraRecord, model};
use super::records::{ImageRecord, Landmark, Parsed, RigFrames, Rigs, pose};
use crate::pose::Pose;
use std::collections::HashMap;

/// Identifier of a missing point.
const NONE: u64 = u64::MAX;
/// Sensor type of cameras.
const CAMERA: u32 = 0;

pub(super) fn cameras(bytes: &[u8]) -> Parsed<HashMap<u32, CameraRecord>> {
    let mut bytes = Bytes(bytes);
    // Smallest size of a record: identifier, model and size.
    let count = bytes.count(24)?;
    let mut cameras = HashMap::with_capacity(count);
    for _ in 0..count {
        let (id, number) = (bytes.u32()?, bytes.u32()?);
        let size = (bytes.u64()?, bytes.u64()?);
        let (name, count) =
            model(number).ok_or_else(|| format!("camera {id} is of an unknown model, {number}"))?;
        let mut parameters = vec![0.0; count];
        for value in &mut parameters {
            *value = bytes.f64()?;
        }
        cameras.insert(id, CameraRecord::new(name, size, &parameters)?);
    }
    Ok(cameras)
}

pub(super) fn images(bytes: &[u8]) -> Parsed<Vec<ImageRecord>> {
    let mut bytes = Bytes(bytes);
    let count = bytes.count(73)?;
    let mut images = Vec::with_capacity(count);
    for _ in 0..count {
        let id = bytes.u32()?.into();
        let pose = bytes.pose()?;
        let camera = bytes.u32()?;
        let name = bytes.name()?;
        let mut keypoints = Vec::new();
        for _ in 0..bytes.count(24)? {
            let (position, point) = ([bytes.f64()?, bytes.f64()?], bytes.u64()?);
            if point != NONE {
                keypoints.push((position, point));
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

/// Reads the format of `ReadRigsBinary` of COLMAP 3.12 and later.
pub(super) fn rigs(bytes: &[u8]) -> Parsed<Rigs> {
    let mut bytes = Bytes(bytes);
    let count = bytes.count(8)?;
    let mut rigs = Rigs::default();
    for _ in 0..count {
        let (rig, sensors) = (bytes.u32()?, bytes.u32()?);
        for number in 0..sensors {
            let (kind, sensor) = (bytes.u32()?, bytes.u32()?);
            // The first sensor is the origin of the rig.
            let pose = match number {
                0 => Some(Pose::IDENTITY),
                _ if bytes.take::<1>()? == [0] => None,
                _ => Some(bytes.pose()?),
            };
            if kind == CAMERA {
                rigs.insert((rig, sensor), pose);
            }
        }
    }
    Ok(rigs)
}

/// Reads the format of `ReadFramesBinary` of COLMAP 3.12 and later.
pub(super) fn frames(bytes: &[u8]) -> Parsed<RigFrames> {
    let mut bytes = Bytes(bytes);
    let count = bytes.count(68)?;
    let mut frames = RigFrames::default();
    for _ in 0..count {
        bytes.skip(4)?;
        let (rig, pose, data) = (bytes.u32()?, bytes.pose()?, bytes.u32()?);
        for _ in 0..data {
            let (kind, sensor, image) = (bytes.u32()?, bytes.u32()?, bytes.u64()?);
            if kind == CAMERA {
                frames.insert(image, ((rig, sensor), pose));
            }
        }
    }
    Ok(frames)
}

pub(super) fn landmarks(bytes: &[u8]) -> Parsed<HashMap<u64, Landmark>> {
    let mut bytes = Bytes(bytes);
    let count = bytes.count(51)?;
    let mut landmarks = HashMap::with_capacity(count);
    for _ in 0..count {
        let id = bytes.u64()?;
        let position = [bytes.f64()?, bytes.f64()?, bytes.f64()?];
        // The colour of the point.
        bytes.skip(3)?;
        let error = bytes.f64()?;
        let count = bytes.count(8)?;
        let mut images = Vec::with_capacity(count);
        for _ in 0..count {
            images.push(bytes.u32()?.into());
            // The index of the keypoint.
            bytes.skip(4)?;
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

/// The remaining bytes of a file.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> Parsed<[u8; N]> {
        let (some, rest) = self.0.split_first_chunk::<N>().ok_or("is cut off")?;
        self.0 = rest;
        Ok(*some)
    }

    fn u32(&mut self) -> Parsed<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Parsed<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Parsed<f64> {
        self.take().map(f64::from_le_bytes)
    }

    /// Reads a quaternion w, x, y, z and a translation.
    fn pose(&mut self) -> Parsed<Pose> {
        let mut numbers = [0.0; 7];
        for value in &mut numbers {
            *value = self.f64()?;
        }
        pose(numbers)
    }

    /// Reads a number of records, and checks that this many records of at least `size` bytes can follow.
    fn count(&mut self, size: usize) -> Parsed<usize> {
        let count = self.u64()?;
        let left = self.0.len() / size;
        match usize::try_from(count) {
            Ok(count) if count <= left => Ok(count),
            _ => Err(format!("promises {count} entries where {left} have room")),
        }
    }

    fn skip(&mut self, count: usize) -> Parsed<()> {
        self.0 = self.0.get(count..).ok_or("is cut off")?;
        Ok(())
    }

    /// Reads a zero-terminated name.
    fn name(&mut self) -> Parsed<String> {
        let end = self.0.iter().position(|&b| b == 0).ok_or("is cut off")?;
        let name = String::from_utf8_lossy(&self.0[..end]).into_owned();
        self.skip(end + 1)?;
        Ok(name)
    }
}
