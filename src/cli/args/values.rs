//! Parsing of argument values.

use clap::ValueEnum;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use lsdc_core::fit::{FitMethod, Loss, PriorKind, Robust};
use lsdc_core::{DepthNoise, Quality};
use lsdc_eval::data::{DatasetKind, Split};
#[cfg(feature = "train")]
use lsdc_eval::predict::Method;
use lsdc_eval::predict::Preserve;
use lsdc_eval::sampling::{Interpolation, Size};
use lsdc_files::error::{Error, Result};
use lsdc_weights::{Precision, ResizeLayer};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Parses a value; the error includes the hint.
pub(super) fn typed<T: FromStr<Err = Error>>(text: &str) -> std::result::Result<T, String> {
    text.parse().map_err(with_hint)
}

fn with_hint(error: Error) -> String {
    match error.advice() {
        Some(hint) => format!("{error}; {hint}"),
        None => error.to_string(),
    }
}

/// A method that can be trained.
#[cfg(feature = "train")]
pub(super) fn trainable(text: &str) -> std::result::Result<Method, String> {
    match typed::<Method>(text)? {
        Method::Classic(_) => Err(format!(
            "`{text}` has nothing to train; methods: lsdc, s2d, cspn, lsk"
        )),
        method => Ok(method),
    }
}

/// A file, which `NAME=` may name.
pub(super) fn named_file(text: &str) -> Result<(Option<String>, PathBuf)> {
    match text.split_once('=') {
        Some(("", _)) => Err(Error::config(format!("`{text}` has no name"))
            .hint("as in mine=runs/s2d/weights.safetensors")),
        Some((name, file)) => Ok((Some(name.to_owned()), PathBuf::from(file))),
        None => Ok((None, PathBuf::from(text))),
    }
}

/// `NAME=DIR`, or `DIR`, named by its last part.
pub(super) fn named_folder(text: &str) -> Result<(String, PathBuf)> {
    let (name, folder) = if let Some((name, folder)) = text.split_once('=') {
        (name.to_owned(), PathBuf::from(folder))
    } else {
        let folder = PathBuf::from(text);
        let name = folder.file_name().unwrap_or_default().to_string_lossy();
        (name.into_owned(), folder)
    };
    if name.is_empty() {
        return Err(Error::config(format!("`{text}` has no name")).hint("as in mine=results/depth"));
    }
    Ok((name, folder))
}

/// `WIDTHxHEIGHT`; the error includes the hint.
pub(super) fn size(text: &str) -> std::result::Result<Size, String> {
    read_size(text).map_err(with_hint)
}

fn read_size(text: &str) -> Result<Size> {
    let wrong = || {
        Error::config(format!("`{text}` is not a size"))
            .hint("a size is WIDTHxHEIGHT, as in 640x480")
    };
    let (width, height) = text.split_once('x').ok_or_else(wrong)?;
    let length = |t: &str| {
        t.parse()
            .ok()
            .filter(|n| (1..=1 << 16).contains(n))
            .ok_or_else(wrong)
    };
    let (height, width) = (length(height)?, length(width)?);
    // A gigabyte of depths.
    if height * width > 1 << 28 {
        return Err(Error::config(format!("{text} pixels are too many")).hint("as in 640x480"));
    }
    Ok(Size { height, width })
}

/// The noise of a depth camera; the error includes the hint.
pub(super) fn noise(text: &str) -> std::result::Result<DepthNoise, String> {
    let found = text.parse::<DepthNoise>();
    found.map_err(|error| with_hint(error.into()))
}

/// A standard deviation in metres, above 0.
pub(super) fn deviation(text: &str) -> std::result::Result<f32, String> {
    let found = text
        .parse()
        .ok()
        .filter(|v: &f32| *v > 0.0 && v.is_finite());
    found.ok_or_else(|| format!("`{text}` is no standard deviation; metres above 0, as in 0.2"))
}

/// A standard deviation as a share of the depth, above 0.
pub(super) fn share(text: &str) -> std::result::Result<f32, String> {
    deviation(text).map_err(|_| format!("`{text}` is no share of the depth; above 0, as in 0.05"))
}

/// Where the poses of images are from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::cli) enum PoseSource {
    /// The model of COLMAP that the points are of, or the transforms of the recording.
    Own,
    /// A file or folder of poses.
    File(PathBuf),
}

impl From<OsString> for PoseSource {
    /// A path; nothing for the poses of the points' own source.
    fn from(path: OsString) -> Self {
        if path.is_empty() {
            Self::Own
        } else {
            Self::File(path.into())
        }
    }
}

/// `LOW,HIGH` in metres, neither below 0; the error includes the hint.
pub(super) fn range(text: &str) -> std::result::Result<(f32, f32), String> {
    read_range(text).map_err(with_hint)
}

fn read_range(text: &str) -> Result<(f32, f32)> {
    let numbers = text.split_once(',').and_then(|(low, high)| {
        let numbers = (
            low.trim().parse::<f32>().ok()?,
            high.trim().parse::<f32>().ok()?,
        );
        let sound = 0.0 <= numbers.0 && numbers.0 < numbers.1 && numbers.1.is_finite();
        sound.then_some(numbers)
    });
    numbers.ok_or_else(|| {
        Error::config(format!("`{text}` is no range of depths"))
            .hint("LOW,HIGH in metres, as in 0.5,8")
    })
}

/// The edge length of a voxel, in metres.
pub(super) fn edge(text: &str) -> std::result::Result<f64, String> {
    let found = text.parse().ok();
    let found = found.filter(|edge: &f64| *edge > 0.0 && edge.is_finite());
    found.ok_or_else(|| {
        format!("`{text}` is not the edge length of a voxel; metres above 0, as in 0.01")
    })
}

