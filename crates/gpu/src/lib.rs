//! The network of `lsdc-core` on GPUs: through Vulkan, Metal or DirectX 12, within the limits that every WebGPU device has.
//!
//! The layers are recorded once for each size of images as a list of launches (`plan`), with normalisation, skip connections,
//! enlargement and ReLU in the launch of the convolution before them. So are those of a pretrained encoder and of its depth
//! head (`encoder`): a block is five launches, and no score of its attention is stored. All maps of a plan share one buffer,
//! all weights another. An image is one upload, the points another; affinities and basis functions at the points come back,
//! and with the weights of the fit, which stays on the CPU, the map. [`Traffic`] counts all of it.
//!
//! ```no_run
//! use lsdc_core::{Completer, Weights};
//! use lsdc_gpu::{Adapter, Gpu, GpuNetwork};
//! use std::sync::Arc;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let weights = Weights::builtin();
//! let gpu = Gpu::open(Adapter::Best)?;
//! let network = GpuNetwork::new(&weights, &gpu)?;
//! let completer = Completer::builder(&weights).network(Arc::new(network)).build()?;
//! # let _ = completer;
//! # Ok(())
//! # }
//! ```

mod device;
mod encoder;
mod head;
mod kernel;
mod memory;
mod network;
mod plan;
#[cfg(test)]
mod tests;
mod traffic;
mod weights;

pub use device::{Adapter, Gpu, GpuError};
pub use encoder::Pretrained;
pub use network::{GpuNetwork, supports};
pub use traffic::{Part, Traffic};
