//! `sensor_msgs/msg/Image` and `CompressedImage`: colours and depths.

use super::{Header, Kind, bayer, rvl, unusable, yuv};
use crate::cdr::{Reader, Writer, damaged};
use image::{DynamicImage, ImageFormat, ImageReader, RgbImage};
use lsdc_core::DepthMap;
use lsdc_files::error::{Error, Result};
use std::io::Cursor;

/// An image of depths.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DepthImage {
    /// In metres; 0 where there is none.
    pub(crate) depth: DepthMap,
    /// Whether it is stored as whole numbers.
    pub(crate) whole: bool,
}

/// Numbers as they are stored, and whether they are whole.
type Numbers = (Vec<f32>, bool);

/// An image before its pixels are looked at.
pub(super) struct Raw<'a> {
    pub(super) size: (usize, usize),
    pub(super) encoding: String,
    pub(super) big_endian: bool,
    /// Bytes from a row to the next.
    pub(super) step: usize,
    pub(super) data: &'a [u8],
}

impl<'a> Raw<'a> {
    fn read(reader: &mut Reader<'a>) -> Result<Self> {
        let [height, width] = [reader.u32()?, reader.u32()?].map(|v| v as usize);
        let encoding = reader.string()?;
        let (big_endian, step) = (reader.u8()? != 0, reader.u32()? as usize);
        Ok(Self {
            size: (width, height),
            encoding,
            big_endian,
            step,
            data: reader.bytes()?,
        })
    }

    /// The bytes of each row, of pixels of so many bytes.
    fn rows(&self, pixel: usize) -> Result<impl Iterator<Item = &'a [u8]>> {
        self.rows_of(self.size.0, pixel)
    }

    /// The bytes of each row, which has so many groups of so many bytes.
    pub(super) fn rows_of(
        &self,
        groups: usize,
        bytes: usize,
    ) -> Result<impl Iterator<Item = &'a [u8]>> {
        let (data, step, height) = (self.data, self.step, self.size.1);
        let long = groups.checked_mul(bytes).filter(|long| *long <= step);
        let all = long.and_then(|long| step.checked_mul(height.checked_sub(1)?)?.checked_add(long));
        match (long, all) {
            (Some(long), Some(all)) if long > 0 && all <= data.len() => {
                Ok((0..height).map(move |row| &data[row * step..row * step + long]))
            }
            _ => Err(self.too_short()),
        }
    }

    /// That there are fewer bytes than the pixels need.
    pub(super) fn too_short(&self) -> Error {
        let ((width, height), step) = (self.size, self.step);
        damaged(format!(
            "of {width}x{height} pixels ({}) and {step} bytes a row has {} bytes",
            self.encoding,
            self.data.len()
        ))
    }

    fn colours(&self) -> Result<RgbImage> {
        let (width, height) = self.size;
        let encoding = self.encoding.as_str();
        if let Some(pattern) = bayer::pattern(encoding) {
            return Ok(bayer::colours(
                &self.rows(1)?.collect::<Vec<_>>().concat(),
                self.size,
                pattern,
            ));
        }
        if let Some(layout) = yuv::layout(encoding) {
            return yuv::colours(self, layout);
        }
        // Where red, green and blue are in the bytes of a pixel.
        let (pixel, [r, g, b]) = match encoding {
            "rgb8" => (3, [0, 1, 2]),
            "bgr8" | "8UC3" => (3, [2, 1, 0]),
            "rgba8" => (4, [0, 1, 2]),
            "bgra8" | "8UC4" => (4, [2, 1, 0]),
            "mono8" | "8UC1" => (1, [0, 0, 0]),
            _ => {
                return Err(damaged(format!("is encoded as `{encoding}`, which is not read")).hint(
                    "colours are read as rgb8, bgr8, rgba8, bgra8, mono8, bayer_*8, uyvy (yuv422), yuyv (yuv422_yuy2), \
                     nv12, nv21 and nv24, or as JPEG or PNG",
                ));
            }
        };
        let rows = self.rows(pixel)?;
        let mut values = Vec::with_capacity(width * height * 3);
        for row in rows {
            for pixel in row.chunks_exact(pixel) {
                values.extend([pixel[r], pixel[g], pixel[b]]);
            }
        }
        let image = RgbImage::from_raw(width as u32, height as u32, values);
        image.ok_or_else(|| damaged("is of another size than it says"))
    }

    fn depths(&self) -> Result<Numbers> {
        let big = self.big_endian;
        Ok(match self.encoding.as_str() {
            "32FC1" => {
                let number = |bytes: [u8; 4]| {
                    if big {
                        f32::from_be_bytes(bytes)
                    } else {
                        f32::from_le_bytes(bytes)
                    }
                };
                let rows = self.rows(4)?.flat_map(|row| row.as_chunks().0);
                (rows.map(|bytes| number(*bytes)).collect(), false)
            }
            "16UC1" | "mono16" => {
                let number = |bytes: [u8; 2]| {
                    if big {
                        u16::from_be_bytes(bytes)
                    } else {
                        u16::from_le_bytes(bytes)
                    }
                };
                let rows = self.rows(2)?.flat_map(|row| row.as_chunks().0);
                (rows.map(|bytes| number(*bytes).into()).collect(), true)
            }
            other => {
                return Err(damaged(format!("is encoded as `{other}`, which holds no depths"))
                    .hint("depths are read as 32FC1 (metres) and 16UC1 (millimetres, or --depth-unit)"));
            }
        })
    }
}

