//! `sensor_msgs/msg/PointCloud2`: points with any fields.

use super::{Header, MessageType, read_message};
use crate::cdr::{CdrReader, CdrWriter, damaged};
use lsdc_files::ColoredPoint;
use lsdc_files::error::Result;

/// The points of a message, read one by one.
pub(crate) struct PointCloud<'a> {
    data: &'a [u8],
    /// Bytes from one point to the next, and from one row to the next.
    steps: [usize; 2],
    size: [usize; 2],
    axes: [Field; 3],
    /// Name and location of the field with the time of each point.
    time: Option<(String, Field)>,
    big_endian: bool,
}

/// A number in the bytes of a point.
#[derive(Clone, Copy, Debug)]
struct Field {
    offset: usize,
    kind: u8,
}

/// Types of fields.
const FLOAT32: u8 = 7;
const FLOAT64: u8 = 8;

/// Names that drivers use for the time of a point: Ouster's `t` and Nebula's `time_stamp` count nanoseconds from the stamp
/// of the message, Velodyne's `time` counts seconds; `timestamp` is seconds (Hesai, `RoboSense`) or nanoseconds (Livox)
/// since 1970.
const TIMES: [&str; 6] = [
    "t",
    "time",
    "timestamp",
    "time_stamp",
    "offset_time",
    "time_offset",
];

impl<'a> PointCloud<'a> {
    /// Reads the layout of a message.
    ///
    /// # Errors
    /// The message is damaged, or lacks fields x, y and z of 32 or 64-bit floating-point numbers.
    pub(crate) fn of(message: &'a [u8]) -> Result<Self> {
        read_message(MessageType::PointCloud2, message, Self::read)
    }

    fn read(reader: &mut CdrReader<'a>) -> Result<Self> {
        /// Size of a field without a name.
        const LEAST: usize = 16;
        Header::read(reader)?;
        let [height, width] = [reader.u32()?, reader.u32()?].map(|v| v as usize);
        let count = reader.length(LEAST)?;
        let mut axes = [None; 3];
        let mut time = None;
        for _ in 0..count {
            let name = reader.string()?;
            let (offset, kind, count) = (reader.u32()? as usize, reader.u8()?, reader.u32()?);
            let field = Field { offset, kind };
            if time.is_none() && count == 1 && TIMES.contains(&name.as_str()) {
                time = Some((name, field));
                continue;
            }
            let Some(axis) = ["x", "y", "z"].iter().position(|axis| *axis == name) else {
                continue;
            };
            if !matches!(kind, FLOAT32 | FLOAT64) {
                return Err(damaged(format!(
                    "has a field {name} that is no floating-point number"
                )));
            }
            axes[axis] = Some(field);
        }
        let [Some(x), Some(y), Some(z)] = axes else {
            return Err(damaged("has no fields x, y and z"));
        };
        let big_endian = reader.u8()? != 0;
        let (step, row) = (reader.u32()? as usize, reader.u32()? as usize);
        let points = Self {
            data: reader.bytes()?,
            steps: [step, row],
            size: [width, height],
            axes: [x, y, z],
            time: time.filter(|(_, field)| field.bytes().is_some() && field.end() <= step),
            big_endian,
        };
        points.check()?;
        Ok(points)
    }

    /// Checks that all points are inside the data.
    fn check(&self) -> Result<()> {
        let ends = self.axes.iter().map(|axis| axis.end());
        let [step, row] = self.steps;
        if ends.max().is_some_and(|end| end > step) {
            return Err(damaged(format!(
                "has fields beyond the {step} bytes of a point"
            )));
        }
        let [width, height] = self.size;
        let long = width
            .checked_mul(step)
            .filter(|long| height <= 1 || *long <= row);
        let all =
            long.and_then(|long| row.checked_mul(height.saturating_sub(1))?.checked_add(long));
        match all {
            _ if width == 0 || height == 0 => Ok(()),
            Some(all) if all <= self.data.len() => Ok(()),
            _ => Err(damaged(format!(
                "has {} bytes, too few for {width}x{height} points of {step}",
                self.data.len()
            ))),
        }
    }

    /// Offset of each point in the data, in the order of the message.
    fn starts(&self) -> impl Iterator<Item = usize> {
        let [width, height] = self.size;
        let [step, row] = self.steps;
        (0..height).flat_map(move |j| (0..width).map(move |i| j * row + i * step))
    }

    /// x, y, z of each point, possibly not finite, in the order of the message.
    pub(crate) fn iter(&self) -> impl Iterator<Item = [f64; 3]> {
        self.starts().map(|start| self.position(start))
    }

    /// Returns the name and type of the field with the time of each point, if there is one.
    pub(crate) fn time_field(&self) -> Option<(&str, u8)> {
        let (name, field) = self.time.as_ref()?;
        Some((name, field.kind))
    }

    /// Whether times are integers.
    pub(crate) fn has_whole_times(&self) -> bool {
        self.time_field()
            .is_some_and(|(_, kind)| !matches!(kind, FLOAT32 | FLOAT64))
    }

    /// [`Self::iter`] with the stored time of each point; `None` if points have no times.
    pub(crate) fn timed(&self) -> Option<impl Iterator<Item = ([f64; 3], f64)>> {
        let (_, field) = self.time.as_ref()?;
        let point = |start| (self.position(start), self.number(start, *field));
        Some(self.starts().map(point))
    }

