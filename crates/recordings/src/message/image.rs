//! `sensor_msgs/msg/Image` and `CompressedImage`: colours and depths.

use super::raw::Raw;
use super::{Header, MessageType, bayer, read_message, rvl, yuv};
use crate::cdr::{CdrWriter, damaged};
use image::{DynamicImage, ImageBuffer, ImageFormat, ImageReader, RgbImage};
use lsdc_core::DepthMap;
use lsdc_files::checks::{NumberType, Warning, check_jpeg, to_rgb8};
use lsdc_files::error::{Error, Result};
use lsdc_files::{StoredMap, Unit};
use std::io::Cursor;

/// Values of the pixels of a depth image, and their stored type.
type DepthNumbers = (Vec<f32>, NumberType);

const U16: NumberType = NumberType::unsigned(16);

impl Raw<'_> {
    fn colours(&self) -> Result<DynamicImage> {
        let (width, height) = self.size;
        let encoding = self.encoding.as_str();
        if let Some(pattern) = bayer::pattern(encoding) {
            let pixels = self.rows(1)?.collect::<Vec<_>>().concat();
            return Ok(bayer::colours(&pixels, self.size, pattern).into());
        }
        if let Some(layout) = yuv::layout(encoding) {
            return Ok(yuv::colours(self, layout)?.into());
        }
        if encoding == "mono16" {
            let values = self.numbers_u16()?.collect();
            let image = ImageBuffer::from_raw(width as u32, height as u32, values);
            return image
                .map(DynamicImage::ImageLuma16)
                .ok_or_else(|| self.too_short());
        }
        // Bytes of a pixel, and offsets of red, green and blue in them.
        let (pixel, [r, g, b]) = match encoding {
            "rgb8" => (3, [0, 1, 2]),
            "bgr8" | "8UC3" => (3, [2, 1, 0]),
            "rgba8" => (4, [0, 1, 2]),
            "bgra8" | "8UC4" => (4, [2, 1, 0]),
            "mono8" | "8UC1" => (1, [0, 0, 0]),
            _ => {
                return Err(damaged(format!("is encoded as `{encoding}`, which is not read")).hint(
                    "colours are read as rgb8, bgr8, rgba8, bgra8, mono8, mono16, bayer_*8, uyvy (yuv422), yuyv (yuv422_yuy2), \
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
        image
            .map(Into::into)
            .ok_or_else(|| damaged("is of another size than it says"))
    }

    fn depths(&self) -> Result<DepthNumbers> {
        match self.encoding.as_str() {
            "32FC1" => {
                let values = self.numbers(f32::from_be_bytes, f32::from_le_bytes)?;
                Ok((values.collect(), NumberType::Floats))
            }
            "16UC1" | "mono16" => Ok((self.numbers_u16()?.map(f32::from).collect(), U16)),
            other => Err(
                damaged(format!("is encoded as `{other}`, which holds no depths")).hint(
                    "depths are read as 32FC1 (metres) and 16UC1 (millimetres, or --depth-unit)",
                ),
            ),
        }
    }
}

/// Decodes the colours of a message of either type, with a warning about them.
///
/// # Errors
/// The message is damaged or truncated, or its encoding has no supported colours.
pub(crate) fn colours(
    kind: MessageType,
    message: &[u8],
) -> Result<(Header, RgbImage, Option<Warning>)> {
    read_message(kind, message, |reader| {
        let header = Header::read(reader)?;
        let image = if kind == MessageType::CompressedImage {
            let _format = reader.string()?;
            decode(reader.bytes()?)?
        } else {
            Raw::read(reader)?.colours()?
        };
        let (rgb, warning) = to_rgb8(image);
        Ok((header, rgb, warning))
    })
}

/// Reads the width and height of the image of a message of either type.
///
/// # Errors
/// As for [`colours`], as far as they concern the size.
pub(crate) fn size_of(kind: MessageType, message: &[u8]) -> Result<(usize, usize)> {
    read_message(kind, message, |reader| {
        Header::read(reader)?;
        if kind != MessageType::CompressedImage {
            return Ok(Raw::read(reader)?.size);
        }
        let _format = reader.string()?;
        let reader = ImageReader::new(Cursor::new(reader.bytes()?)).with_guessed_format();
        let size = reader
            .map_err(Into::into)
            .and_then(ImageReader::into_dimensions);
        let (width, height) =
            size.map_err(|e| damaged("holds neither a JPEG nor a PNG").because(e))?;
        Ok((width as usize, height as usize))
    })
}

/// Decodes the depths of a message of either type. Without a unit, integers are millimetres and other numbers metres (ROS
/// REP 118).
///
/// # Errors
/// The message is damaged, or its encoding has no depths.
pub(crate) fn depths(kind: MessageType, message: &[u8], unit: Option<Unit>) -> Result<StoredMap> {
    read_message(kind, message, |reader| {
        Header::read(reader)?;
        let (size, (values, numbers)) = if kind == MessageType::CompressedImage {
            let format = reader.string()?;
            compressed_depths(&format, reader.bytes()?)?
        } else {
            let raw = Raw::read(reader)?;
            (raw.size, raw.depths()?)
        };
        StoredMap::of_numbers(size, values, numbers, unit)
    })
}

/// Returns the limit of the decoded size of compressed bytes.
fn largest(bytes: &[u8]) -> u64 {
    /// Upper limit of any image.
    const LARGEST: u64 = 1 << 30;
    // Largest expansion by deflate and JPEG.
    LARGEST.min((16 << 20).max(bytes.len() as u64 * 1100))
}

/// Decodes a complete JPEG or PNG.
fn decode(bytes: &[u8]) -> Result<DynamicImage> {
    check_jpeg(bytes).map_err(|cut_off| damaged(format!("cannot be used: {cut_off}")))?;
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

/// Decodes the depths of a compressed image, by the format named in its message. The transport `compressedDepth` writes its
/// kind of compression, two parameters, and a PNG or RVL; it quantises floating-point depths as inverse depths, with these
/// parameters. The transport `compressed` writes only a PNG of integers.
///
/// # Errors
/// The image is damaged, or has no depths.
pub(crate) fn compressed_depths(
    format: &str,
    bytes: &[u8],
) -> Result<((usize, usize), DepthNumbers)> {
    const PNG: &[u8] = b"\x89PNG";
    let (encoding, transport) = format.split_once(';').unwrap_or((format, ""));
    let encoding = encoding.trim();
    if bytes.starts_with(PNG) {
        if encoding == "32FC1" {
            return Err(unread_format(format));
        }
        let (size, values) = png(bytes)?;
        return Ok((size, (values.into_iter().map(f32::from).collect(), U16)));
    }
    let Some((head, packed)) = bytes.split_first_chunk::<12>() else {
        return Err(damaged("ends too early"));
    };
    let parameter = |at: usize| {
        let bytes = head[at..at + 4].try_into().unwrap_or_default();
        f32::from_le_bytes(bytes)
    };
    let (size, values) = if transport.contains("rvl") {
        decode_rvl(packed)?
    } else if packed.starts_with(PNG) {
        png(packed)?
    } else {
        return Err(unread_format(format));
    };
    let numbers = match encoding {
        "16UC1" | "mono16" => (values.into_iter().map(f32::from).collect(), U16),
        "32FC1" => {
            let (a, b) = (parameter(4), parameter(8));
            let metres = |v: u16| if v == 0 { 0.0 } else { a / (f32::from(v) - b) };
            (values.into_iter().map(metres).collect(), NumberType::Floats)
        }
        other => {
            return Err(damaged(format!(
                "is of compressed `{other}`, which holds no depths"
            )));
        }
    };
    Ok((size, numbers))
}

/// Returns the size and the pixels of a 16-bit PNG.
fn png(bytes: &[u8]) -> Result<((usize, usize), Vec<u16>)> {
    match decode(bytes)? {
        DynamicImage::ImageLuma16(image) => {
            let size = (image.width() as usize, image.height() as usize);
            Ok((size, image.into_raw()))
        }
        other => Err(damaged(format!(
            "holds a PNG of {:?}, but depths are 16 bits of grey",
            other.color()
        ))),
    }
}

/// Error of a compressed image whose format has no depths or is not supported.
fn unread_format(format: &str) -> Error {
    damaged(format!("is compressed as `{format}`, in which depths are not read")).hint(
        "depths are read as PNG of 16 bits by the transport compressed, and as PNG or RVL by compressedDepth; JPEG and TIFF are not",
    )
}

/// Decodes width and height, followed by the pixels in RVL.
fn decode_rvl(bytes: &[u8]) -> Result<((usize, usize), Vec<u16>)> {
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

/// Writes a message of depths: metres as `32FC1`, or whole millimetres as `16UC1`, where depths beyond 65.535 m are left
/// out. Returns the message and how many were left out.
pub fn write_depth(header: &Header, depth: &DepthMap, millimetres: bool) -> (Vec<u8>, usize) {
    let (width, height) = (depth.width(), depth.height());
    let bytes = if millimetres { 2 } else { 4 };
    let mut writer = CdrWriter::with_capacity(128 + width * height * bytes);
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
            // Rounding must not turn a measurement into 0, which means no depth.
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
        let mut writer = CdrWriter::with_capacity(0);
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
        let read =
            |encoding: &str| colours(MessageType::Image, &message(encoding, (2, 2), 7, &data));
        let (_, image, _) = read("rgb8").unwrap();
        assert_eq!(image.as_raw()[..], [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]);
        let (_, image, _) = read("bgr8").unwrap();
        assert_eq!(image.get_pixel(1, 1).0, [12, 11, 10]);
        assert!(read("rgba8").is_err());
        assert!(read("rgb16").unwrap_err().advice().is_some());
        assert!(colours(MessageType::Image, &message("rgb8", (2, 3), 7, &data)).is_err());
        assert!(
            colours(
                MessageType::Image,
                &message("rgb8", (u32::MAX, u32::MAX), 7, &data)
            )
            .is_err()
        );
        assert!(colours(MessageType::Image, &message("mono8", (0, 0), 0, &[])).is_err());
    }

    #[test]
    fn depths_are_written_in_either_unit() {
        let depth = DepthMap::new(4, 1, vec![0.0, 0.0001, 1.2344, 70.0]).unwrap();
        let header = Header {
            stamp: 5_000_000_007,
            frame: "camera".to_owned(),
        };
        let (message, lost) = write_depth(&header, &depth, false);
        let found = depths(MessageType::Image, &message, None).unwrap();
        assert_eq!(
            (found.depth.values(), found.unit, lost),
            (depth.values(), Unit::METRE, 0)
        );
        assert_eq!(Header::of(&message).unwrap(), header);
        let (message, lost) = write_depth(&header, &depth, true);
        let found = depths(MessageType::Image, &message, Some(Unit::METRE)).unwrap();
        assert_eq!(found.depth.values(), [0.0, 1.0, 1234.0, 0.0]);
        let found = depths(MessageType::Image, &message, None).unwrap();
        assert_eq!((found.unit, lost), (Unit::MILLIMETRE, 1));
    }

    /// A 16-bit PNG of these pixels.
    fn png_of(width: u32, values: &[u16]) -> Vec<u8> {
        let height = values.len() as u32 / width;
        let image =
            image::ImageBuffer::<image::Luma<u16>, _>::from_raw(width, height, values.to_vec());
        let mut bytes = Cursor::new(Vec::new());
        image
            .unwrap()
            .write_to(&mut bytes, ImageFormat::Png)
            .unwrap();
        bytes.into_inner()
    }

    #[test]
    fn depths_are_read_by_either_transport() {
        let values = [0, 1, 1500, 65_000];
        let alone = png_of(2, &values);
        let parameters = [&[0; 12][..], &alone].concat();
        let numbers: Vec<f32> = values.into_iter().map(f32::from).collect();
        for (format, bytes) in [
            ("16UC1; png compressed ", &alone),
            ("png", &alone),
            ("mono16; png compressed", &alone),
            ("16UC1; compressedDepth png", &parameters),
            ("16UC1; compressedDepth", &parameters),
            // Some senders name the other transport; the bytes decide.
            ("16UC1; compressedDepth png", &alone),
        ] {
            let found = compressed_depths(format, bytes).unwrap();
            assert_eq!(found, ((2, 2), (numbers.clone(), U16)), "{format}");
        }
    }

    #[test]
    fn compressed_images_that_hold_no_depths_are_refused_by_their_format() {
        let mut grey = Cursor::new(Vec::new());
        image::GrayImage::new(2, 2)
            .write_to(&mut grey, ImageFormat::Png)
            .unwrap();
        let jpeg = [&[0xff, 0xd8, 0xff, 0xe0][..], &[0; 40]].concat();
        let tiff = [&b"II*\0"[..], &[0; 40]].concat();
        for (format, bytes, what) in [
            ("16UC1; jpeg compressed", jpeg, "`16UC1; jpeg compressed`"),
            ("32FC1; tiff compressed", tiff, "`32FC1; tiff compressed`"),
            (
                "32FC1; png compressed",
                png_of(2, &[1, 2]),
                "`32FC1; png compressed`",
            ),
            ("mono8; png compressed", grey.into_inner(), "16 bits"),
        ] {
            let error = compressed_depths(format, &bytes).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
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
            let (_, image, _) =
                colours(MessageType::Image, &message(encoding, (6, 5), 6, &data)).unwrap();
            assert!(image.pixels().all(|pixel| pixel.0 == color), "{encoding}");
        }
    }
}
