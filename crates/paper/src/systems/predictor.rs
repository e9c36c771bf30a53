//! A trained system as a method of completion.

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

/// A trained system on a device. Two are equal if they have the same weights.
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

/// How many times more or fewer pixels an image may have than those of the training to be seen as it is.
const ALIKE: f64 = 1.1;

impl Predictor {
    /// Opens the weights of a system.
    ///
    /// # Errors
    /// As [`SystemWeights::open`], and tensors that do not belong to the network.
    pub fn open(path: &Path, device: &Device) -> Result<Self> {
        Self::new(SystemWeights::open(path)?, device)
    }

    /// Loads weights.
    ///
    /// # Errors
    /// Tensors that do not belong to the network.
    pub fn new(trained: SystemWeights, device: &Device) -> Result<Self> {
        let net = trained.net(device)?;
        Ok(Self::with(trained, net, device))
    }

    /// A network with weights of its own.
    pub fn with(trained: SystemWeights, net: SystemNet, device: &Device) -> Self {
        Self(Arc::new(LoadedSystem {
            trained,
            net,
            device: device.clone(),
        }))
    }

    /// Which system it is.
    pub fn kind(&self) -> SystemKind {
        self.0.trained.config.kind()
    }

    /// Its weights and what belongs to them.
    pub fn trained(&self) -> &SystemWeights {
        &self.0.trained
    }

    /// Its network.
    pub fn net(&self) -> &SystemNet {
        &self.0.net
    }

    /// The same as a candidate of an evaluation, given image and points at a smaller size if that is named.
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

    /// The depth of every pixel. An image with another number of pixels than those of the training is resized to as
    /// many, and the depth back. Depths are kept within [`RANGE`] times the range of the points, as those of `lsdc`.
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

    /// The size at which the network sees an image of another number of pixels than it was trained on.
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

    /// The prediction of the network at the size it is given, kept within the widened range of the points.
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
        // Before it is resized: of a depth below 0 there would be none.
        let values = depth.iter::<f32>().map(|depth| depth.clamp(low, high));
        Ok(DepthMap::new(width, height, values.collect())?)
    }
}

impl DepthCompleter for Predictor {
    fn depth(&self, rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
        self.complete(rgb, sparse)
    }
}
