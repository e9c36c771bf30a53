//! The building blocks: convolution or linear map without bias, normalisation, ReLU.

use crate::ops::conv::{ConvSpec, conv2d, linear};
use crate::ops::conv_norm::{ConvNormSpec, FixedNorm, conv_norm, linear_norm};
use crate::ops::norm::{NormSpec, moments, normalise};
use crate::ops::weighted_sum::weighted_sum;
use burn::module::{Flag, Module, ModuleMapper, Param, RunningState};
use burn::nn::{GroupNorm, GroupNormConfig};
use burn::tensor::{Device, Tensor, TensorData};
use lsdc_core::network::{CHANNELS_PER_GROUP, EPSILON, NormKind};
use lsdc_rng::Rng;

/// Weight of each batch in the running statistics of batch normalisation: small, because batches are small.
pub const MOMENTUM: f64 = 0.01;

/// Settings for building layers.
pub struct Init {
    /// Source of random weights; without it they are 0.
    pub rng: Option<Rng>,
    /// Kind of normalisation.
    pub norm: NormKind,
    /// Momentum of batch normalisation.
    pub momentum: f64,
    /// Device of the parameters.
    pub device: Device,
}

impl Init {
    /// Draws normal values with the given standard deviation.
    pub fn normal<const D: usize>(
        &mut self,
        shape: [usize; D],
        deviation: f32,
    ) -> Param<Tensor<D>> {
        let count = shape.iter().product();
        let values: Vec<f32> = match &mut self.rng {
            None => vec![0.0; count],
            Some(rng) => (0..count).map(|_| rng.normal() * deviation).collect(),
        };
        Param::from_data(TensorData::new(values, shape), &self.device)
    }
}

/// Batch normalisation: with the statistics of the batch while `training`, with running ones otherwise.
#[derive(Module, Debug)]
pub struct BatchNorm {
    gain: Param<Tensor<1>>,
    shift: Param<Tensor<1>>,
    training: Param<Flag>,
    running_mean: RunningState<Tensor<1>>,
    running_variance: RunningState<Tensor<1>>,
    #[module(skip)]
    momentum: f64,
}

impl BatchNorm {
    fn init(channels: usize, momentum: f64, device: &Device) -> Self {
        let fill = |value: f32| TensorData::new(vec![value; channels], [channels]);
        Self {
            gain: Param::from_data(fill(1.0), device),
            shift: Param::from_data(fill(0.0), device),
            training: Param::from_bool(true),
            running_mean: RunningState::new(Tensor::zeros([channels], device)),
            running_variance: RunningState::new(Tensor::ones([channels], device)),
            momentum,
        }
    }

    fn forward<const D: usize>(&self, x: Tensor<D>, relu: bool) -> Tensor<D> {
        let fixed = self.fixed(&x.device());
        let own = fixed.is_none();
        let FixedNorm {
            gain,
            shift,
            mean,
            variance,
        } = fixed.unwrap_or_else(|| {
            let (mean, variance) = moments(x.clone());
            self.follow(&self.running_mean, mean.clone());
            self.follow(&self.running_variance, variance.clone());
            FixedNorm {
                gain: self.gain.val(),
                shift: self.shift.val(),
                mean,
                variance,
            }
        });
        let spec = NormSpec {
            epsilon: EPSILON,
            relu,
            own,
        };
        normalise(x, gain, shift, mean, variance, spec)
    }

    /// Returns the normalisation with running statistics; `None` if the network is training with those of each batch.
    fn fixed(&self, device: &Device) -> Option<FixedNorm> {
        let own = device.is_autodiff() && self.training.is_enabled();
        (!own).then(|| FixedNorm {
            gain: self.gain.val(),
            shift: self.shift.val(),
            mean: self.running_mean.value().to_device(device),
            variance: self.running_variance.value().to_device(device),
        })
    }

    fn follow(&self, running: &RunningState<Tensor<1>>, now: Tensor<1>) {
        let [before, now] = [running.value(), now].map(Tensor::inner);
        let after = weighted_sum(before, 1.0 - self.momentum, now, self.momentum);
        // Clones share the value. It is written immediately, so that a checkpoint includes the last batch, and not as one of
        // several threads' values, of which burn would compute the mean.
        running.clone().map(&mut Replace(Tensor::from_inner(after)));
    }
}

/// Replaces the value of a running statistic.
struct Replace(Tensor<1>);

impl ModuleMapper for Replace {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        param.map(|old| self.0.clone().reshape(old.dims()))
    }
}

/// Switches batch normalisation from the statistics of each batch to the running ones.
pub struct FreezeStatistics;

impl ModuleMapper for FreezeStatistics {
    fn map_flag(&mut self, flag: Param<Flag>) -> Param<Flag> {
        flag.with_value(false)
    }
}

/// Batch or group normalisation.
#[derive(Module, Debug)]
pub enum Norm {
    /// Statistics of batches.
    Batch(BatchNorm),
    /// Statistics of groups of channels.
    Group(GroupNorm),
}

impl Norm {
    /// Creates a normalisation with gain 1 and shift 0.
    pub fn init(channels: usize, init: &Init) -> Self {
        match init.norm {
            NormKind::Batch => Self::Batch(BatchNorm::init(channels, init.momentum, &init.device)),
            NormKind::Group => {
                let config = GroupNormConfig::new(channels / CHANNELS_PER_GROUP, channels);
                Self::Group(config.with_epsilon(EPSILON).init(&init.device))
            }
        }
    }