macro_rules! by_name {
    ($kind:ty, $variants:expr) => {
        impl ValueEnum for $kind {
            fn value_variants<'a>() -> &'a [Self] {
                &$variants
            }

            fn to_possible_value(&self) -> Option<clap::builder::PossibleValue> {
                Some(clap::builder::PossibleValue::new(self.name()))
            }
        }
    };
}

/// A file that a result is written to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::cli) enum Format {
    /// float32 in metres.
    Npy,
    /// Depths in metres, and standard deviations if requested.
    Npz,
    /// 16-bit millimetres.
    Png,
    /// 32-bit floats in metres.
    Tiff,
    /// Channel Z in metres, and channel sigma if requested.
    Exr,
    /// In metres.
    Pfm,
    /// A colour map.
    Color,
    /// A coloured point cloud.
    Ply,
    /// A report on the result.
    Json,
}

impl Format {
    /// All formats.
    pub(in crate::cli) const ALL: [Self; 9] = [
        Self::Npy,
        Self::Npz,
        Self::Png,
        Self::Tiff,
        Self::Exr,
        Self::Pfm,
        Self::Color,
        Self::Ply,
        Self::Json,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Npy => "npy",
            Self::Npz => "npz",
            Self::Png => "png",
            Self::Tiff => "tiff",
            Self::Exr => "exr",
            Self::Pfm => "pfm",
            Self::Color => "color",
            Self::Ply => "ply",
            Self::Json => "json",
        }
    }

    /// The suffix of the file names.
    pub(in crate::cli) fn end(self) -> &'static str {
        match self {
            Self::Npy => "depth.npy",
            Self::Npz => "depth.npz",
            Self::Png => "depth.png",
            Self::Tiff => "depth.tiff",
            Self::Exr => "depth.exr",
            Self::Pfm => "depth.pfm",
            Self::Color => "depth_color.png",
            Self::Ply => "cloud.ply",
            Self::Json => "report.json",
        }
    }

    /// The format selected by a file's extension.
    pub(in crate::cli) fn of(path: &Path) -> Option<Self> {
        let ending = path.extension()?.to_str()?.to_ascii_lowercase();
        let ending = if ending == "tif" { "tiff" } else { &ending };
        let found = Self::ALL.into_iter().find(|format| format.name() == ending);
        found.filter(|format| *format != Self::Color)
    }
}

by_name!(Format, Self::ALL);

/// A robust loss, or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Robustness(Option<Loss>);

impl Robustness {
    /// The settings of this choice.
    pub(super) fn settings(self) -> Option<Robust> {
        self.0.map(Robust::new)
    }

    fn name(self) -> &'static str {
        self.0.map_or("none", Loss::name)
    }
}

by_name!(
    Robustness,
    [
        Self(None),
        Self(Some(Loss::Irls)),
        Self(Some(Loss::Huber)),
        Self(Some(Loss::Cauchy)),
        Self(Some(Loss::Gm)),
        Self(Some(Loss::Tukey)),
        Self(Some(Loss::Auto)),
    ]
);

/// A parser for one of several named values.
fn one_of<T: Copy + Send + Sync + 'static>(
    values: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(values.iter().map(|&value| name(value))).try_map(move |text| {
        let found = values.iter().find(|&&value| name(value) == text);
        found.copied().ok_or("no such value")
    })
}

/// The precision of weights, by its name.
pub(super) fn precision() -> impl TypedValueParser<Value = Precision> {
    one_of(&[Precision::Half, Precision::Single], Precision::name)
}

/// A depth head, by its name.
pub(super) fn head() -> impl TypedValueParser<Value = ResizeLayer> {
    one_of(&ResizeLayer::ALL, ResizeLayer::name)
}

/// What happens to the points in the result, by its name.
pub(super) fn preserve() -> impl TypedValueParser<Value = Preserve> {
    one_of(&Preserve::ALL, Preserve::name)
}

/// A split, by its name.
pub(super) fn split() -> impl TypedValueParser<Value = Split> {
    one_of(&[Split::Train, Split::Val], Split::name)
}

/// A dataset, by its name.
pub(super) fn dataset() -> impl TypedValueParser<Value = DatasetKind> {
    one_of(&DatasetKind::ALL, DatasetKind::name)
}

/// An interpolation, by one of its names.
pub(super) fn interpolation() -> impl TypedValueParser<Value = Interpolation> {
    let values = Interpolation::ALL.map(|kind| {
        let value = PossibleValue::new(kind.name());
        match kind {
            Interpolation::PilBilinear => value.alias("bilinear"),
            Interpolation::CvNearest => value.alias("nearest"),
            Interpolation::PilNearest
            | Interpolation::CvBilinear
            | Interpolation::NearestMeasured => value,
        }
    });
    PossibleValuesParser::new(values.clone()).try_map(move |text| {
        let mut pairs = Interpolation::ALL.into_iter().zip(&values);
        let found = pairs.find(|(_, value)| value.matches(&text, false));
        found.map(|(kind, _)| kind).ok_or("no such value")
    })
}

/// A prior, by its name.
pub(super) fn prior_kind() -> impl TypedValueParser<Value = PriorKind> {
    one_of(&PriorKind::ALL, PriorKind::name)
}

/// A quality, by its name.
pub(super) fn quality() -> impl TypedValueParser<Value = Quality> {
    one_of(&Quality::ALL, Quality::name)
}

/// A model of depth, by its name.
pub(super) fn fit_method() -> impl TypedValueParser<Value = FitMethod> {
    one_of(&FitMethod::ALL, FitMethod::name)
}
