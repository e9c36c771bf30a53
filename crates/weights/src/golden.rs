//! Results that the weights of the program are known to give.

use crate::known::sha256;
use std::sync::LazyLock;

/// Depth maps, standard deviations and scores for rooms, and a guide by a tiny network: `tests/golden_depths.rs` of the
/// program fails if it computes others, until this file is updated.
static RESULTS: &[u8] = include_bytes!("../golden/depths.safetensors");

/// Identifies what this version computes, by results that it is known to compute: a change of numerics changes it, a
/// change of code or version does not. Results that were kept can be used again if it and the instruction set are the
/// same.
///
/// ```
/// assert_eq!(lsdc_weights::golden().len(), 64);
/// ```
pub fn golden() -> &'static str {
    static IDENTITY: LazyLock<String> = LazyLock::new(|| sha256(RESULTS));
    &IDENTITY
}
