//! Learned steering kernels (Liu, Liao, Wang, Geiger and Liu 2021). For every pixel of the image, a network predicts the
//! elongation, angle and scale of the Gaussian kernel of a point there; depth is the kernel regression of the points; a second
//! network refines it. As in the authors' `Steering-KernelNet`, or with our own network and without refinement.

use super::layers::{Biased, largest, stretched};
use super::regression::{Neighbourhood, SteeringKernels};
use super::{System, SystemInput, SystemOutput};
use burn::module::Module;
use burn::tensor::activation::{sigmoid, softmax};
use burn::tensor::{Tensor, TensorData};
use lsdc_core::network::NetworkConfig;
use lsdc_core::weights::Normalisation;
use lsdc_files::error::{Error, Result};
use lsdc_train::model::BasisNet;
use lsdc_train::model::layers::{Init, Norm};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// The network that predicts the kernels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum KernelNetKind {
    /// The published network, with a single step down and up.
    #[default]
    Published,
    /// The network of this program's method, with three outputs instead of basis functions.
    Ours,
}

/// Sizes of the networks; the defaults are the published ones, with 13.422 M parameters of the refinement, as published, and
/// 3.065 M of the kernels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LskConfig {
    /// Network that predicts the kernels.
    pub kernels: KernelNetKind,
    /// Order of the regression: 0, 1 or 2.
    pub order: usize,
    /// Number of nearest points used for a pixel.
    pub neighbours: usize,
    /// Whether the weight of far points has a lower bound: `exp(2 tanh(.))` instead of `exp(.)`.
    pub bounded: bool,
    /// Whether a second network refines the depth.
    pub refine: bool,
    /// Number of channels of the first layers; all others are multiples of it.
    pub width: usize,
    /// Sizes of our network; those of the preset `sharp` if absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub network: Option<NetworkConfig>,
}

impl Default for LskConfig {
    fn default() -> Self {
        Self {
            kernels: KernelNetKind::default(),
            order: 2,
            neighbours: 32,
            bounded: true,
            refine: true,
            width: 64,
            network: None,
        }
    }
}

/// Number of parameters of a kernel: elongation, angle, scale.
const NUMBERS: usize = 3;

impl LskConfig {
    pub(super) fn check(&self) -> Result<()> {
        if self.order > 2 || !(1..=1024).contains(&self.neighbours) {
            return Err(Error::config(
                "`system.order` must be 0, 1 or 2, and `neighbours` from 1 to 1024",
            ));
        }
        if !(1..=256).contains(&self.width) {
            return Err(Error::config("`system.width` must be from 1 to 256"));
        }
        self.own().check()?;
        Ok(())
    }

    /// Returns the configuration of our network for kernels.
    pub(super) fn own(&self) -> NetworkConfig {
        NetworkConfig {
            bases: NUMBERS,
            affinities: 0,
            mean: false,
            ..self.network.clone().unwrap_or_else(NetworkConfig::sharp)
        }
    }
}

/// The networks with their weights.
#[derive(Module, Debug)]
pub struct Lsk {
    published: Option<KernelNet>,
    own: Option<BasisNet>,
    refine: Option<Refinement>,
    #[module(skip)]
    order: usize,
    #[module(skip)]
    neighbours: usize,
    #[module(skip)]
    bounded: bool,
}

impl Lsk {
    pub(super) fn init(config: &LskConfig, init: &mut Init) -> Result<Self> {
        let (published, own) = match config.kernels {
            KernelNetKind::Published => (Some(KernelNet::init(config.width, init)), None),
            KernelNetKind::Ours => (None, Some(BasisNet::init(&config.own(), init)?)),
        };
        Ok(Self {
            published,
            own,
            refine: config.refine.then(|| Refinement::init(config.width, init)),
            order: config.order,
            neighbours: config.neighbours,
            bounded: config.bounded,
        })
    }

    /// Returns the outputs of the network at the pixels of the points, `[n, points, 3]`.
    fn at_points(&self, input: &SystemInput, pixels: &[Vec<u32>]) -> Tensor<3> {
        let [n, height, width, _] = input.images.dims();
        let count = pixels.first().map_or(0, Vec::len);
        if let Some(net) = &self.own {
            let bases = net.bases(input.images.clone(), None);
            // The first basis function is the constant 1.
            return bases.at((height, width), pixels).narrow(2, 1, NUMBERS);
        }
        let Some(net) = &self.published else {
            return Tensor::zeros([n, count, NUMBERS], &input.images.device());
        };
        let all = net.forward(plain(&input.images));
        let all = all.reshape([n, height * width, NUMBERS]);
        let places: Vec<i32> = pixels.iter().flatten().map(|&p| p as i32).collect();
        let places = Tensor::<3, burn::tensor::Int>::from_data(
            TensorData::new(places, [n, count, 1]),
            &all.device(),
        );
        all.gather(1, places.repeat_dim(2, NUMBERS))
    }
}

impl System for Lsk {
    fn predict(&self, input: &SystemInput) -> SystemOutput {
        /// Lower bound of elongations and scales, so that no kernel degenerates to a line.
        const LEAST: f64 = 1e-5;
        /// Upper bound of elongations and scales.
        const MOST: f64 = 6.0;
        let [n, height, width] = input.sparse.dims();
        let points = Neighbourhood::new(&input.sparse, self.neighbours);
        let numbers = sigmoid(self.at_points(input, &points.pixels));
        let number = |i: usize| numbers.clone().narrow(2, i, 1).squeeze_dim::<2>(2);
        let kernels = SteeringKernels::new(
            number(0) * MOST + LEAST,
            number(1) * (2.0 * PI) - PI,
            number(2) * MOST + LEAST,
            self.bounded,
        );
        let depth = points.regress(&kernels, self.order);
        let depth = depth.reshape([n, height, width]);
        let Some(net) = &self.refine else {
            return SystemOutput::single(depth);
        };
        let refined = net.forward(input.images.clone(), depth.clone());
        // Measured points are preserved.
        let open = input.sparse.clone().sign().neg() + 1.0;
        SystemOutput {
            depth: refined * open + input.sparse.clone(),
            unrefined: Some(depth),
        }
    }
}

