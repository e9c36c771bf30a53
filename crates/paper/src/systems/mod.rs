//! The systems compared in the paper, trainable with the same data, protocol, points and budget: sparse-to-dense, spatial
//! propagation and learned steering kernels. Each predicts the depth of every pixel from the image and the measured depths.
//! They share no code with the method of this program, whose network does not read depths.

mod cspn;
mod layers;
mod lsk;
mod predictor;
mod pretrained;
mod regression;
mod resnet;
mod s2d;
#[cfg(test)]
mod tests;
mod training;
mod weights;

pub use cspn::{Cspn, CspnConfig};
pub use lsk::{KernelNetKind, Lsk, LskConfig};
pub use predictor::Predictor;
pub use pretrained::initial_net;
pub use resnet::ResNetDepth;
pub use s2d::{DecoderKind, S2d, S2dConfig};
pub use training::trainer;
pub use weights::SystemWeights;

use burn::module::Module;
use burn::tensor::{Device, IndexingUpdateOp, Int, Tensor, TensorData};
use lsdc_core::network::NormKind;
use lsdc_core::weights::Normalisation;
use lsdc_eval::predict::SystemKind;
use lsdc_files::error::Result;
use lsdc_rng::Rng;
use lsdc_train::model::layers::{FreezeStatistics, Init};
use lsdc_train::sample::Batch;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A system with its sizes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "method", rename_all = "lowercase")]
pub enum SystemConfig {
    /// Sparse-to-dense.
    S2d(S2dConfig),
    /// Convolutional spatial propagation.
    Cspn(CspnConfig),
    /// Learned steering kernels.
    Lsk(Box<LskConfig>),
}

impl SystemConfig {
    /// Returns the kind of system.
    pub fn kind(&self) -> SystemKind {
        match self {
            Self::S2d(_) => SystemKind::S2d,
            Self::Cspn(_) => SystemKind::Cspn,
            Self::Lsk(_) => SystemKind::Lsk,
        }
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check(&self) -> Result<()> {
        match self {
            Self::S2d(config) => config.check(),
            Self::Cspn(config) => config.check(),
            Self::Lsk(config) => config.check(),
        }
    }

    /// Returns the file of weights to initialise its encoder, if there is one.
    pub fn pretrained(&self) -> Option<&Path> {
        match self {
            Self::S2d(config) => config.pretrained.as_deref(),
            Self::Cspn(config) => config.pretrained.as_deref(),
            Self::Lsk(_) => None,
        }
    }

    /// Returns the number of parameters that the authors' program counts but never uses.
    pub fn never_run(&self) -> usize {
        match self {
            Self::Cspn(config) => config.never_run(),
            Self::S2d(_) | Self::Lsk(_) => 0,
        }
    }

    /// Returns a lower bound of the number of parameters of a network of these sizes: the minimum that a file must contain
    /// before a network is allocated.
    pub(crate) fn at_least(&self) -> usize {
        let squares = |width: usize, times: usize| times * width * width;
        match self {
            Self::S2d(S2dConfig { width, .. }) | Self::Cspn(CspnConfig { width, .. }) => {
                squares(*width, 2500)
            }
            Self::Lsk(config) => {
                let refine = if config.refine {
                    squares(config.width, 2500)
                } else {
                    0
                };
                refine
                    + match config.kernels {
                        KernelNetKind::Published => squares(config.width, 600),
                        KernelNetKind::Ours => {
                            config.own().hidden.windows(2).map(|w| w[0] * w[1]).sum()
                        }
                    }
            }
        }
    }

    /// Returns the normalisation of colours: sparse-to-dense only divides them by 255.
    pub fn normalisation(&self, input: [usize; 2]) -> Normalisation {
        let plain = Normalisation {
            mean: [0.0; 3],
            deviation: [1.0; 3],
            input,
        };
        match self {
            Self::S2d(_) => plain,
            Self::Cspn(_) | Self::Lsk(_) => Normalisation {
                input,
                ..Normalisation::default()
            },
        }
    }

    /// Builds the network with random weights, drawn from the stream of `seed`.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn init(&self, seed: u64, device: &Device) -> Result<SystemNet> {
        self.build(Some(Rng::stream(seed, &["weights"])), device)
    }

