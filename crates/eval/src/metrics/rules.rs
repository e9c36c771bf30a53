//! What the definitions of the measures leave open.

use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// What the measures leave open.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rules {
    /// Predictions below this many metres count as this in ratios, logarithms and inverses.
    pub floor: f64,
    /// Pixels on a side of the window of the soft edge error.
    pub see_window: usize,
    /// A pixel is at an edge where the ratio of its true depth to that of one of its four
    /// neighbours, or the inverse, is above this.
    pub see_jump: f64,
}

impl Default for Rules {
    fn default() -> Self {
        Self {
            floor: 1e-3,
            see_window: 3,
            see_jump: 1.05,
        }
    }
}

impl Rules {
    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<()> {
        let fine = self.floor > 0.0 && self.see_window % 2 == 1 && self.see_jump > 1.0;
        fine.then_some(()).ok_or_else(|| {
            Error::config("`metrics`: floor must be above 0, see_window odd, and see_jump above 1")
        })
    }
}

impl std::fmt::Display for Rules {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            floor,
            see_window: k,
            see_jump,
        } = self;
        write!(
            f,
            "per frame over pixels with a true depth, then over frames; predictions of at least \
             {floor} m in ratios and inverses; SEE_{k} where neighbours differ by a factor above \
             {see_jump}"
        )
    }
}