/// The colours of a message of either type.
///
/// # Errors
/// A damaged message, and an encoding that holds no colours that are known.
pub(crate) fn colours(kind: Kind, message: &[u8]) -> Result<(Header, RgbImage)> {
    let read = || {
        let mut reader = Reader::new(message)?;
        let header = Header::read(&mut reader)?;
        let image = if kind == Kind::CompressedImage {
            let _format = reader.string()?;
            decode(reader.bytes()?)?.into_rgb8()
        } else {
            Raw::read(&mut reader)?.colours()?
        };
        Ok((header, image))
    };
    read().map_err(|e| unusable(kind, e))
}

/// The depths of a message of either type: metres = numbers x `scale`, which may depend on whether these are whole.
///
/// # Errors
/// A damaged message, and an encoding that holds no depths.
pub(crate) fn depths(
    kind: Kind,
    message: &[u8],
    scale: impl Fn(bool) -> f64,
) -> Result<DepthImage> {
    let read = || {
        let mut reader = Reader::new(message)?;
        Header::read(&mut reader)?;
        let ((width, height), (mut values, whole)) = if kind == Kind::CompressedImage {
            let format = reader.string()?;
            compressed_depths(&format, reader.bytes()?)?
        } else {
            let raw = Raw::read(&mut reader)?;
            (raw.size, raw.depths()?)
        };
        let scale = scale(whole);
        for value in &mut values {
            *value = (f64::from(*value) * scale) as f32;
        }
        Ok(DepthImage {
            depth: DepthMap::new(width, height, values)?,
            whole,
        })
    };
    read().map_err(|e| unusable(kind, e))
}

/// How many bytes an image may have that so many bytes hold.
fn largest(bytes: &[u8]) -> u64 {
    /// No image is larger.
    const LARGEST: u64 = 1 << 30;
    // What deflate and JPEG can make of so many bytes.
    LARGEST.min((16 << 20).max(bytes.len() as u64 * 1100))
}

/// A JPEG or PNG.
fn decode(bytes: &[u8]) -> Result<DynamicImage> {
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    if let Ok(reader) = &mut reader {
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(largest(bytes));
        reader.limits(limits);
    }
    let known = |format| matches!(format, Some(ImageFormat::Jpeg | ImageFormat::Png));
    match reader {
        Ok(reader) if known(reader.format()) => reader
            .decode()
            .map_err(|e| damaged("holds a damaged JPEG or PNG").because(e)),
        _ => Err(damaged("holds neither a JPEG nor a PNG")),
    }
}

/// What `compressed_depth_image_transport` writes: the kind of compression, two parameters, and a PNG or RVL. Floating-point
/// depths are stored as their inverses, in steps that these parameters say.
///
/// # Errors
/// A damaged image, and one that holds no depths.
pub(crate) fn compressed_depths(format: &str, bytes: &[u8]) -> Result<((usize, usize), Numbers)> {
    let Some((head, packed)) = bytes.split_first_chunk::<12>() else {
        return Err(damaged("ends too early"));
    };
    let parameter = |at: usize| {
        let bytes = head[at..at + 4].try_into().unwrap_or_default();
        f32::from_le_bytes(bytes)
    };
    let (encoding, how) = format.split_once(';').unwrap_or((format, ""));
    let (size, values) = if how.contains("rvl") {
        unrolled(packed)?
    } else if let DynamicImage::ImageLuma16(image) = decode(packed)? {
        let size = (image.width() as usize, image.height() as usize);
        (size, image.into_raw())
    } else {
        return Err(damaged("of compressed depths holds no PNG of 16 bits"));
    };
    let numbers = match encoding.trim() {
        "16UC1" | "mono16" => (values.into_iter().map(f32::from).collect(), true),
        "32FC1" => {
            let (a, b) = (parameter(4), parameter(8));
            let metres = |v: u16| if v == 0 { 0.0 } else { a / (f32::from(v) - b) };
            (values.into_iter().map(metres).collect(), false)
        }
        other => {
            return Err(damaged(format!(
                "is of compressed `{other}`, which holds no depths"
            )));
        }
    };
    Ok((size, numbers))
}

