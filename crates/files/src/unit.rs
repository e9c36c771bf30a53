//! Units of stored depths.

use crate::error::{Error, Result};
use std::fmt::{Display, Formatter};
use std::str::FromStr;

/// Number of stored units per metre, if known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit(Option<f64>);

impl Unit {
    /// Metres.
    pub const METRE: Self = Self(Some(1.0));
    /// Millimetres, the unit of most 16-bit depth images.
    pub const MILLIMETRE: Self = Self(Some(1000.0));
    /// Unit of a reconstruction from images alone, whose scale is unknown. It is kept.
    pub const MODEL: Self = Self(None);

    /// Names of units, and units per metre. Those of KITTI, TUM and Virtual KITTI 2 are from their development kits.
    const NAMED: [(&'static str, f64); 6] = [
        ("m", 1.0),
        ("cm", 100.0),
        ("mm", 1000.0),
        ("kitti", 256.0),
        ("tum", 5000.0),
        ("vkitti", 100.0),
    ];

    /// Returns the unit with this number of units per metre, if it is a positive number.
    pub fn per_metre(count: f64) -> Option<Self> {
        (count > 0.0 && count.is_finite()).then_some(Self(Some(count)))
    }

    /// Returns the unit of depths after reading: metres, or the unit of the model.
    pub fn of_depths(self) -> &'static str {
        self.0.map_or("units", |_| "m")
    }

    /// Returns the factor from stored numbers to depths: metres per unit, or 1 if unknown.
    pub fn metres(self) -> f64 {
        self.0.map_or(1.0, |count| 1.0 / count)
    }
}

impl FromStr for Unit {
    type Err = Error;

    /// Parses a name, or a number of units per metre.
    fn from_str(text: &str) -> Result<Self> {
        if let Some((_, count)) = Self::NAMED.iter().find(|(name, _)| *name == text) {
            return Ok(Self(Some(*count)));
        }
        let count = text.parse().ok().and_then(Self::per_metre);
        count.ok_or_else(|| {
            Error::config(format!("`{text}` is no unit of depth"))
                .hint("m, cm, mm, kitti, tum, vkitti, or how many units make a metre, as in 256")
        })
    }
}

impl Display for Unit {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            None => write!(f, "model units"),
            Some(1.0) => write!(f, "metres"),
            Some(100.0) => write!(f, "centimetres"),
            Some(1000.0) => write!(f, "millimetres"),
            Some(count) => write!(f, "1/{count} m"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_named_or_counted() {
        for (text, metres) in [("mm", 0.001), ("kitti", 1.0 / 256.0), ("5000", 0.0002)] {
            assert!((text.parse::<Unit>().unwrap().metres() - metres).abs() < 1e-12);
        }
        for text in ["", "inch", "0", "-1", "inf", "nan"] {
            assert!(text.parse::<Unit>().is_err(), "{text}");
        }
    }
}