    /// Builds the network with zero weights, to be filled later.
    ///
    /// # Errors
    /// A setting is out of range.
    pub fn blank(&self, device: &Device) -> Result<SystemNet> {
        self.build(None, device)
    }

    fn build(&self, rng: Option<Rng>, device: &Device) -> Result<SystemNet> {
        self.check()?;
        let mut init = Init {
            rng,
            norm: NormKind::Batch,
            // PyTorch's default, used by the authors for training.
            momentum: 0.1,
            device: device.clone(),
        };
        Ok(match self {
            Self::S2d(config) => SystemNet::S2d(S2d::init(config, &mut init)),
            Self::Cspn(config) => SystemNet::Cspn(Cspn::init(config, &mut init)),
            Self::Lsk(config) => SystemNet::Lsk(Lsk::init(config, &mut init)?),
        })
    }
}

/// The input of a system for some frames.
#[derive(Clone, Debug)]
pub struct SystemInput {
    /// Normalised images `[n, height, width, 3]`.
    pub images: Tensor<4>,
    /// Measured depths `[n, height, width]` in metres; 0 = none.
    pub sparse: Tensor<3>,
}

impl SystemInput {
    /// Returns the images of a batch with the points of each draw, draw by draw.
    pub fn of(batch: &Batch) -> Self {
        let [images, height, width] = batch.maps.dims();
        let draws = batch.draws.dims()[0] / images;
        let device = batch.maps.device();
        let places: Vec<i32> = batch
            .pixels
            .iter()
            .flat_map(|list| list[..batch.points].iter().map(|&p| p as i32))
            .collect();
        let places = TensorData::new(places, [images, batch.points]);
        let places = Tensor::<2, Int>::from_data(places, &device).repeat_dim(0, draws);
        // Points that a draw does not read add 0 to the first pixel.
        let read = batch.measured.clone().repeat_dim(0, draws) * batch.draws.clone();
        let empty = Tensor::<2>::zeros([draws * images, height * width], &device);
        let sparse = empty.scatter(1, places, read, IndexingUpdateOp::Add);
        Self {
            images: batch.images.clone().repeat_dim(0, draws),
            sparse: sparse.reshape([draws * images, height, width]),
        }
    }

    /// Concatenates colours and depths to `[n, height, width, 4]`.
    fn rgbd(&self) -> Tensor<4> {
        let depths = self.sparse.clone().unsqueeze_dim(3);
        Tensor::cat(vec![self.images.clone(), depths], 3)
    }
}

/// The prediction of a system for some frames.
#[derive(Clone, Debug)]
pub struct SystemOutput {
    /// Depths `[n, height, width]` in metres, which may be negative.
    pub depth: Tensor<3>,
    /// Depths before the refinement, for a system with several parts; they have separate losses.
    pub unrefined: Option<Tensor<3>>,
}

impl SystemOutput {
    fn single(depth: Tensor<3>) -> Self {
        Self {
            depth,
            unrefined: None,
        }
    }
}

/// A trainable system that predicts depth from image and measured depths.
pub trait System {
    /// Predicts the depths of some frames.
    fn predict(&self, input: &SystemInput) -> SystemOutput;
}

/// The network of a system.
#[derive(Module, Debug)]
#[allow(clippy::large_enum_variant)]
pub enum SystemNet {
    /// Sparse-to-dense.
    S2d(S2d),
    /// Convolutional spatial propagation.
    Cspn(Cspn),
    /// Learned steering kernels.
    Lsk(Lsk),
}

impl System for SystemNet {
    fn predict(&self, input: &SystemInput) -> SystemOutput {
        match self {
            Self::S2d(net) => net.predict(input),
            Self::Cspn(net) => net.predict(input),
            Self::Lsk(net) => net.predict(input),
        }
    }
}

impl SystemNet {
    /// Makes batch normalisation use its running statistics from now on.
    #[must_use]
    pub fn freeze_statistics(self) -> Self {
        self.map(&mut FreezeStatistics)
    }
}
