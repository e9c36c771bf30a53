//! Values that are computed on first use.

use std::sync::OnceLock;

/// The value, computed on first use. Not within the initialiser of the cell: a thread that waits there may steal a task that
/// needs the same value.
pub(crate) fn get_or_compute<T>(cell: &OnceLock<T>, compute: impl FnOnce() -> T) -> &T {
    cell.get().unwrap_or_else(|| {
        let value = compute();
        cell.get_or_init(|| value)
    })
}
