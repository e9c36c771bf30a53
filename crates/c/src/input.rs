//! Images, depths and guides of the caller.

use crate::error::{Error, Result};
use crate::memory::{self, Plain, RowLayout, Versioned};
use lsdc_core::{Channels, DepthGuide, GuideKind, Image, MAX_PIXELS, Observation, Observations};
use lsdc_files::checks::{NumberFormat, NumberType, leave_out_marks};
use std::ffi::c_void;

/// The order and type of the colours of a pixel: one of the constants `LSDC_...8` and `LSDC_...F32`.
pub type lsdc_format = u32;

/// Red, green, blue, 8 bits each.
pub const LSDC_RGB8: lsdc_format = 0;
/// Blue, green, red, 8 bits each, as OpenCV reads images.
pub const LSDC_BGR8: lsdc_format = 1;
/// One grey value of 8 bits.
pub const LSDC_GREY8: lsdc_format = 2;
/// Red, green, blue and a byte that is ignored.
pub const LSDC_RGBA8: lsdc_format = 3;
/// Blue, green, red and a byte that is ignored.
pub const LSDC_BGRA8: lsdc_format = 4;
/// As `LSDC_RGB8` in floats from 0 (black) to 1 (white); values slightly outside are clamped, above 16 an error.
pub const LSDC_RGB_F32: lsdc_format = 16;
/// As `LSDC_BGR8` in floats.
pub const LSDC_BGR_F32: lsdc_format = 17;
/// As `LSDC_GREY8` in floats.
pub const LSDC_GREY_F32: lsdc_format = 18;
/// As `LSDC_RGBA8` in floats.
pub const LSDC_RGBA_F32: lsdc_format = 19;
/// As `LSDC_BGRA8` in floats.
pub const LSDC_BGRA_F32: lsdc_format = 20;

/// An image in the caller's memory. Set `struct_size` to `sizeof(lsdc_image)`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct lsdc_image {
    /// `sizeof(lsdc_image)`.
    pub struct_size: usize,
    /// The first pixel of the first row. No alignment is needed.
    pub data: *const c_void,
    /// Bytes of the buffer from `data` to the last pixel, or to the end of the last row's stride.
    pub size: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows; width times height is at most 2^30.
    pub height: usize,
    /// Bytes from the start of one row to the next; 0 means no gaps.
    pub stride: usize,
    /// One of the constants `LSDC_RGB8` to `LSDC_BGRA_F32`.
    pub format: lsdc_format,
    /// 0.
    pub reserved: u32,
}

// SAFETY: it is `repr(C)`, begins with its size, and consists of numbers and a pointer, which may be 0.
unsafe impl Versioned for lsdc_image {
    const LEAST: usize = size_of::<Self>();
}

/// The type of the values of a map: `LSDC_F32` or `LSDC_U16`.
pub type lsdc_depth_format = u32;

/// 32-bit floats.
pub const LSDC_F32: lsdc_depth_format = 0;
/// Unsigned 16-bit integers in the byte order of the machine.
pub const LSDC_U16: lsdc_depth_format = 1;

/// A map of depths, standard deviations or guide values in the caller's memory. Set `struct_size` to
/// `sizeof(lsdc_map)`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct lsdc_map {
    /// `sizeof(lsdc_map)`.
    pub struct_size: usize,
    /// The first value of the first row. No alignment is needed.
    pub data: *const c_void,
    /// Bytes of the buffer from `data` to the last value, or to the end of the last row's stride.
    pub size: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows; width times height is at most 2^30.
    pub height: usize,
    /// Bytes from the start of one row to the next; 0 means no gaps.
    pub stride: usize,
    /// The unit of the values in metres: 0.001 for millimetres. Required for integers; for floats, 0 means 1.
    pub unit: f64,
    /// `LSDC_F32` or `LSDC_U16`.
    pub format: lsdc_depth_format,
    /// 0.
    pub reserved: u32,
}

