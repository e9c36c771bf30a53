//! The formats of a result, and what they make of it.

use crate::cli::args::{Complete, Format};
use lsdc_eval::data::{Cloud, Unit};

/// What is written without `--formats`.
const USUAL: [Format; 3] = [Format::Npy, Format::Png, Format::Color];

/// The formats that are asked for.
pub(super) fn formats(args: &Complete) -> &[Format] {
    args.formats.as_deref().unwrap_or(&USUAL)
}

/// What the formats make of a result, and what is lost with it.
#[derive(Default)]
pub(super) struct Forms {
    /// Depths of the first and the last colour of a colour map.
    pub(super) range: Option<(f32, f32)>,
    pub(super) png: Option<Png>,
    pub(super) cloud: Option<Cloud>,
}

/// A 16-bit PNG.
#[derive(Clone, Copy)]
pub(super) struct Png {
    pub(super) unit: Unit,
    /// Pixels nearer than half a unit, which are written as one.
    pub(super) raised: usize,
}
