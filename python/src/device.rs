//! The device of a network: the CPU, or a GPU if the package is built with the feature `gpu`.

use crate::error::{ExceptionKind, raised_by_file};
use lsdc_core::Weights;
use lsdc_core::network::Network;
use lsdc_files::error::{Error, Result};
use pyo3::prelude::*;
use std::sync::Arc;

/// Checks the name of a device, without opening it.
///
/// # Errors
/// The name is unknown, or names a GPU and this package was built without GPUs.
#[pyfunction]
pub(crate) fn check_device(py: Python<'_>, name: &str) -> PyResult<()> {
    if name == "cpu" {
        return Ok(());
    }
    check_gpu(name).map_err(|error| raised_by_file(py, &error))
}

/// Prepares the network of weights for a device by name. `None` for the CPU.
///
/// # Errors
/// There is no such device, or it does not run this network.
pub(crate) fn on_device(
    py: Python<'_>,
    weights: &Weights,
    device: &str,
) -> PyResult<Option<Arc<dyn Network>>> {
    check_device(py, device)?;
    if device == "cpu" {
        return Ok(None);
    }
    let network = py.detach(|| gpu_network(weights, device));
    let network = network.map_err(|error| raised_by_file(py, &error))?;
    if network.is_none() {
        let what = format!("`{device}` does not run the network of these weights");
        let hint = "use the device \"cpu\"";
        return Err(ExceptionKind::Weights.raise(py, &what, Some(hint)));
    }
    Ok(network)
}

#[cfg(feature = "gpu")]
fn check_gpu(name: &str) -> Result<()> {
    name.parse::<lsdc_gpu::Adapter>()
        .map(|_| ())
        .map_err(|error| {
            let hint = format!("{}, and the CPU is cpu", error.hint());
            Error::device(error.to_string()).hint(hint)
        })
}

#[cfg(feature = "gpu")]
fn gpu_network(weights: &Weights, name: &str) -> Result<Option<Arc<dyn Network>>> {
    let network = lsdc_weights::gpu_network(weights, name, true)?;
    Ok(network.map(|network| Arc::new(network) as Arc<dyn Network>))
}

#[cfg(not(feature = "gpu"))]
fn check_gpu(name: &str) -> Result<()> {
    let (kind, _) = name.split_once(':').unwrap_or((name, ""));
    Err(if kind == "wgpu" {
        let what = format!("this package was built without GPUs: there is no device `{name}`");
        Error::device(what).hint(
            "`pip install ./python --config-settings build-args=\"--features gpu\"` installs one with GPUs",
        )
    } else {
        Error::device(format!("unknown device `{name}`")).hint("this package has the device cpu")
    })
}

#[cfg(not(feature = "gpu"))]
fn gpu_network(_: &Weights, name: &str) -> Result<Option<Arc<dyn Network>>> {
    check_gpu(name).map(|()| None)
}