// SAFETY: as above.
unsafe impl Versioned for lsdc_map {
    const LEAST: usize = size_of::<Self>();
}

/// Known depths at some positions of an image, in the caller's memory. Set `struct_size` to
/// `sizeof(lsdc_points)`.
///
/// With a stride of 0, `x`, `y`, `depth` and `sigma` are arrays of `count` values; otherwise they point to
/// fields of the first of `count` structures that are `stride` bytes apart.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct lsdc_points {
    /// `sizeof(lsdc_points)`.
    pub struct_size: usize,
    /// Number of points, at most 2^30.
    pub count: usize,
    /// Columns, which may lie between pixels: 0 is the centre of the first, the image ends at `width - 0.5`.
    pub x: *const f64,
    /// Rows, downwards: 0 is the centre of the first, the image ends at `height - 0.5`.
    pub y: *const f64,
    /// Depths along the optical axis, in metres or any other unit; results are in the same unit.
    pub depth: *const f32,
    /// Standard deviations of the depths in the same unit; null if all are unknown. Values that are not positive and
    /// finite mean unknown, and are counted in `lsdc_report.without_deviation` if others are known.
    pub sigma: *const f32,
    /// Bytes from one point to the next in all arrays; 0 means no gaps.
    pub stride: usize,
}

// SAFETY: as above.
unsafe impl Versioned for lsdc_points {
    const LEAST: usize = size_of::<Self>();
}

/// Quantity of the values of a guide, up to scale and shift: one of the constants `LSDC_GUIDE_...`.
pub type lsdc_guide_kind = u32;

/// Depths above 0.
pub const LSDC_GUIDE_DEPTH: lsdc_guide_kind = 0;
/// Inverse depths (larger is nearer), as MiDaS and Depth Anything predict.
pub const LSDC_GUIDE_DISPARITY: lsdc_guide_kind = 1;
/// Logarithms of depths.
pub const LSDC_GUIDE_LOG: lsdc_guide_kind = 2;
/// With a null guide: no guide, not even from the depth head of "anything".
pub const LSDC_GUIDE_NONE: lsdc_guide_kind = 3;

pub(crate) fn unused(reserved: u32, what: &str) -> Result<()> {
    match reserved {
        0 => Ok(()),
        _ => Err(Error::argument(format!("`{what}->reserved` is not 0"))),
    }
}

/// Returns the layout of `width * height` pixels of `bytes` bytes, which must fill `size` bytes.
fn grid(
    what: &str,
    [width, height, bytes]: [usize; 3],
    stride: usize,
    size: usize,
) -> Result<RowLayout> {
    checked_size(what, width, height)?;
    RowLayout::new(what, height, width * bytes, stride)?.fill(what, size)
}

/// Checks that a size is valid.
pub(crate) fn checked_size(what: &str, width: usize, height: usize) -> Result<()> {
    match width.checked_mul(height) {
        Some(1..=MAX_PIXELS) => Ok(()),
        _ => Err(
            Error::buffer(format!("{what} cannot have {width}x{height} pixels"))
                .with_hint(format!("a size is from 1x1 to {MAX_PIXELS} pixels")),
        ),
    }
}

/// The pixels of an image, without gaps.
pub(crate) struct Pixels {
    width: usize,
    height: usize,
    channels: Channels,
    values: Values,
}

enum Values {
    Bytes(Vec<u8>),
    Floats(Vec<f32>),
}

