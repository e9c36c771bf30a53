//! The parts of a computation.

/// The parts of a computation, between which it can stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Part {
    /// Image, camera and points from their files.
    Read,
    /// The network, on the image alone.
    Network,
    /// The fit to the points.
    Fit,
    /// The dense depth.
    Depth,
    /// The standard deviation of every pixel.
    Deviation,
    /// What the points say of each other.
    Judge,
    /// The bytes of the answer.
    Encode,
}

impl Part {
    /// The name in metrics and traces.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Network => "network",
            Self::Fit => "fit",
            Self::Depth => "depth",
            Self::Deviation => "standard-deviation",
            Self::Judge => "judge",
            Self::Encode => "encode",
        }
    }
}
