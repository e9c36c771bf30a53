//! Values that are computed on first use.

use std::sync::OnceLock;

/// Returns the value, computed on first use. It is computed outside the initialiser of the cell, because a thread that waits in
/// it may steal a task that needs the same value.
pub(crate) fn get_or_compute<T>(cell: &OnceLock<T>, compute: impl FnOnce() -> T) -> &T {
    cell.get().unwrap_or_else(|| {
        let value = compute();
        cell.get_or_init(|| value)
    })
}
