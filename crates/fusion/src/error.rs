//! Errors of fusion.

/// A result with this error.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Why frames cannot be fused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting is out of range.
    #[error("the setting `{setting}` is not {expected}")]
    Setting {
        /// Name of the setting.
        setting: &'static str,
        /// The allowed values.
        expected: &'static str,
    },
    /// Depths, standard deviations and image of a frame have different sizes.
    #[error("the depths are {depth:?} but the {other} {found:?}")]
    Sizes {
        /// Width and height of the depths.
        depth: (usize, usize),
        /// Name of the map with another size.
        other: &'static str,
        /// Its width and height, or its number of values and 1.
        found: (usize, usize),
    },
    /// No pixel of a frame is usable, so the size of the voxels is unknown.
    #[error("no pixel has a depth that can be fused")]
    NoPixels,
    /// No frame was given.
    #[error("there is no frame to make a surface from")]
    NoFrames,
    /// The blocks need more memory than allowed.
    #[error("voxels of {edge:.3} take {needed:.1} MiB, and {most:.1} MiB are allowed")]
    Memory {
        /// The edge length of a voxel.
        edge: f64,
        /// MiB needed for all existing blocks and those of this frame.
        needed: f64,
        /// Limit in MiB.
        most: f64,
    },
    /// The surface has more vertices than a file can store.
    #[error("the surface has {count} vertices, and a mesh at most 2^32")]
    TooLarge {
        /// Number of vertices.
        count: usize,
    },
    /// An image or camera cannot be used.
    #[error(transparent)]
    Core(#[from] lsdc_core::Error),
}

impl Error {
    /// A suggestion, if there is one.
    pub fn hint(&self) -> Option<&str> {
        match self {
            Self::Memory { .. } | Self::TooLarge { .. } => {
                Some("use larger voxels, a smaller largest depth, or allow more memory")
            }
            Self::NoPixels => {
                Some("check the unit of the depths and the limits of depth and deviation")
            }
            Self::NoFrames => Some("add at least one frame"),
            Self::Core(error) => error.hint(),
            Self::Setting { .. } | Self::Sizes { .. } => None,
        }
    }
}