    /// Returns the parameters of a batch normalisation with fixed statistics; `None` for others.
    fn fixed(&self, device: &Device) -> Option<FixedNorm> {
        match self {
            Self::Batch(norm) => norm.fixed(device),
            Self::Group(_) => None,
        }
    }

    /// Normalises `[batch, .., channels]`, followed by ReLU if `relu`.
    pub fn forward<const D: usize>(&self, x: Tensor<D>, relu: bool) -> Tensor<D> {
        match self {
            Self::Batch(norm) => norm.forward(x, relu),
            Self::Group(norm) => {
                // burn expects channels second.
                let x = norm.forward(x.movedim(D - 1, 1)).movedim(1, D - 1);
                if relu {
                    burn::tensor::activation::relu(x)
                } else {
                    x
                }
            }
        }
    }
}

/// Convolution without bias.
#[derive(Module, Debug)]
pub struct Conv {
    weight: Param<Tensor<4>>,
    #[module(skip)]
    spec: ConvSpec,
}

impl Conv {
    /// Initialises weights as in He et al. 2015 (fan-out).
    pub fn init(from: usize, to: usize, kernel: usize, spec: ConvSpec, init: &mut Init) -> Self {
        let fan_out = if spec.depthwise { 1 } else { to };
        let deviation = (2.0 / (kernel * kernel * fan_out) as f32).sqrt();
        let weight = init.normal([to, from, kernel, kernel], deviation);
        Self { weight, spec }
    }

    /// Creates a layer that outputs 0 before training.
    pub fn zero(from: usize, to: usize, kernel: usize, spec: ConvSpec, init: &mut Init) -> Self {
        let weight = init.normal([to, from, kernel, kernel], 0.0);
        Self { weight, spec }
    }

    /// Maps `[batch, height, width, from]` to `[batch, height', width', to]`.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        conv2d(x, self.weight.val(), self.spec)
    }
}

/// Convolution and normalisation, with or without ReLU.
#[derive(Module, Debug)]
pub struct ConvNorm {
    conv: Conv,
    norm: Norm,
}

impl ConvNorm {
    /// Initialises the convolution as [`Conv::init`].
    pub fn init(from: usize, to: usize, kernel: usize, spec: ConvSpec, init: &mut Init) -> Self {
        Self {
            conv: Conv::init(from, to, kernel, spec, init),
            norm: Norm::init(to, init),
        }
    }

    /// Maps `[batch, height, width, from]` to `[batch, height', width', to]`, without ReLU.
    pub fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        self.run(x, false)
    }

    /// Maps like [`forward`](Self::forward), with ReLU.
    pub fn forward_relu(&self, x: Tensor<4>) -> Tensor<4> {
        self.run(x, true)
    }

    fn run(&self, x: Tensor<4>, relu: bool) -> Tensor<4> {
        let Some(fixed) = self.norm.fixed(&x.device()) else {
            return self.norm.forward(self.conv.forward(x), relu);
        };
        let spec = ConvNormSpec {
            conv: self.conv.spec,
            epsilon: EPSILON,
            relu,
        };
        conv_norm(x, self.conv.weight.val(), fixed, spec)
    }
}

/// Linear map of rows without bias.
#[derive(Module, Debug)]
pub struct Linear {
    weight: Param<Tensor<2>>,
}

impl Linear {
    /// Initialises weights as in He et al. 2015 (fan-in).
    pub fn init(from: usize, to: usize, init: &mut Init) -> Self {
        let deviation = (2.0 / from as f32).sqrt();
        Self {
            weight: init.normal([from, to], deviation),
        }
    }

    /// Creates a layer that outputs 0 before training.
    pub fn zero(from: usize, to: usize, init: &mut Init) -> Self {
        Self {
            weight: init.normal([from, to], 0.0),
        }
    }

    /// Returns the weights, `[from, to]`.
    pub fn weights(&self) -> Tensor<2> {
        self.weight.val()
    }

    /// Maps `[rows, from]` to `[rows, to]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        linear(x, self.weight.val())
    }
}

/// Linear map, normalisation, ReLU.
#[derive(Module, Debug)]
pub struct Hidden {
    linear: Linear,
    norm: Norm,
}

impl Hidden {
    /// Initialises the linear map as [`Linear::init`].
    pub fn init(from: usize, to: usize, init: &mut Init) -> Self {
        Self {
            linear: Linear::init(from, to, init),
            norm: Norm::init(to, init),
        }
    }

    /// Returns whether rows are independent, because the statistics are not those of the batch.
    pub fn is_fixed(&self, device: &Device) -> bool {
        match &self.norm {
            Norm::Batch(norm) => norm.fixed(device).is_some(),
            Norm::Group(_) => true,
        }
    }

    /// Maps `[rows, from]` to `[rows, to]`.
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        match self.norm.fixed(&x.device()) {
            None => self.norm.forward(self.linear.forward(x), true),
            Some(fixed) => linear_norm(x, self.linear.weights(), fixed, EPSILON, true),
        }
    }
}
