//! Why frames cannot be fused.

/// A result with this error.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Frames cannot be fused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting is out of range.
    #[error("the setting `{setting}` is not {expected}")]
    Setting {
        /// Its name.
        setting: &'static str,
        /// The values that are possible.
        expected: &'static str,
    },
    /// Depths, standard deviations and image of a frame have different sizes.
    #[error("the depths are {depth:?} but the {other} {found:?}")]
    Sizes {
        /// Width and height of the depths.
        depth: (usize, usize),
        /// What has another size.
        other: &'static str,
        /// Its width and height, or its number of values and 1.
        found: (usize, usize),
    },
    /// No pixel of a frame can be used, so that the size of the voxels is unknown.
    #[error("no pixel has a depth that can be fused")]
    NoPixels,
    /// There is no frame.
    #[error("there is no frame to make a surface from")]
    NoFrames,
    /// The blocks take more memory than they may.
    #[error("voxels of {edge:.3} take {needed:.1} MiB, and {most:.1} MiB are allowed")]
    Memory {
        /// The edge length of a voxel.
        edge: f64,
        /// MiB for all blocks so far and those of this frame.
        needed: f64,
        /// MiB at most.
        most: f64,
    },
    /// The surface has more vertices than a file can have.
    #[error("the surface has {count} vertices, and a mesh at most 2^32")]
    TooLarge {
        /// Vertices.
        count: usize,
    },
    /// An image or camera cannot be used.
    #[error(transparent)]
    Core(#[from] lsdc_core::Error),
}

impl Error {
    /// Advice, if there is any.
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
