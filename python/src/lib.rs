//! The extension module of the Python package `lsdc`: `lsdc-core` and `lsdc-files` with `NumPy` arrays.
//!
//! The Python files of the package convert arguments of any kind to contiguous arrays of one type, positions in pixels and
//! depths in one unit. This crate converts them to values of `lsdc-core`, and results to arrays. It releases the interpreter
//! while it computes.

mod alignment;
mod arrays;
mod camera;
mod checks;
mod completer;
mod completion;
mod device;
mod error;
mod files;
mod guide;
mod image;
mod observations;
mod pool;
mod scene;
mod settings;
mod views;

use pyo3::{pyfunction, pymodule};

/// Returns the identifier of the numerics of this version.
#[pyfunction]
fn golden() -> &'static str {
    lsdc_weights::golden()
}

/// The module `lsdc._native`.
#[pymodule(gil_used = false)]
mod _native {
    #[pymodule_export]
    use crate::alignment::Alignment;
    #[pymodule_export]
    use crate::camera::Camera;
    #[pymodule_export]
    use crate::checks::{eight_bits, without_marks};
    #[pymodule_export]
    use crate::completer::Completer;
    #[pymodule_export]
    use crate::completion::Completion;
    #[pymodule_export]
    use crate::device::check_device;
    #[pymodule_export]
    use crate::files::{Colmap, read_depth, read_image, read_points};
    #[pymodule_export]
    use crate::golden;
    #[pymodule_export]
    use crate::guide::DepthGuide;
    #[pymodule_export]
    use crate::observations::Observations;
    #[pymodule_export]
    use crate::scene::Scene;
    #[pymodule_export]
    use crate::views::{PosedView, neighbours};
    #[pymodule_export]
    #[allow(non_upper_case_globals)]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