/// Width and height, and behind them the pixels by RVL.
fn unrolled(bytes: &[u8]) -> Result<((usize, usize), Vec<u16>)> {
    let (numbers, _) = bytes.as_chunks::<4>();
    let (Some(&[width, height]), Some(pixels)) = (numbers.first_chunk(), bytes.get(8..)) else {
        return Err(damaged("ends too early"));
    };
    let [width, height] = [width, height].map(|bytes| u32::from_le_bytes(bytes) as usize);
    let count = width.checked_mul(height);
    let fits = |count: &usize| *count > 0 && *count as u64 <= largest(bytes) / 2;
    let Some(count) = count.filter(fits) else {
        return Err(damaged(format!(
            "of {width}x{height} pixels by RVL has {} bytes",
            bytes.len()
        )));
    };
    Ok(((width, height), rvl::decode(pixels, count)?))
}

/// A message of depths: metres as `32FC1`, or whole millimetres as `16UC1`, where depths beyond 65.535 m are none; and
/// how many those are.
pub fn write_depth(header: &Header, depth: &DepthMap, millimetres: bool) -> (Vec<u8>, usize) {
    let (width, height) = (depth.width(), depth.height());
    let bytes = if millimetres { 2 } else { 4 };
    let mut writer = Writer::with_capacity(128 + width * height * bytes);
    header.write(&mut writer);
    writer.u32(height as u32);
    writer.u32(width as u32);
    writer.string(if millimetres { "16UC1" } else { "32FC1" });
    writer.u8(0);
    writer.u32((width * bytes) as u32);
    let values = depth.values();
    let mut lost = 0;
    let data: Vec<u8> = if millimetres {
        let stored = |&depth: &f32| {
            let value = (f64::from(depth) * 1000.0).round();
            // What is seen is not made unseen by rounding.
            let value = if depth > 0.0 { value.max(1.0) } else { 0.0 };
            let fits = value <= f64::from(u16::MAX);
            lost += usize::from(!fits);
            if fits { value as u16 } else { 0 }
        };
        values
            .iter()
            .map(stored)
            .flat_map(u16::to_le_bytes)
            .collect()
    } else {
        values
            .iter()
            .flat_map(|depth| depth.to_le_bytes())
            .collect()
    };
    writer.bytes(data.into_iter());
    (writer.finish(), lost)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(encoding: &str, (width, height): (u32, u32), step: u32, data: &[u8]) -> Vec<u8> {
        let mut writer = Writer::with_capacity(0);
        Header::default().write(&mut writer);
        writer.u32(height);
        writer.u32(width);
        writer.string(encoding);
        writer.u8(0);
        writer.u32(step);
        writer.bytes(data.iter().copied());
        writer.finish()
    }

    #[test]
    fn rows_may_be_longer_than_their_pixels() {
        let data = [1, 2, 3, 4, 5, 6, 99, 7, 8, 9, 10, 11, 12];
        let read = |encoding: &str| colours(Kind::Image, &message(encoding, (2, 2), 7, &data));
        let (_, image) = read("rgb8").unwrap();
        assert_eq!(image.as_raw()[..], [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]);
        let (_, image) = read("bgr8").unwrap();
        assert_eq!(image.get_pixel(1, 1).0, [12, 11, 10]);
        assert!(read("rgba8").is_err());
        assert!(read("rgb16").unwrap_err().advice().is_some());
        assert!(colours(Kind::Image, &message("rgb8", (2, 3), 7, &data)).is_err());
        assert!(
            colours(
                Kind::Image,
                &message("rgb8", (u32::MAX, u32::MAX), 7, &data)
            )
            .is_err()
        );
        assert!(colours(Kind::Image, &message("mono8", (0, 0), 0, &[])).is_err());
    }

    #[test]
    fn depths_are_written_in_either_unit() {
        let depth = DepthMap::new(4, 1, vec![0.0, 0.0001, 1.2344, 70.0]).unwrap();
        let header = Header {
            stamp: 5_000_000_007,
            frame: "camera".to_owned(),
        };
        let (message, lost) = write_depth(&header, &depth, false);
        let found = depths(Kind::Image, &message, |_| 1.0).unwrap();
        assert_eq!(
            (found.depth.values(), found.whole, lost),
            (depth.values(), false, 0)
        );
        assert_eq!(Header::of(&message).unwrap(), header);
        let (message, lost) = write_depth(&header, &depth, true);
        let found = depths(Kind::Image, &message, |_| 1.0).unwrap();
        assert_eq!(found.depth.values(), [0.0, 1.0, 1234.0, 0.0]);
        assert_eq!((found.whole, lost), (true, 1));
    }

    /// A red-only, green-only and blue-only scene give that colour everywhere.
    #[test]
    fn a_mosaic_of_one_colour_is_that_colour() {
        for encoding in ["bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8"] {
            let pattern = bayer::pattern(encoding).unwrap();
            let color = [200, 100, 50];
            let data: Vec<u8> = (0..30)
                .map(|i| color[pattern[i / 6 % 2][i % 6 % 2]])
                .collect();
            let (_, image) = colours(Kind::Image, &message(encoding, (6, 5), 6, &data)).unwrap();
            assert!(image.pixels().all(|pixel| pixel.0 == color), "{encoding}");
        }
    }
}
