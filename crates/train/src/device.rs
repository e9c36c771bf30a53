//! Compute devices by name.

pub use burn::tensor::Device;
use lsdc_files::error::{Error, Result};
#[cfg(feature = "wgpu")]
use lsdc_gpu::{Adapter, Gpu, GpuError};
#[cfg(feature = "wgpu")]
use std::collections::BTreeMap;
#[cfg(feature = "wgpu")]
use std::sync::{Mutex, PoisonError};

/// Returns the device names available in this build.
pub fn names() -> Vec<&'static str> {
    let mut names = vec!["cpu"];
    if cfg!(feature = "ndarray") {
        names.push("ndarray");
    }
    if cfg!(feature = "wgpu") {
        names.extend(["wgpu", "wgpu:N", "wgpu:integrated", "wgpu:software"]);
    }
    names
}

/// Opens a device: `cpu` (burn's flex), `ndarray`, `wgpu` (the best GPU), `wgpu:N` (discrete GPU N),
/// `wgpu:integrated`, `wgpu:software`.
///
/// # Errors
/// An unknown name, or a device that this machine does not have.
pub fn device(name: &str) -> Result<Device> {
    let (kind, which) = name.split_once(':').unwrap_or((name, ""));
    match kind {
        "cpu" if which.is_empty() => Ok(Device::flex()),
        #[cfg(feature = "ndarray")]
        "ndarray" if which.is_empty() => Ok(ndarray()),
        #[cfg(feature = "wgpu")]
        "wgpu" => wgpu(name),
        #[cfg(not(feature = "wgpu"))]
        "wgpu" => Err(without(name, "wgpu")),
        #[cfg(not(feature = "ndarray"))]
        "ndarray" if which.is_empty() => Err(without(name, "ndarray")),
        _ => Err(Error::device(format!("unknown device `{name}`"))
            .hint(format!("devices of this build: {}", names().join(", ")))),
    }
}

/// Returns the error for a device that is not part of this build, with the command that includes it.
#[cfg(not(all(feature = "wgpu", feature = "ndarray")))]
fn without(name: &str, feature: &str) -> Error {
    Error::device(format!("this build has no device `{name}`")).hint(format!(
        "`cargo build --release --features {feature}` makes one that has, `cargo install --path . \
         --features {feature}` installs it"
    ))
}

/// Opens several devices, separated by commas.
///
/// # Errors
/// The errors of [`device`], for the first device that cannot be opened.
pub fn devices(names: &str) -> Result<Vec<Device>> {
    names.split(',').map(|name| device(name.trim())).collect()
}

#[cfg(feature = "ndarray")]
fn ndarray() -> Device {
    Device::ndarray()
}

/// Opened devices by name. A process opens a device once; burn refuses a second time.
#[cfg(feature = "wgpu")]
static OPENED: Mutex<BTreeMap<String, (Device, Adapter)>> = Mutex::new(BTreeMap::new());

/// Returns whether a device is a GPU, or a software driver for one, that [`device`] opened.
pub fn is_gpu(device: &Device) -> bool {
    #[cfg(feature = "wgpu")]
    {
        let opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
        opened.values().any(|(known, _)| known == device)
    }
    #[cfg(not(feature = "wgpu"))]
    {
        let _ = device;
        false
    }
}

/// Returns the GPU for prepared networks that corresponds to a device; `None` if the device is not a GPU.
///
/// # Errors
/// The GPU cannot be opened a second time.
#[cfg(feature = "wgpu")]
pub fn gpu(device: &Device) -> Result<Option<Gpu>> {
    let opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
    let adapter = opened.values().find(|(known, _)| known == device);
    let gpu = adapter.map(|&(_, adapter)| Gpu::shared(adapter));
    gpu.transpose().map_err(failed)
}

#[cfg(feature = "wgpu")]
fn failed(error: GpuError) -> Error {
    let hint = error.hint();
    Error::device(error.to_string()).hint(hint)
}

#[cfg(feature = "wgpu")]
fn wgpu(name: &str) -> Result<Device> {
    use burn::tensor::DeviceKind;

    let adapter: Adapter = name.parse().map_err(failed)?;
    let kind = match adapter {
        Adapter::Best => DeviceKind::DefaultDevice,
        Adapter::Discrete(number) => DeviceKind::DiscreteGpu(number),
        Adapter::Integrated => DeviceKind::IntegratedGpu(0),
        Adapter::Software => DeviceKind::Cpu,
    };
    let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(known) = opened.get(name) {
        return Ok(known.0.clone());
    }
    let device = Device::wgpu_options()
        .device_kind(kind)
        .init()
        .map_err(|e| {
            Error::device(format!("no device `{name}` can be opened"))
                .because(e)
                .hint("check the graphics driver (`vulkaninfo --summary`), or use `--device cpu`")
        })?;
    opened.insert(name.to_owned(), (device.clone(), adapter));
    Ok(device)
}

#[cfg(all(test, not(feature = "wgpu")))]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_was_not_built_names_the_command_that_builds_it() {
        for name in ["wgpu", "wgpu:1", "wgpu:software"] {
            let error = device(name).unwrap_err();
            assert!(error.to_string().contains(name), "{error}");
            assert!(
                error.advice().unwrap().contains("--features wgpu"),
                "{error}"
            );
        }
        assert!(
            device("cuda")
                .unwrap_err()
                .advice()
                .unwrap()
                .contains("cpu")
        );
        assert!(device("cpu").is_ok());
    }
}