/// Converts normalised colours to colours from 0 to 1.
fn plain(images: &Tensor<4>) -> Tensor<4> {
    let Normalisation {
        mean, deviation, ..
    } = Normalisation::default();
    let row = |values: [f32; 3]| {
        Tensor::<4>::from_data(
            TensorData::new(values.to_vec(), [1, 1, 1, 3]),
            (&images.device(), images.dtype()),
        )
    };
    images.clone() * row(deviation) + row(mean)
}

/// Two convolutions with normalisation.
#[derive(Module, Debug)]
struct DoubleConv {
    convs: Vec<Biased>,
    norms: Vec<Norm>,
}

impl DoubleConv {
    fn init(from: usize, to: usize, init: &mut Init) -> Self {
        Self {
            convs: [from, to]
                .map(|from| Biased::init(from, to, 3, init))
                .into(),
            norms: [0, 1].map(|_| Norm::init(to, init)).into(),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let layers = self.convs.iter().zip(&self.norms);
        layers.fold(x, |x, (conv, norm)| norm.forward(conv.forward(x), true))
    }
}

/// Joins levels of a U-Net: upsamples the lower level and concatenates the features of this level.
fn joined(below: Tensor<4>, level: Tensor<4>) -> Tensor<4> {
    let [_, height, width, _] = level.dims();
    let [_, rows, columns, _] = below.dims();
    let below = stretched(below, (2 * rows, 2 * columns));
    let (down, right) = (height - 2 * rows, width - 2 * columns);
    let border = [
        (down / 2, down - down / 2),
        (right / 2, right - right / 2),
        (0, 0),
    ];
    Tensor::cat(vec![level, below.pad(border, 0.0)], 3)
}

/// A network that predicts the three parameters of a kernel from an image.
#[derive(Module, Debug)]
struct KernelNet {
    first: DoubleConv,
    down: DoubleConv,
    up: DoubleConv,
    last: Biased,
}

impl KernelNet {
    fn init(width: usize, init: &mut Init) -> Self {
        Self {
            first: DoubleConv::init(3, width, init),
            down: DoubleConv::init(width, 8 * width, init),
            up: DoubleConv::init(9 * width, width, init),
            last: Biased::init(width, NUMBERS, 1, init),
        }
    }

    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let level = self.first.forward(x);
        let below = self.down.forward(largest(level.clone(), 2, 2, 0));
        self.last.forward(self.up.forward(joined(below, level)))
    }
}

/// A refinement of depth from image and depth: a U-Net (Ronneberger et al. 2015) that predicts the probabilities of 401
/// changes.
#[derive(Module, Debug)]
struct Refinement {
    first: DoubleConv,
    down: Vec<DoubleConv>,
    up: Vec<DoubleConv>,
    changes: Biased,
    rest: Biased,
}

/// Number of discrete changes of depth.
const CHANGES: usize = 401;
/// Largest change, in metres.
const LARGEST: f64 = 4.0;
/// Upper bound of the offset added to the mean change, in metres.
const REST: f64 = 0.04;
/// Mean and standard deviation for normalising the input depths, in metres.
const DEPTHS: (f64, f64) = (3.010_474_862_21, 1.079_438_399_77);

impl Refinement {
    fn init(width: usize, init: &mut Init) -> Self {
        let widths = [1, 2, 4, 8, 8].map(|times| times * width);
        let ups = [(16, 4), (8, 2), (4, 1), (2, 1)];
        Self {
            first: DoubleConv::init(4, width, init),
            down: widths
                .windows(2)
                .map(|pair| DoubleConv::init(pair[0], pair[1], init))
                .collect(),
            up: ups
                .map(|(from, to)| DoubleConv::init(from * width, to * width, init))
                .into(),
            changes: Biased::init(width, CHANGES, 1, init),
            rest: Biased::init(width, 1, 1, init),
        }
    }

    fn forward(&self, images: Tensor<4>, depth: Tensor<3>) -> Tensor<3> {
        let read = (depth.clone() - DEPTHS.0) / DEPTHS.1;
        let mut x = self
            .first
            .forward(Tensor::cat(vec![images, read.unsqueeze_dim(3)], 3));
        let mut levels = Vec::new();
        for down in &self.down {
            levels.push(x.clone());
            x = down.forward(largest(x, 2, 2, 0));
        }
        for (up, level) in self.up.iter().zip(levels.into_iter().rev()) {
            x = up.forward(joined(x, level));
        }
        let rest = sigmoid(self.rest.forward(x.clone())) * (2.0 * REST) - REST;
        let likely = softmax(self.changes.forward(x), 3);
        let step = 2.0 * LARGEST / (CHANGES - 1) as f64;
        let changes: Vec<f32> = (0..CHANGES)
            .map(|i| (i as f64 * step - LARGEST) as f32)
            .collect();
        let changes = TensorData::new(changes, [1, 1, CHANGES, 1]);
        let changes = likely.matmul(Tensor::from_data(changes, (&depth.device(), depth.dtype())));
        depth + (changes + rest).squeeze_dim(3)
    }
}