    /// Returns the position of the point at an offset. Zeros are NaN, because many scanners write them for pulses without a
    /// return.
    fn position(&self, start: usize) -> [f64; 3] {
        let position = self.axes.map(|axis| self.number(start, axis));
        if position == [0.0; 3] {
            [f64::NAN; 3]
        } else {
            position
        }
    }

    /// Reads a number of the point at an offset.
    fn number(&self, start: usize, field: Field) -> f64 {
        macro_rules! number {
            ($type:ty) => {{
                let bytes = self.data.get(start + field.offset..);
                let bytes = bytes.and_then(|bytes| bytes.first_chunk());
                bytes.map_or(f64::NAN, |bytes| {
                    if self.big_endian {
                        <$type>::from_be_bytes(*bytes).into()
                    } else {
                        <$type>::from_le_bytes(*bytes).into()
                    }
                })
            }};
        }
        match field.kind {
            1 => number!(i8),
            2 => number!(u8),
            3 => number!(i16),
            4 => number!(u16),
            5 => number!(i32),
            6 => number!(u32),
            FLOAT32 => number!(f32),
            FLOAT64 => number!(f64),
            _ => f64::NAN,
        }
    }
}

impl Field {
    /// Size of the field in bytes, if its type is known.
    fn bytes(self) -> Option<usize> {
        match self.kind {
            1 | 2 => Some(1),
            3 | 4 => Some(2),
            5 | 6 | FLOAT32 => Some(4),
            FLOAT64 => Some(8),
            _ => None,
        }
    }

    /// Offset of its end in the bytes of a point.
    fn end(self) -> usize {
        self.offset.saturating_add(self.bytes().unwrap_or(0))
    }
}

/// Writes a message of coloured points: x, y, z and the packed `rgb` that RViz shows.
pub fn write_cloud(header: &Header, points: &[ColoredPoint]) -> Vec<u8> {
    let rows = points.iter().map(|point| {
        let ([x, y, z], [r, g, b]) = (point.position, point.color);
        [
            x as f32,
            y as f32,
            z as f32,
            f32::from_le_bytes([b, g, r, 0]),
        ]
    });
    write_points(header, ["x", "y", "z", "rgb"], rows)
}

/// Writes a message of points with these fields of 32-bit floating-point numbers: a row for each point.
pub fn write_points<const FIELDS: usize>(
    header: &Header,
    fields: [&str; FIELDS],
    points: impl ExactSizeIterator<Item = [f32; FIELDS]>,
) -> Vec<u8> {
    let (count, step) = (points.len(), 4 * FIELDS);
    let mut writer = CdrWriter::with_capacity(256 + count * step);
    header.write(&mut writer);
    writer.u32(1);
    writer.u32(count as u32);
    writer.u32(FIELDS as u32);
    for (number, name) in fields.into_iter().enumerate() {
        writer.string(name);
        writer.u32(4 * number as u32);
        writer.u8(FLOAT32);
        writer.u32(1);
    }
    writer.u8(0);
    writer.u32(step as u32);
    writer.u32((step * count) as u32);
    let mut data = Vec::with_capacity(step * count);
    for point in points {
        data.extend(point.into_iter().flat_map(f32::to_le_bytes));
    }
    writer.bytes(data.into_iter());
    writer.u8(1);
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let header = Header {
            stamp: -1_500_000_000,
            frame: "camera".to_owned(),
        };
        let point = |z: f64| ColoredPoint {
            position: [0.5, -1.0, z],
            color: [1, 2, 3],
            sigma: None,
        };
        let message = write_cloud(&header, &[point(2.0), point(3.0)]);
        let points = PointCloud::of(&message).unwrap();
        assert_eq!(Header::of(&message).unwrap(), header);
        let positions: Vec<_> = points.iter().collect();
        assert_eq!(positions, [[0.5, -1.0, 2.0], [0.5, -1.0, 3.0]]);
    }

    /// Big-endian doubles, rows with padding, x after z.
    #[test]
    fn any_layout_is_read() {
        let mut writer = CdrWriter::with_capacity(0);
        Header::default().write(&mut writer);
        writer.u32(2);
        writer.u32(1);
        writer.u32(4);
        for (name, offset, kind) in [("z", 0, 8), ("y", 8, 7), ("ring", 12, 4), ("x", 14, 8)] {
            writer.string(name);
            writer.u32(offset);
            writer.u8(kind);
            writer.u32(1);
        }
        writer.u8(1);
        writer.u32(22);
        writer.u32(30);
        let mut data = Vec::new();
        for z in [1.0_f64, 2.0] {
            data.extend(z.to_be_bytes());
            data.extend(0.25_f32.to_be_bytes());
            data.extend([0, 7]);
            data.extend((-z).to_be_bytes());
            data.extend([0; 8]);
        }
        data.truncate(52);
        writer.bytes(data.clone().into_iter());
        let message = writer.finish();
        let points = PointCloud::of(&message).unwrap();
        let positions: Vec<_> = points.iter().collect();
        assert_eq!(positions, [[-1.0, 0.25, 1.0], [-2.0, 0.25, 2.0]]);
        assert!(PointCloud::of(&message[..message.len() - 1]).is_err());
    }
}
