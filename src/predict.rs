//! Image and sparse depths to dense depth: the only place where bases and fit meet.

use crate::classic;
use crate::data::DepthMap;
use crate::error::{Error, Result};
use crate::fit::{Fit, FitConfig, fit};
use crate::model::{Bases, BasisNet, Normalisation, Weights};
use crate::sample::{Size, image_tensor, resize_rgb};
use burn::tensor::Device;
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::{Duration, Instant};

/// The weights that come with the program.
const EMBEDDED: &[u8] = include_bytes!("../assets/weights.safetensors");

/// The note of a weights file that holds its `FitConfig`.
pub const FIT_NOTE: &str = "fit";

/// Predictions stay within the sparse depths' range widened by this factor both ways. Relative to
/// the depths, so that scaling them scales the result.
pub const RANGE: f32 = 10.0;

/// A way to complete depth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Base functions fitted to the points.
    Lsdc,
    /// Linear interpolation over the Delaunay triangulation, nearest outside its hull.
    Linear,
}

impl Method {
    /// The name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lsdc => "lsdc",
            Self::Linear => "linear",
        }
    }
}

impl std::str::FromStr for Method {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        [Self::Lsdc, Self::Linear]
            .into_iter()
            .find(|m| m.name() == name)
            .ok_or_else(|| {
                Error::config(format!("unknown method `{name}`")).hint("methods: lsdc, linear")
            })
    }
}

/// A trained network and a fit, ready to complete depth.
#[derive(Clone, Debug)]
pub struct Completer {
    net: BasisNet,
    normalisation: Normalisation,
    fit: FitConfig,
    device: Device,
}

/// A dense depth map and how it came about.
#[derive(Clone, Debug)]
pub struct Completion {
    /// Metres, at the asked size.
    pub depth: DepthMap,
    /// The fit to the points.
    pub fit: Fit,
    /// Time spent on each stage.
    pub timings: Timings,
}

/// Wall-clock time of each stage.
#[derive(Clone, Copy, Debug)]
pub struct Timings {
    /// Image to features.
    pub network: Duration,
    /// Base functions at the points, and the solve.
    pub fit: Duration,
    /// Base functions at every pixel, times weights.
    pub dense: Duration,
}

impl Completer {
    /// The weights that come with the program, on the CPU.
    ///
    /// # Errors
    /// None in a sound build.
    pub fn load() -> Result<Self> {
        Self::with_weights(&embedded_weights()?, &Device::flex())
    }

    /// Weights from a file, or those that come with the program.
    ///
    /// # Errors
    /// A file that cannot be read or is no weights file.
    pub fn open(weights: Option<&Path>, device: &Device) -> Result<Self> {
        let weights = match weights {
            None => embedded_weights()?,
            Some(path) => {
                let bytes = std::fs::read(path).map_err(|e| Error::read(path, e))?;
                Weights::from_bytes(&bytes, &path.display().to_string())?
            }
        };
        Self::with_weights(&weights, device)
    }

    /// Uses the given weights with the fit that they were trained for.
    ///
    /// # Errors
    /// Weights that do not belong to their network.
    pub fn with_weights(weights: &Weights, device: &Device) -> Result<Self> {
        let fit = match weights.record.notes.get(FIT_NOTE) {
            None => FitConfig::default(),
            Some(json) => serde_json::from_str(json).map_err(|e| {
                Error::weights("the `fit` record of the weights cannot be read").because(e)
            })?,
        };
        let net = weights.load(device)?;
        Ok(Self::new(net, weights.record.normalisation, fit, device))
    }

    /// Uses a network as it is.
    pub fn new(
        net: BasisNet,
        normalisation: Normalisation,
        fit: FitConfig,
        device: &Device,
    ) -> Self {
        Self {
            net,
            normalisation,
            fit,
            device: device.clone(),
        }
    }

    /// The settings of the fit.
    pub fn fit_config(&self) -> &FitConfig {
        &self.fit
    }

    /// Changes the settings of the fit.
    #[must_use]
    pub fn with_fit(mut self, fit: FitConfig) -> Self {
        self.fit = fit;
        self
    }

    /// Completes `sparse` under the guidance of `rgb`, at `size` or the size of `rgb`.
    ///
    /// # Errors
    /// Image and sparse depths of different sizes, no point, or damaged weights.
    pub fn complete(
        &self,
        rgb: &RgbImage,
        sparse: &DepthMap,
        size: Option<Size>,
    ) -> Result<Completion> {
        check_sizes(rgb, sparse)?;
        let started = Instant::now();
        let bases = self.bases(rgb)?;
        let network = started.elapsed();

        let started = Instant::now();
        let points: Vec<_> = sparse.points().collect();
        let pixels = points
            .iter()
            .map(|p| (p.y * sparse.width() + p.x) as u32)
            .collect();
        let depths: Vec<f32> = points.iter().map(|p| p.depth).collect();
        let rows: Vec<f32> = if points.is_empty() {
            Vec::new()
        } else {
            bases
                .at((sparse.height(), sparse.width()), &[pixels])
                .into_data()
                .iter::<f32>()
                .collect()
        };
        let fit = fit(&rows, &depths, &self.fit)?;
        let fitting = started.elapsed();

        let started = Instant::now();
        let size = size.unwrap_or(Size {
            height: sparse.height(),
            width: sparse.width(),
        });
        let weights: Vec<f32> = fit.weights.iter().map(|&w| w as f32).collect();
        let mut values = bases.combine((size.height, size.width), &weights);
        let (low, high) = sparse.range().unwrap_or((0.0, 0.0));
        for value in &mut values {
            *value = value.clamp(low / RANGE, high * RANGE);
        }
        let depth = DepthMap::new(size.width, size.height, values)?;
        let timings = Timings {
            network,
            fit: fitting,
            dense: started.elapsed(),
        };
        Ok(Completion {
            depth,
            fit,
            timings,
        })
    }

    /// The base functions of an image. A larger image than those of training is first reduced to
    /// their number of pixels; its base functions can be read at any size all the same.
    fn bases(&self, rgb: &RgbImage) -> Result<Bases> {
        let [height, width] = self.normalisation.input;
        let (w, h) = (rgb.width() as f64, rgb.height() as f64);
        let scale = ((height * width) as f64 / (w * h)).sqrt().min(1.0);
        let reduced = |length: f64| ((length * scale).round() as usize).max(1);
        let working = resize_rgb(rgb, reduced(w), reduced(h))?;
        let Normalisation {
            mean, deviation, ..
        } = self.normalisation;
        let image = image_tensor(&[&working], mean, deviation, &self.device)?;
        Ok(self.net.bases(image))
    }
}

/// Completes with a method that needs no training.
///
/// # Errors
/// Image and sparse depths of different sizes, or no point.
pub fn complete_linear(rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
    check_sizes(rgb, sparse)?;
    classic::linear(sparse)
}

fn check_sizes(rgb: &RgbImage, sparse: &DepthMap) -> Result<()> {
    if (rgb.width() as usize, rgb.height() as usize) == (sparse.width(), sparse.height()) {
        return Ok(());
    }
    Err(Error::shape(format!(
        "the image is {}x{} (width x height) but the sparse depths are {}x{}",
        rgb.width(),
        rgb.height(),
        sparse.width(),
        sparse.height()
    ))
    .hint(
        "both must show the same pixels; move the points to the image's size, do not interpolate",
    ))
}

fn embedded_weights() -> Result<Weights> {
    Weights::from_bytes(EMBEDDED, "embedded weights")
}
