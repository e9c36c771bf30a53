//! Checks of inputs: values that mark missing measurements, implausible units and codings, choices between several arrays,
//! images that use little of their range, truncated files.
//!
//! All readers use these functions: those of files, recordings, the service, Python and C. They take numbers and their
//! format, print nothing, and return [`Warning`]s, whose texts become remarks.

mod coding;
mod image;
mod jpeg;
mod marks;
mod names;
mod numbers;

pub use coding::{is_rotated, rotate_back};
pub use image::to_rgb8;
pub use jpeg::{CutOff, check_jpeg};
pub use marks::{NumberFormat, leave_out_marks, marks_in_guide};
pub use names::{RAY, channel_rank, is_ray_distance};
pub(crate) use names::{depth_array, name_warning, quoted};
pub use numbers::NumberType;

use crate::Unit;
use std::fmt::{Display, Formatter};

/// A warning about an input. Its text is one sentence without a full stop.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Warning {
    /// Depths equal to a marker of missing measurements were left out.
    LeftOut {
        /// The value, in stored numbers.
        value: f64,
        /// Why it is no measurement.
        why: &'static str,
        /// Number of depths with this value.
        count: usize,
        /// Number of all depths.
        of: usize,
    },
    /// Depths have a value that may mark missing measurements. They were kept.
    Suspected {
        /// The value, in stored numbers.
        value: f64,
        /// Why it may be a marker.
        why: &'static str,
        /// Number of depths with this value.
        count: usize,
        /// Number of all depths.
        of: usize,
    },
    /// Integers were decoded as SUN RGB-D stores them.
    Rotated,
    /// Integers may be stored as in SUN RGB-D. They were kept unchanged.
    MaybeRotated,
    /// The median depth is implausible in the unit that was assumed.
    Unit {
        /// The assumed unit.
        unit: Unit,
        /// Resulting median in metres.
        median: f32,
    },
    /// A name denotes distances along the ray rather than depths.
    RayDistance {
        /// The name, or the data set that stores such distances.
        name: String,
    },
    /// A name denotes disparities or inverse depths.
    Inverse {
        /// The name.
        name: String,
    },
    /// All of many depths have the same value, as in a mask.
    Constant {
        /// The depth in metres.
        depth: f32,
        /// Number of depths.
        count: usize,
    },
    /// One of several arrays, channels, parts or pages was read.
    Chosen {
        /// Kind of the choices, such as `channel`.
        what: &'static str,
        /// Name of the choice that was read.
        name: String,
        /// The others.
        others: Vec<String>,
    },
    /// The raster is a window of a larger picture and was placed there.
    Window {
        /// Left, top, width and height of the window.
        window: [i64; 4],
        /// Width and height of the picture.
        picture: (usize, usize),
        /// Pixels of the window outside the picture.
        outside: usize,
    },
    /// An image is a window of a larger picture. It was used unchanged.
    Offset {
        /// Left and top of the window.
        position: [i64; 2],
    },
    /// The scale factor in a header was not applied.
    Scale(f64),
    /// An image uses a small part of its range and was stretched.
    Stretched {
        /// Value mapped to black.
        low: u16,
        /// Value mapped to white.
        high: u16,
    },
    /// An image uses a small part of its range. It was kept.
    Dark {
        /// Grey levels between the 0.1th and 99.9th percentiles, of 255.
        levels: u8,
    },
    /// Values of a floating-point image lie outside 0 to 1 and were clamped.
    Clamped {
        /// The largest value.
        highest: f32,
        /// The share of values outside 0 to 1.
        share: f64,
    },
}

impl Warning {
    /// Returns a warning that the first of `count` was read, if there are several.
    pub(crate) fn first(what: &'static str, count: usize) -> Option<Self> {
        /// Largest number of listed names.
        const MOST: usize = 1000;
        let others = (2..=count.min(MOST)).map(|number| number.to_string());
        Self::chosen(what, "1".to_owned(), others.collect())
    }

    /// Returns a warning that one choice was read, if there are others. `what` is their kind, such as `channel`.
    pub(crate) fn chosen(what: &'static str, name: String, others: Vec<String>) -> Option<Self> {
        (!others.is_empty()).then_some(Self::Chosen { what, name, others })
    }

    /// Whether it is about depths that may be distances along the ray, or inverse.
    pub fn is_of_kind(&self) -> bool {
        matches!(self, Self::RayDistance { .. } | Self::Inverse { .. })
    }
}

/// Returns a warning if the median depth in metres is implausible, for example if millimetres are taken for metres.
pub fn implausible_unit(unit: Unit, mut depths: Vec<f32>) -> Option<Warning> {
    /// Largest and smallest plausible median of the depths of an image.
    const FAR: f32 = 200.0;
    const NEAR: f32 = 0.02;
    if depths.is_empty() {
        return None;
    }
    let middle = depths.len() / 2;
    let median = *depths.select_nth_unstable_by(middle, f32::total_cmp).1;
    (!(NEAR..=FAR).contains(&median)).then_some(Warning::Unit { unit, median })
}

/// Returns a warning if many depths in metres are equal, as in a mask.
pub fn constant(mut depths: impl Iterator<Item = f32>) -> Option<Warning> {
    /// Fewer depths may well be equal.
    const MANY: usize = 100;
    let depth = depths.next()?;
    let mut count = 1;
    for other in depths {
        if other != depth {
            return None;
        }
        count += 1;
    }
    (count >= MANY).then_some(Warning::Constant { depth, count })
}

