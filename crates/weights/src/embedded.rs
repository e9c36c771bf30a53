//! Weights built into this library.

#[cfg(feature = "weights")]
use super::from_safetensors;
#[cfg(feature = "weights")]
use super::names::RESIZE_LAYER;
#[cfg(feature = "weights")]
use lsdc_core::weights::DEFAULT;
#[cfg(feature = "weights-small")]
use lsdc_core::weights::SMALL;
use lsdc_core::weights::Tensor;
use lsdc_core::{Result, Weights};
#[cfg(feature = "weights")]
use std::path::Path;

/// Weights built into the program.
#[derive(Clone, Copy, Debug)]
pub struct Embedded {
    /// Argument of `--weights`.
    pub name: &'static str,
    /// Purpose of the weights.
    pub about: &'static str,
    /// Licence, as an SPDX expression; parts from other networks keep their own.
    pub licence: &'static str,
    /// Contents of a safetensors file.
    pub bytes: &'static [u8],
}

/// Weights of the enabled features.
static EMBEDDED: &[Embedded] = &[
    #[cfg(feature = "weights")]
    Embedded {
        name: "default",
        about: "the most accurate that needs nothing installed",
        licence: "Apache-2.0",
        bytes: DEFAULT,
    },
    #[cfg(feature = "weights-small")]
    Embedded {
        name: "small",
        about: "for weak machines; two thirds of the time",
        licence: "Apache-2.0",
        bytes: SMALL,
    },
    #[cfg(feature = "weights")]
    Embedded {
        name: "anything",
        about: "the most accurate of all, on top of a pretrained encoder that is installed apart",
        licence: "MIT OR Apache-2.0",
        bytes: include_bytes!("../weights/anything.safetensors"),
    },
];

/// Tensor of the depth head of Depth Anything V2 Small that was trained by the authors of lsdc.
#[cfg(feature = "weights")]
static DEPTH_HEAD: &[u8] = include_bytes!("../weights/depth_head.safetensors");

impl Embedded {
    /// Reads the weights.
    ///
    /// # Errors
    /// None: the tests read all of them.
    pub fn read(&self) -> Result<Weights> {
        Weights::from_bytes(self.bytes)
    }
}

/// Returns the weights of this library, the default first. Without the feature `weights`, only `small` if `weights-small`
/// is enabled.
pub fn embedded() -> &'static [Embedded] {
    EMBEDDED
}

/// Returns the weights of this library with a name.
pub fn named(name: &str) -> Option<&'static Embedded> {
    EMBEDDED.iter().find(|weights| weights.name == name)
}

/// Returns the tensor `depth_head.resize_layers.3.weight` of this library; `None` without the feature `weights`.
pub(super) fn resize_layer() -> Option<Tensor> {
    #[cfg(feature = "weights")]
    {
        // The tests read it.
        let all = from_safetensors(Path::new("depth_head.safetensors"), DEPTH_HEAD).ok();
        all?.remove(RESIZE_LAYER)
    }
    #[cfg(not(feature = "weights"))]
    None
}

#[cfg(all(test, feature = "weights"))]
mod tests {
    use super::*;

    #[test]
    fn all_weights_can_be_read_by_name() {
        for weights in embedded() {
            let read = named(weights.name).unwrap().read().unwrap();
            let on_encoder = read.network.extractor.encoder > 0;
            assert_eq!(on_encoder, weights.name == "anything");
        }
        assert!(named("huge").is_none());
    }

    #[test]
    fn the_tensor_of_the_depth_head_can_be_read() {
        let tensor = resize_layer().unwrap();
        assert_eq!(tensor.shape(), [384, 384, 3, 3]);
        assert!(tensor.values().iter().all(|v| v.is_finite()));
    }
}
