//! The size of a frame in pixels.

use crate::data::DepthMap;
use serde::{Deserialize, Serialize};
use std::fmt::{Display, Formatter};

/// Rows and columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Size {
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
}

impl Size {
    /// The size of a map.
    pub(crate) fn of(map: &DepthMap) -> Self {
        Self {
            height: map.height(),
            width: map.width(),
        }
    }
}

impl Display for Size {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.height, self.width)
    }
}
