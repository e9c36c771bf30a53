//! Trained systems as depth completers.

use super::{System as _, SystemInput, SystemNet, SystemWeights};
use burn::tensor::{Device, Tensor, TensorData};
use image::RgbImage;
use lsdc_core::RANGE;
use lsdc_eval::data::DepthMap;
use lsdc_eval::evaluation::Candidate;
use lsdc_eval::predict::{DepthCompleter, SystemKind};
use lsdc_eval::sampling::{Interpolation, Size, move_points, resize_depth, resize_rgb};
use lsdc_files::error::{Error, Result};
use lsdc_train::sample::image_tensor;
use serde_json::{Map, json};
use std::path::Path;
use std::sync::Arc;

/// A trained system on a device. Predictors with the same weights are equal.
#[derive(Clone, Debug)]
pub struct Predictor(Arc<LoadedSystem>);

#[derive(Debug)]
struct LoadedSystem {
    trained: SystemWeights,
    net: SystemNet,
    device: Device,
}

impl PartialEq for Predictor {
    fn eq(&self, other: &Self) -> bool {
        let identity = |of: &Self| (of.0.trained.config.clone(), of.0.trained.hash.clone());
        identity(self) == identity(other)
    }
}

impl Eq for Predictor {}

/// Largest ratio between the numbers of pixels of an image and of the training images at which the image is not resized.
const ALIKE: f64 = 1.1;

impl Predictor {
    /// Opens the weights of a system.
    ///
    /// # Errors
    /// The errors of [`SystemWeights::open`], or tensors that do not match the network.
    pub fn open(path: &Path, device: &Device) -> Result<Self> {
        Self::new(SystemWeights::open(path)?, device)
    }

    /// Loads weights.
    ///
    /// # Errors
    /// Tensors do not match the network.
    pub fn new(trained: SystemWeights, device: &Device) -> Result<Self> {
        let net = trained.net(device)?;
        Ok(Self::with(trained, net, device))
    }

    /// Combines a network, which has its own weights, with the record of a system.
    pub fn with(trained: SystemWeights, net: SystemNet, device: &Device) -> Self {
        Self(Arc::new(LoadedSystem {
            trained,
            net,
            device: device.clone(),
        }))
    }

    /// Returns the kind of system.
    pub fn kind(&self) -> SystemKind {
        self.0.trained.config.kind()
    }

    /// Returns its weights with their metadata.
    pub fn trained(&self) -> &SystemWeights {
        &self.0.trained
    }

    /// Returns its network.
    pub fn net(&self) -> &SystemNet {
        &self.0.net
    }

    /// Returns the system as a candidate of an evaluation; if `from` is set, image and points are given at this smaller size.
    pub fn candidate(self, from: Option<Size>) -> Candidate {
        let trained = self.trained();
        let made_from = Map::from_iter([
            ("method".to_owned(), json!(self.kind().name())),
            ("system".to_owned(), json!(trained.config)),
            ("weights".to_owned(), json!(trained.hash)),
        ]);
        Candidate::System {
            system: Arc::new(self),
            made_from,
            from,
        }
    }

    /// Returns the depth of every pixel. An image with another number of pixels than the training images is resized to about
    /// that number, and the depth is resized back. Depths are clamped to [`RANGE`] times the range of the points, as for
    /// `lsdc`.
    ///
    /// # Errors
    /// Image and sparse depths of different sizes, or no point.
    pub fn complete(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
        lsdc_eval::predict::check_sizes(rgb, sparse)?;
        let size = Size {
            height: sparse.height(),
            width: sparse.width(),
        };
        match self.working_size(size) {
            None => self.predicted(rgb, sparse),
            Some(working) => {
                let rgb = resize_rgb(rgb, working, Interpolation::PilBilinear)?;
                let found = self.predicted(&rgb, &move_points(sparse, working)?)?;
                resize_depth(&found, size, Interpolation::CvBilinear)
            }
        }
    }

    /// Returns the size to which an image is resized if its number of pixels differs from that of the training.
    fn working_size(&self, size: Size) -> Option<Size> {
        let [height, width] = self.0.trained.normalisation.input;
        let ratio = (size.height * size.width) as f64 / (height * width) as f64;
        if (1.0 / ALIKE..=ALIKE).contains(&ratio) {
            return None;
        }
        let side = |side: usize| ((side as f64 / ratio.sqrt()).round() as usize).max(1);
        Some(Size {
            height: side(size.height),
            width: side(size.width),
        })
    }

    /// Returns the prediction of the network at the given size, clamped to the extended range of the points.
    fn predicted(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
        let loaded = &*self.0;
        let (height, width) = (sparse.height(), sparse.width());
        let points = TensorData::new(sparse.values().to_vec(), [1, height, width]);
        let input = SystemInput {
            images: image_tensor(&[rgb], loaded.trained.normalisation, &loaded.device)?,
            sparse: Tensor::from_data(points, &loaded.device),
        };
        let (low, high) = sparse
            .range()
            .ok_or_else(|| Error::fit("there is no sparse depth"))?;
        let depth = loaded.net.predict(&input).depth.into_data();
        let (low, high) = (low / RANGE, high * RANGE);
        // Clamped before resizing: depths below 0 would count as missing.
        let values = depth.iter::<f32>().map(|depth| depth.clamp(low, high));
        Ok(DepthMap::new(width, height, values.collect())?)
    }
}

impl DepthCompleter for Predictor {
    fn depth(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
        self.complete(rgb, sparse)
    }
}