impl Pixels {
    /// Copies the pixels of the caller.
    ///
    /// # Safety
    /// `image` is null, or it and its buffer are as large as they say, and nobody writes them meanwhile.
    pub(crate) unsafe fn read(image: *const lsdc_image) -> Result<Self> {
        // SAFETY: the caller's promise.
        let image = unsafe { memory::structure(image, "image") }?;
        unused(image.reserved, "image")?;
        let (channels, floats) = match image.format {
            LSDC_RGB8 => (Channels::Rgb, false),
            LSDC_BGR8 => (Channels::Bgr, false),
            LSDC_GREY8 => (Channels::Gray, false),
            LSDC_RGBA8 => (Channels::Rgba, false),
            LSDC_BGRA8 => (Channels::Bgra, false),
            LSDC_RGB_F32 => (Channels::Rgb, true),
            LSDC_BGR_F32 => (Channels::Bgr, true),
            LSDC_GREY_F32 => (Channels::Gray, true),
            LSDC_RGBA_F32 => (Channels::Rgba, true),
            LSDC_BGRA_F32 => (Channels::Bgra, true),
            other => return Err(Error::unknown("image->format", other)),
        };
        // SAFETY: the caller's promise.
        let values = unsafe {
            if floats {
                Values::Floats(image.gathered(channels.count())?)
            } else {
                Values::Bytes(image.gathered(channels.count())?)
            }
        };
        Ok(Self {
            width: image.width,
            height: image.height,
            channels,
            values,
        })
    }

    pub(crate) fn image(&self) -> lsdc_core::Result<Image<'_>> {
        match &self.values {
            Values::Bytes(values) => Image::new(self.width, self.height, self.channels, values),
            Values::Floats(values) => {
                Image::from_f32(self.width, self.height, self.channels, values)
            }
        }
    }
}

impl lsdc_image {
    /// # Safety
    /// `data` is null or as long as `size` says, and nobody writes it meanwhile.
    unsafe fn gathered<T: Plain>(&self, channels: usize) -> Result<Vec<T>> {
        let size = [self.width, self.height, channels * size_of::<T>()];
        let rows = grid("the image", size, self.stride, self.size)?;
        // SAFETY: the rows lie within `size` bytes.
        unsafe { memory::gather(self.data.cast(), rows, "image->data") }
    }
}

/// A map without gaps.
pub(crate) struct MapValues {
    width: usize,
    height: usize,
    /// Values as stored.
    values: Vec<f32>,
    numbers: NumberType,
    /// Metres per stored unit.
    unit: f64,
}

impl MapValues {
    /// Copies the values of the caller; `what` is the name of the argument.
    ///
    /// # Safety
    /// `map` is null, or it and its buffer are as large as they say, and nobody writes them meanwhile.
    pub(crate) unsafe fn read(map: *const lsdc_map, what: &str) -> Result<Self> {
        // SAFETY: the caller's promise.
        let map = unsafe { memory::structure(map, what) }?;
        unused(map.reserved, what)?;
        let sound = |unit: f64| unit > 0.0 && unit.is_finite();
        let unit = match map.format {
            LSDC_F32 if map.unit == 0.0 => 1.0,
            LSDC_F32 | LSDC_U16 if sound(map.unit) => map.unit,
            LSDC_F32 | LSDC_U16 => {
                let message = format!("`{what}->unit` is {}, but must be above 0", map.unit);
                return Err(Error::argument(message)
                    .with_hint("say what 1 stands for in metres: 0.001 for millimetres"));
            }
            other => return Err(Error::unknown(&format!("{what}->format"), other)),
        };
        // SAFETY: the caller's promise.
        let (values, numbers) = unsafe {
            if map.format == LSDC_U16 {
                let integers = map.gathered::<u16>(what)?;
                let values = integers.into_iter().map(f32::from).collect();
                (values, NumberType::unsigned(16))
            } else {
                (map.gathered(what)?, NumberType::Floats)
            }
        };
        Ok(Self {
            width: map.width,
            height: map.height,
            values,
            numbers,
            unit,
        })
    }

    /// Converts a stored value to metres.
    fn metres(&self, value: f32) -> f32 {
        if self.unit == 1.0 {
            value
        } else {
            (f64::from(value) * self.unit) as f32
        }
    }

