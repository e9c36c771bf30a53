//! Weights that are part of this library.

#[cfg(feature = "weights")]
use lsdc_core::weights::{DEFAULT, SMALL};
use lsdc_core::{Result, Weights};

/// Weights that come with the program.
#[derive(Clone, Copy, Debug)]
pub struct Embedded {
    /// What `--weights` takes.
    pub name: &'static str,
    /// What they are for.
    pub about: &'static str,
    /// Under which licence, by its SPDX expression: what they contain of other networks keeps its own.
    pub licence: &'static str,
    /// A safetensors file.
    pub bytes: &'static [u8],
}

#[cfg(feature = "weights")]
static EMBEDDED: [Embedded; 3] = [
    Embedded {
        name: "default",
        about: "the most accurate that needs nothing installed",
        licence: "Apache-2.0",
        bytes: DEFAULT,
    },
    Embedded {
        name: "small",
        about: "for weak machines; two thirds of the time",
        licence: "Apache-2.0",
        bytes: SMALL,
    },
    Embedded {
        name: "anything",
        about: "the most accurate of all, on top of a pretrained encoder that is installed apart",
        licence: "MIT OR Apache-2.0",
        bytes: include_bytes!("../weights/anything.safetensors"),
    },
];
#[cfg(not(feature = "weights"))]
static EMBEDDED: [Embedded; 0] = [];

impl Embedded {
    /// Reads the weights.
    ///
    /// # Errors
    /// None: the tests read all of them.
    pub fn read(&self) -> Result<Weights> {
        Weights::from_bytes(self.bytes)
    }
}

/// Returns the weights of this library, the default first; none without the feature `weights`.
pub fn embedded() -> &'static [Embedded] {
    &EMBEDDED
}

/// Returns the weights of this library that have a name.
pub fn named(name: &str) -> Option<&'static Embedded> {
    EMBEDDED.iter().find(|weights| weights.name == name)
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
}
