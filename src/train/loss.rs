//! The three losses of the paper (section 3.4), on the pixels of a batch.

use crate::error::{Error, Result};
use crate::fit::{Reweighting, Solver, lstsq, reweighted};
use crate::model::BasisNet;
use crate::sample::Batch;
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

/// Weights of the losses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossConfig {
    /// Mean absolute depth error in metres.
    pub l1: f64,
    /// Mean squared depth error in square metres.
    pub l2: f64,
    /// Mean absolute error of the differences between neighbouring pixels, in metres.
    pub gradient: f64,
    /// Mean absolute weight of a base function, in metres.
    pub regularisation: f64,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            l1: 1.0,
            l2: 1.0,
            gradient: 1.0,
            regularisation: 1e-3,
        }
    }
}

impl LossConfig {
    pub(super) fn check(&self) -> Result<()> {
        let all = [self.l1, self.l2, self.gradient, self.regularisation];
        if all.iter().all(|w| *w >= 0.0 && w.is_finite()) && self.l1 + self.l2 > 0.0 {
            Ok(())
        } else {
            Err(Error::config(
                "`loss`: weights must be at least 0, and `l1` or `l2` above 0",
            ))
        }
    }
}

/// The losses of a batch, each a scalar `[1]`.
#[derive(Clone, Debug)]
pub struct Losses {
    /// The weighted sum, to be differentiated.
    pub total: Tensor<1>,
    /// Mean absolute error in metres.
    pub l1: Tensor<1>,
    /// Mean squared error in square metres.
    pub l2: Tensor<1>,
}

/// Runs the network once and one fit per draw, and compares with the depths of the batch.
pub fn losses(
    net: &BasisNet,
    batch: &Batch,
    solver: Solver,
    robust: Option<Reweighting>,
    config: &LossConfig,
) -> Losses {
    let [images, pixels] = batch.depths.dims();
    let points = batch.points;
    let draws = batch.draws.dims()[0] / images;
    let bases = net
        .bases(batch.images.clone())
        .at(batch.size, &batch.pixels);
    let functions = bases.dims()[2];

    let at_points = bases
        .clone()
        .slice([0..images, 0..points])
        .repeat_dim(0, draws);
    let depths = batch.depths.clone().slice([0..images, 0..points]);
    let (depths, draw) = (depths.repeat_dim(0, draws), batch.draws.clone());
    let weights = match robust {
        None => lstsq(at_points, depths, draw, solver),
        Some(settings) => reweighted(at_points, depths, draw, solver, settings).0,
    };
    let weights = weights
        .reshape([draws, images, functions])
        .permute([1, 2, 0]);
    // [images, pixels, draws]
    let fitted = bases.matmul(weights.clone());

    let depths = batch.depths.clone().reshape([images, pixels, 1]);
    let valid = depths.clone().greater_elem(0.0).float();
    let error = (fitted - depths) * valid.clone();
    let count = (valid.clone().sum() * draws as f64).clamp_min(1.0);
    let l1 = error.clone().abs().sum() / count.clone();
    let l2 = error.clone().square().sum() / count;
    let mut total = l1.clone() * config.l1 + l2.clone() * config.l2;
    if config.gradient > 0.0 {
        total = total + gradient(error, valid, points, batch.patch) * config.gradient;
    }
    if config.regularisation > 0.0 {
        total = total + weights.abs().mean() * config.regularisation;
    }
    Losses { total, l1, l2 }
}

/// Differences of the error between horizontal and vertical neighbours inside the patches, where
/// both have a depth.
fn gradient(
    error: Tensor<3>,
    valid: Tensor<3>,
    points: usize,
    (height, width): (usize, usize),
) -> Tensor<1> {
    let [images, pixels, draws] = error.dims();
    let patches = images * (pixels - points) / (height * width);
    let cut = |t: Tensor<3>| {
        let channels = t.dims()[2];
        t.slice([0..images, points..pixels])
            .reshape([patches, height, width, channels])
    };
    let (error, valid) = (cut(error), cut(valid));
    let mut sum = Tensor::zeros([1], &error.device());
    let mut count = Tensor::zeros([1], &error.device());
    for axis in [1, 2] {
        let length = [patches, height, width][axis];
        let pair = |t: &Tensor<4>| {
            (
                t.clone().narrow(axis, 1, length - 1),
                t.clone().narrow(axis, 0, length - 1),
            )
        };
        let ((next, here), (v_next, v_here)) = (pair(&error), pair(&valid));
        let both = v_next * v_here;
        sum = sum + ((next - here) * both.clone()).abs().sum();
        count = count + both.sum() * draws as f64;
    }
    sum / count.clamp_min(1.0)
}
