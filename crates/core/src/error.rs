//! The errors of this crate, by operation.

/// The result of this crate's operations.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// Any error of this crate.
///
/// The message says what is wrong and where; [`Error::hint`] often suggests a remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An image, map or buffer cannot be used.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Weights cannot be read or do not match their network.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The fit has no solution.
    #[error(transparent)]
    Fit(#[from] FitError),
}

impl Error {
    /// A suggestion for what to do, if there is one.
    pub fn hint(&self) -> Option<&str> {
        match self {
            Self::Image(ImageError::TooBright { .. }) => Some("give floats from 0 to 1, or bytes"),
            Self::Image(_) => None,
            Self::Weights(error) => error.hint(),
            Self::Settings(error) => error.hint.as_deref(),
            Self::Fit(error) => error.hint(),
        }
    }
}

/// An image, map or buffer cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// A side is 0, or there are more pixels than [`MAX_PIXELS`](crate::MAX_PIXELS).
    #[error("{width}x{height} is not a size of images that can be used")]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// Rows overlap.
    #[error("rows {stride} values apart cannot hold {row} values each")]
    Stride {
        /// Values from one row to the next.
        stride: usize,
        /// Values of a row.
        row: usize,
    },
    /// The buffer ends before the last pixel, or is longer than a map without gaps.
    #[error("a buffer of {found} values does not hold the {expected} of {width}x{height} pixels")]
    Length {
        /// Number of values needed.
        expected: usize,
        /// Number of values found.
        found: usize,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// A guide is constant.
    #[error("the guide says nothing: all of its values are missing or the same")]
    NoGuide,
    /// A colour of a float image is far above 1.
    #[error("the colour at column {x}, row {y} is {value}, but 1 is white")]
    TooBright {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
        /// The colour.
        value: f32,
    },
    /// A colour is NaN or infinite.
    #[error("the colour at column {x}, row {y} is not finite")]
    NotFinite {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
}

/// Weights cannot be read or do not match their network.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WeightsError {
    /// The file cannot be read.
    #[error("cannot read weights from `{path}`")]
    Read {
        /// The path.
        path: std::path::PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The bytes are not a safetensors file.
    #[error("the weights are not a safetensors file")]
    Format(#[source] safetensors::SafeTensorError),
    /// A metadata record on the network, preprocessing or fit is missing or cannot be parsed.
    #[error("the weights have no usable `{name}` record: {reason}")]
    Record {
        /// The key of the record.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A tensor is missing, unexpected, damaged or of the wrong shape.
    #[error("the weights do not belong to their network: `{name}` {reason}")]
    Tensor {
        /// The name of the tensor.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The prior over the weights of the basis functions is damaged or belongs to other basis functions.
    #[error("the prior over the weights of basis functions {0}")]
    Prior(String),
    /// The network was trained on top of a pretrained encoder, which was not given.
    #[error("the network reads the features of a pretrained encoder, which was not given")]
    NoEncoder,
    /// The file requires a feature that this version no longer has.
    #[error("the weights have {what}, which lsdc supported until {until}")]
    Removed {
        /// What was removed.
        what: &'static str,
        /// The last version that had it.
        until: &'static str,
    },
    /// This kind of network is not supported here.
    #[error("this network cannot be prepared: {0}")]
    Unsupported(&'static str),
}

impl WeightsError {
    fn hint(&self) -> Option<&str> {
        match self {
            Self::Format(_) | Self::Record { .. } => {
                Some("weights are written by `lsdc train` as `weights.safetensors`")
            }
            Self::Tensor { .. } | Self::Prior(_) => {
                Some("the file is damaged or was edited; train or download it again")
            }
            Self::NoEncoder => Some("give it to `CompleterBuilder::encoder`"),
            Self::Removed { .. } => Some("use that version, or train weights without"),
            Self::Read { .. } | Self::Unsupported(_) => None,
        }
    }

    pub(crate) fn record(name: &str, reason: impl ToString) -> Self {
        Self::Record {
            name: name.to_owned(),
            reason: reason.to_string(),
        }
    }

    pub(crate) fn tensor(name: &str, reason: impl Into<String>) -> Self {
        Self::Tensor {
            name: name.to_owned(),
            reason: reason.into(),
        }
    }
}

/// A setting is out of range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct SettingsError {
    message: String,
    hint: Option<String>,
}

impl SettingsError {
    /// `message` is one sentence that names the setting, without a full stop.
    pub fn new(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            hint: None,
        }
    }

    /// Adds a suggestion for what to do.
    #[must_use]
    pub fn with_hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }
}

/// The fit has no solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FitError {
    /// There is no usable observation.
    #[error(
        "there is no sparse depth to fit: of {given} observations {invalid} have no depth that can be \
         used, {outside} are outside the image"
    )]
    NoObservations {
        /// Number of observations given.
        given: usize,
        /// Number of observations whose depth or position is NaN, infinite or not positive.
        invalid: usize,
        /// Number of observations outside the image.
        outside: usize,
    },
    /// Basis functions, affinities or depths are NaN or infinite.
    #[error("basis functions, affinities or depths are not finite")]
    NotFinite,
    /// A standard deviation is NaN, infinite or not positive.
    #[error("a standard deviation is not a positive, finite number")]
    StandardDeviation,
    /// The lengths of arrays do not match.
    #[error("{0}")]
    Shape(String),
    /// A position is outside the image.
    #[error("({u}, {v}) is not in the image of {width}x{height} pixels")]
    Outside {
        /// Column.
        u: f64,
        /// Row.
        v: f64,
        /// Columns of the image.
        width: usize,
        /// Rows of the image.
        height: usize,
    },
    /// The fit needs a prior that the weights do not contain.
    #[error("{0}")]
    NoPrior(&'static str),
    /// The fit needs affinities between the pixels of the image.
    #[error("`fit.method = \"{0}\"` needs the image that the points lie in")]
    NoAffinities(&'static str),
    /// A decomposition failed.
    #[error("the fit cannot be solved: {0}")]
    Unsolvable(&'static str),
    /// Weights of another fit belong to other basis functions.
    #[error(
        "weights of {found} functions are not those of another fit of these {expected} basis functions and \
         cosines"
    )]
    OtherWeights {
        /// Number of basis functions and cosines of this fit; of both fits at [`Quality::Best`](crate::Quality::Best).
        expected: usize,
        /// Number of given weights.
        found: usize,
    },
    /// Weights of another fit are all 0, or not finite.
    #[error("the weights of the other fit are all 0, or not finite")]
    NearNothing,
    /// A fit without a learned prior cannot be drawn towards another fit.
    #[error(
        "a fit without the learned prior over weights of depths cannot be drawn towards another one"
    )]
    NearWithoutPrior,
    /// The points do not determine the requested quantity.
    #[error("{0}")]
    TooFewPoints(&'static str),
}

impl FitError {
    fn hint(&self) -> Option<&str> {
        match self {
            Self::NoObservations { .. } => {
                Some("give at least one place in the image a positive, finite depth")
            }
            Self::NotFinite => Some("the weights of the network may be damaged"),
            Self::StandardDeviation => Some("give every depth its standard deviation in metres"),
            Self::NoPrior(_) => Some("set `fit.prior` to \"flat\" or \"none\""),
            Self::Unsolvable(_) => Some(
                "basis functions, affinities or depths are not finite, or differ by too many orders of magnitude",
            ),
            Self::TooFewPoints(_) => {
                Some("give more points, or choose another fit (`fit.method = \"lse\"`)")
            }
            Self::Outside { .. } => Some(
                "places count in pixels from the centre of the first: from -0.5 to the length - 0.5",
            ),
            Self::OtherWeights { .. } => {
                Some("take `Completion::weights` of a completion by the same weights and settings")
            }
            Self::NearNothing => Some("complete this image without them"),
            Self::NearWithoutPrior => {
                Some("set `fit.prior` to \"learned\" and `fit.method` to \"lse\" or \"joint\"")
            }
            Self::Shape(_) | Self::NoAffinities(_) => None,
        }
    }
}
