//! Methods of depth completion, by name.

use super::check_sizes;
use crate::data::DepthMap;
use image::RgbImage;
use lsdc_classic::Classic;
use lsdc_files::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// A method of depth completion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Method {
    /// Basis functions fitted to the points.
    Lsdc,
    /// A method without training.
    Classic(Classic),
    /// A trained system compared in the paper.
    System(SystemKind),
}

impl Method {
    /// Returns all methods.
    pub fn all() -> impl Iterator<Item = Self> {
        std::iter::once(Self::Lsdc)
            .chain(Classic::ALL.map(Self::Classic))
            .chain(SystemKind::ALL.map(Self::System))
    }

    /// Returns the name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lsdc => "lsdc",
            Self::Classic(classic) => classic.name(),
            Self::System(system) => system.name(),
        }
    }
}

impl std::str::FromStr for Method {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        Self::all().find(|m| m.name() == name).ok_or_else(|| {
            let names: Vec<&str> = Self::all().map(Self::name).collect();
            Error::config(format!("unknown method `{name}`"))
                .hint(format!("methods: {}", names.join(", ")))
        })
    }
}

impl TryFrom<String> for Method {
    type Error = Error;

    fn try_from(name: String) -> Result<Self> {
        name.parse()
    }
}

impl From<Method> for String {
    fn from(method: Method) -> Self {
        method.name().to_owned()
    }
}

/// A system compared in the paper, trainable with `lsdc-paper`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum SystemKind {
    /// Sparse-to-dense.
    S2d,
    /// Convolutional spatial propagation.
    Cspn,
    /// Learned steering kernels.
    Lsk,
}

impl SystemKind {
    /// All systems.
    pub const ALL: [Self; 3] = [Self::S2d, Self::Cspn, Self::Lsk];

    /// Returns the name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::S2d => "s2d",
            Self::Cspn => "cspn",
            Self::Lsk => "lsk",
        }
    }

    /// Returns the publication.
    pub fn source(self) -> &'static str {
        match self {
            Self::S2d => "Ma and Karaman, Sparse-to-Dense, ICRA 2018",
            Self::Cspn => "Cheng, Wang and Yang, CSPN, ECCV 2018",
            Self::Lsk => "Liu et al., Learning Steering Kernels, TIP 2021",
        }
    }
}

/// Completes with a method that needs no training.
///
/// # Errors
/// Image and sparse depths of different sizes, or no point.
pub fn complete_classic(method: Classic, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
    check_sizes(rgb, sparse)?;
    method.complete(rgb, sparse).map_err(|error| {
        let hint = error.hint().map(str::to_owned);
        let error = match error {
            lsdc_classic::Error::Map(error) => return error.into(),
            other => Error::fit(other.to_string()),
        };
        match hint {
            Some(hint) => error.hint(hint),
            None => error,
        }
    })
}
