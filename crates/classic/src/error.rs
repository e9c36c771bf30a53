//! Errors of the methods.

/// The result of a method.
pub type Result<T> = std::result::Result<T, Error>;

/// Why a method has no result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// There is no point.
    #[error("there is no sparse depth to interpolate")]
    NoPoints,
    /// The linear system of the pixels is singular.
    #[error("the linear system of the pixels cannot be solved")]
    Singular,
    /// The thin-plate spline is not finite.
    #[error("the thin-plate spline through these points is not finite")]
    Spline,
    /// The result is not a valid depth map.
    #[error(transparent)]
    Map(#[from] lsdc_core::Error),
}

impl Error {
    /// A suggestion, if there is one.
    pub fn hint(&self) -> Option<&str> {
        match self {
            Self::NoPoints => Some("give at least one pixel a positive, finite depth"),
            Self::Singular => {
                Some("the image may be too large for a direct solver; use another method")
            }
            Self::Spline => Some("the points may coincide; use another method"),
            Self::Map(error) => error.hint(),
        }
    }
}