/// Formats a share in percent, with two digits if it is small.
fn percent(count: usize, of: usize) -> String {
    let share = 100.0 * count as f64 / of.max(1) as f64;
    if share >= 1.0 {
        format!("{share:.0} %")
    } else {
        format!("{share:.2} %")
    }
}

/// `1 depth (0.01 %) is` or `5 depths (10 %) are`.
fn depths(count: usize, of: usize) -> String {
    let (depths, are) = if count == 1 {
        ("depth", "is")
    } else {
        ("depths", "are")
    };
    format!("{count} {depths} ({}) {are}", percent(count, of))
}

/// `1 pixel` or `5 pixels`.
fn pixels(count: usize) -> String {
    format!("{count} pixel{}", if count == 1 { "" } else { "s" })
}

/// Formats a stored number with as many digits as it has.
fn number(value: f64) -> String {
    let value = value as f32;
    if value.abs() >= 1e7 {
        format!("{value:e}")
    } else {
        format!("{value}")
    }
}

impl Display for Warning {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::LeftOut {
                value,
                why,
                count,
                of,
            } => write!(
                f,
                "{} {}, {why}, and left out as no measurement",
                depths(*count, *of),
                number(*value),
            ),
            Self::Suspected {
                value,
                why,
                count,
                of,
            } => write!(
                f,
                "{} {}, {why}: if that marks missing measurements or background, set it to 0",
                depths(*count, *of),
                number(*value),
            ),
            Self::Rotated => write!(
                f,
                "all stored numbers are multiples of 8 and are decoded as in SUN RGB-D, millimetres whose bits are \
                 rotated left by 3; if they are plain millimetres, pass --depth-unit mm"
            ),
            Self::MaybeRotated => write!(
                f,
                "all stored numbers are multiples of 8: if they are coded as in SUN RGB-D, millimetres whose bits are \
                 rotated left by 3, leave out --depth-unit"
            ),
            Self::Unit { unit, median } => write!(
                f,
                "the median depth is {median} m if these are {unit}; --depth-unit says otherwise"
            ),
            Self::RayDistance { name } => write!(
                f,
                "{name} usually holds distances from the optical centre along the ray, but depths along the optical \
                 axis are assumed; --depth-kind ray with --camera converts them, --depth-kind z confirms depths"
            ),
            Self::Inverse { name } => write!(
                f,
                "{name} usually holds disparities or inverse depths, but depths are assumed; convert them (depth = \
                 focal length x baseline / disparity), or confirm depths by --depth-kind z"
            ),
            Self::Constant { depth, count } => {
                write!(f, "all {count} depths are {depth} m: is this a mask?")
            }
            Self::Chosen { what, name, others } => write!(
                f,
                "the {what} {name} is read, of {} {what}s; the others are {}",
                others.len() + 1,
                quoted(others),
            ),
            Self::Window {
                window: [left, top, width, height],
                picture,
                outside,
            } => {
                write!(
                    f,
                    "the data window, {width}x{height} at {left}, {top}, is placed in the display window of {}x{}",
                    picture.0, picture.1
                )?;
                if *outside > 0 {
                    write!(f, "; {} lie outside it and are left out", pixels(*outside))?;
                }
                Ok(())
            }
            Self::Offset {
                position: [left, top],
            } => write!(
                f,
                "the image is a window at {left}, {top} of a larger picture; points and camera are taken to refer to \
                 the pixels of the window"
            ),
            Self::Scale(scale) => write!(
                f,
                "the scale factor {scale} in the header is not applied; --depth-unit sets the unit"
            ),
            Self::Stretched { low, high } => write!(
                f,
                "the image uses a small part of the range of 16 bits: it is stretched, {low} to black and {high} to \
                 white"
            ),
            Self::Dark { levels } => write!(
                f,
                "the image is nearly uniform: {levels} of its 255 grey levels hold 99.8 % of the values; the contrast \
                 may be too low to guide the depth"
            ),
            Self::Clamped { highest, share } => write!(
                f,
                "{:.1} % of the values of the floating-point image lie outside 0 to 1 (the largest is {highest}) and \
                 are clamped; scale the image to 0 to 1",
                share * 100.0
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_of_a_mark_states_count_share_value_and_reason() {
        let warning = Warning::LeftOut {
            value: 65535.0,
            why: "the largest number of its type",
            count: 201,
            of: 1000,
        };
        assert_eq!(
            warning.to_string(),
            "201 depths (20 %) are 65535, the largest number of its type, and left out as no measurement"
        );
    }

    #[test]
    fn a_mask_is_doubted() {
        let mask = [1.0; 200];
        assert_eq!(
            constant(mask.into_iter()),
            Some(Warning::Constant {
                depth: 1.0,
                count: 200
            })
        );
        assert_eq!(constant(mask.into_iter().take(99)), None);
        assert_eq!(constant(mask.into_iter().chain([1.01])), None);
        assert_eq!(constant([].into_iter()), None);
    }

    #[test]
    fn a_median_of_kilometres_or_of_millimetres_is_implausible() {
        let has_warning = |depths: &[f32]| implausible_unit(Unit::METRE, depths.to_vec()).is_some();
        assert!(has_warning(&[1785.0, 2900.0, 6042.0]));
        assert!(has_warning(&[0.002, 0.004, 0.005]));
        assert!(!has_warning(&[1.7, 2.9, 6.0]) && !has_warning(&[]));
    }
}
