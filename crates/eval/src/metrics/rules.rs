//! Parameters of the metrics.

use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Parameters of the metrics.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rules {
    /// Lower bound of predictions, in metres, in ratios, logarithms and inverses.
    pub floor: f64,
    /// Side length in pixels of the window of the soft edge error.
    pub see_window: usize,
    /// Smallest ratio of true depths of a pixel and one of its four neighbours, in either direction, at an edge.
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