    /// Returns the measurements of a map of the size of an image, row by row. Pixels that are 0 are skipped; values that are no
    /// valid depths, or mark missing measurements, are kept as invalid, to be counted.
    pub(crate) fn observations(
        mut self,
        sigma: Option<Self>,
        size: (usize, usize),
    ) -> Result<Observations> {
        for (map, what) in [
            (Some(&self), "the depth map"),
            (sigma.as_ref(), "the map of sigmas"),
        ] {
            let Some(map) = map else { continue };
            if (map.width, map.height) != size {
                let (width, height) = size;
                let message = format!(
                    "{what} has {}x{} pixels, but the image {width}x{height}",
                    map.width, map.height
                );
                return Err(Error::buffer(message).with_hint("give points at their positions"));
            }
        }
        let known = NumberFormat {
            numbers: self.numbers,
            metres: self.unit,
            declared: None,
        };
        leave_out_marks(&mut self.values, &known);
        let places = self.values.iter().enumerate();
        let measured = places.filter(|(_, depth)| **depth != 0.0);
        let observation = |(i, &depth): (usize, &f32)| Observation {
            u: (i % self.width) as f64,
            v: (i / self.width) as f64,
            depth: self.metres(depth),
            sigma: sigma.as_ref().map(|map| map.metres(map.values[i])),
        };
        Ok(measured.map(observation).collect())
    }

    /// Converts the map to a guide. Values that are no valid predictions are gaps.
    pub(crate) fn guide(self, kind: lsdc_guide_kind) -> Result<DepthGuide> {
        let kind = match kind {
            LSDC_GUIDE_DEPTH => GuideKind::Depth,
            LSDC_GUIDE_DISPARITY => GuideKind::Disparity,
            LSDC_GUIDE_LOG => GuideKind::Log,
            other => return Err(Error::unknown("options->guide_kind", other)),
        };
        let values: Vec<f32> = self.values.iter().map(|&v| self.metres(v)).collect();
        Ok(DepthGuide::new(kind, self.width, self.height, &values)?)
    }
}

impl lsdc_map {
    /// # Safety
    /// `data` is null or as long as `size` says, and nobody writes it meanwhile.
    unsafe fn gathered<T: Plain>(&self, what: &str) -> Result<Vec<T>> {
        let size = [self.width, self.height, size_of::<T>()];
        let rows = grid(&format!("`{what}`"), size, self.stride, self.size)?;
        // SAFETY: the rows lie within `size` bytes.
        unsafe { memory::gather(self.data.cast(), rows, &format!("{what}->data")) }
    }
}

/// Copies the points of the caller.
///
/// # Safety
/// `points` is null, or it and its arrays are as long as they say, and nobody writes them meanwhile.
pub(crate) unsafe fn observations(points: *const lsdc_points) -> Result<Observations> {
    // SAFETY: the caller's promise.
    let points = unsafe { memory::structure(points, "points") }?;
    if points.count > MAX_PIXELS {
        let message = format!(
            "{} points are more than the {MAX_PIXELS} allowed",
            points.count
        );
        return Err(Error::buffer(message));
    }
    // SAFETY: the caller's promise; a stride that is too short for the largest values is refused before others are read.
    let (x, y, depth, sigma) = unsafe {
        let x = points.column(points.x, "points->x")?;
        let y = points.column(points.y, "points->y")?;
        let depth = points.column(points.depth, "points->depth")?;
        let sigma = |sigma| points.column(sigma, "points->sigma");
        let sigma = memory::unless_null(points.sigma, sigma)?;
        (x, y, depth, sigma)
    };
    let observation = |i: usize| Observation {
        u: x[i],
        v: y[i],
        depth: depth[i],
        sigma: sigma.as_ref().map(|sigma| sigma[i]),
    };
    Ok((0..points.count).map(observation).collect())
}

impl lsdc_points {
    /// # Safety
    /// `first` is null or leads to `count` values `stride` bytes apart, which nobody writes meanwhile.
    unsafe fn column<T: Plain>(&self, first: *const T, what: &str) -> Result<Vec<T>> {
        let rows = RowLayout::new(
            &format!("`{what}`"),
            self.count,
            size_of::<T>(),
            self.stride,
        )?;
        // SAFETY: the caller's promise.
        unsafe { memory::gather(first, rows, what) }
    }
}
