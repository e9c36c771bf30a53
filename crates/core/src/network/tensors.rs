//! Layers from the tensors of a weights file, by name.

use super::config::EPSILON;
use super::executor::Prepare;
use crate::error::WeightsError;
use crate::tensor::Tensor;
use lsdc_kernels::conv::ConvSpec;
use lsdc_kernels::simd::{Level, Packed};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Tensors, and a record of those that have been used.
pub(super) struct Tensors<'a, P = Level> {
    all: &'a BTreeMap<String, Tensor>,
    used: RefCell<BTreeSet<&'a str>>,
    /// The target that layers are prepared for.
    pub(super) target: P,
}

/// A linear map of rows, with bias.
#[derive(Clone, Debug)]
pub struct LinearWeights {
    /// The number of outputs.
    pub columns: usize,
    /// Weights `[inputs, columns]`.
    pub values: Vec<f32>,
    /// One value for each output.
    pub bias: Vec<f32>,
}

impl LinearWeights {
    /// The number of inputs.
    pub fn rows(&self) -> usize {
        self.values.len() / self.columns.max(1)
    }

    /// Packs some rows, with another bias.
    pub(super) fn packed(&self, level: Level, rows: Range<usize>, bias: &[f32]) -> Packed {
        let at =
            |row: usize, column: usize| self.values[(rows.start + row) * self.columns + column];
        Packed::new(level, (rows.len(), self.columns), bias, at)
    }
}

impl<'a, P: Prepare> Tensors<'a, P> {
    pub(super) fn new(tensors: &'a BTreeMap<String, Tensor>, target: P) -> Self {
        Self {
            all: tensors,
            used: RefCell::default(),
            target,
        }
    }

    /// Returns the values of a tensor with this shape.
    pub(super) fn values(&self, name: &str, shape: &[usize]) -> Result<&'a [f32], WeightsError> {
        let (name, tensor) = self
            .all
            .get_key_value(name)
            .ok_or_else(|| WeightsError::tensor(name, "is missing"))?;
        if tensor.shape() != shape {
            let found = tensor.shape();
            let what = format!("has shape {found:?}, expected {shape:?}");
            return Err(WeightsError::tensor(name, what));
        }
        self.used.borrow_mut().insert(name);
        Ok(tensor.values())
    }

    /// Marks an optional tensor that is not needed as used.
    pub(super) fn ignore(&self, name: &str) {
        if let Some((name, _)) = self.all.get_key_value(name) {
            self.used.borrow_mut().insert(name);
        }
    }

    /// Checks that every tensor was used.
    pub(super) fn check_all_used(&self) -> Result<(), WeightsError> {
        let used = self.used.borrow();
        match self.all.keys().find(|name| !used.contains(name.as_str())) {
            None => Ok(()),
            Some(name) => Err(WeightsError::tensor(name, "is superfluous")),
        }
    }

    /// Returns slopes and offsets of the channels of a batch normalisation with its running statistics.
    fn batch_norm(
        &self,
        name: &str,
        channels: usize,
    ) -> Result<(Vec<f32>, Vec<f32>), WeightsError> {
        let values = |part: &str| self.values(&format!("{name}.norm.Batch.{part}"), &[channels]);
        let (gain, shift) = (values("gain")?, values("shift")?);
        let (mean, variance) = (values("running_mean")?, values("running_variance")?);
        let affine = |c: usize| {
            let slope = f64::from(gain[c]) / (f64::from(variance[c]) + EPSILON).sqrt();
            let offset = f64::from(shift[c]) - f64::from(mean[c]) * slope;
            (slope as f32, offset as f32)
        };
        Ok((0..channels).map(affine).unzip())
    }

    /// Prepares a convolution alone.
    pub(super) fn conv(
        &self,
        name: &str,
        sizes: [usize; 3],
        spec: ConvSpec,
    ) -> Result<P::Layer, WeightsError> {
        let [outputs, channels, taps] = sizes;
        let name = format!("{name}.weight");
        let values = self.values(&name, &[outputs, channels, taps, taps])?;
        Ok(self.target.layer(values, sizes, &[], spec))
    }

    /// Prepares a convolution and the normalisation after it as one convolution.
    pub(super) fn conv_norm(
        &self,
        name: &str,
        sizes: [usize; 3],
        spec: ConvSpec,
    ) -> Result<P::Layer, WeightsError> {
        let [outputs, channels, taps] = sizes;
        let weight = format!("{name}.conv.weight");
        let values = self.values(&weight, &[outputs, channels, taps, taps])?;
        let (slopes, bias) = self.batch_norm(name, outputs)?;
        let mut values = values.to_vec();
        let rows = values.chunks_exact_mut(channels * taps * taps);
        for (row, slope) in rows.zip(&slopes) {
            for value in row {
                *value *= slope;
            }
        }
        Ok(self.target.layer(&values, sizes, &bias, spec))
    }

    /// Prepares a linear map and the normalisation after it as one linear map.
    pub(super) fn linear_norm(
        &self,
        name: &str,
        (depth, columns): (usize, usize),
    ) -> Result<LinearWeights, WeightsError> {
        let weight = format!("{name}.linear.weight");
        let mut values = self.values(&weight, &[depth, columns])?.to_vec();
        let (slopes, bias) = self.batch_norm(name, columns)?;
        for row in values.chunks_exact_mut(columns) {
            let pairs = row.iter_mut().zip(&slopes);
            pairs.for_each(|(value, slope)| *value *= slope);
        }
        Ok(LinearWeights {
            columns,
            values,
            bias,
        })
    }
}
