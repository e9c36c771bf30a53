//! Layers of a weights file as nodes, with the following normalisations folded in.

use super::graph::{Graph, int, ints};
use crate::error::{Error, Result};
use lsdc_core::network::EPSILON;
use lsdc_core::weights::Tensor;
use std::collections::BTreeMap;

/// A graph, and the tensors of its layers.
pub(super) struct Layers<'a> {
    pub(super) graph: Graph,
    tensors: &'a BTreeMap<String, Tensor>,
}

/// Parameters of a convolution.
#[derive(Clone, Copy)]
pub(super) struct Conv {
    pub(super) stride: i64,
    pub(super) dilation: i64,
    pub(super) groups: i64,
    pub(super) relu: bool,
}

impl Conv {
    /// Stride 1, followed by a ReLU.
    pub(super) const SAME: Self = Self {
        stride: 1,
        dilation: 1,
        groups: 1,
        relu: true,
    };
    pub(super) const HALVING: Self = Self {
        stride: 2,
        ..Self::SAME
    };

    pub(super) fn linear(self) -> Self {
        Self {
            relu: false,
            ..self
        }
    }
}

impl<'a> Layers<'a> {
    pub(super) fn new(tensors: &'a BTreeMap<String, Tensor>) -> Self {
        Self {
            graph: Graph::default(),
            tensors,
        }
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.tensors.contains_key(name)
    }

    pub(super) fn tensor(&self, name: &str) -> Result<&'a Tensor> {
        let missing = || Error::weights(format!("`{name}` is missing from the weights"));
        self.tensors.get(name).ok_or_else(missing)
    }

    /// Returns slopes and offsets of a batch normalisation with its running statistics.
    pub(super) fn batch_norm(&self, name: &str) -> Result<(Vec<f64>, Vec<f32>)> {
        let values = |part: &str| {
            let tensor = self.tensor(&format!("{name}.norm.Batch.{part}"))?;
            Ok::<_, Error>(tensor.values().iter().copied().map(f64::from))
        };
        let line = values("gain")?.zip(values("running_variance")?);
        let slopes: Vec<f64> = line.map(|(g, v)| g / (v + EPSILON).sqrt()).collect();
        let shifts = values("shift")?.zip(values("running_mean")?);
        let offsets = shifts.zip(&slopes).map(|((b, m), s)| (b - m * s) as f32);
        let offsets = offsets.collect();
        Ok((slopes, offsets))
    }

    /// Adds a convolution with the following normalisation folded in.
    pub(super) fn conv_norm(&mut self, x: &str, name: &str, conv: Conv) -> Result<String> {
        let tensor = self.tensor(&format!("{name}.conv.weight"))?;
        let (slopes, bias) = self.batch_norm(name)?;
        let row = (tensor.values().len() / slopes.len().max(1)).max(1);
        let rows = tensor.values().chunks_exact(row).zip(&slopes);
        let values: Vec<f32> = rows
            .flat_map(|(row, slope)| row.iter().map(move |v| (f64::from(*v) * slope) as f32))
            .collect();
        Ok(self.conv(x, name, (tensor.shape(), &values, Some(&bias)), conv))
    }

    /// Adds a convolution without normalisation.
    pub(super) fn plain(&mut self, x: &str, name: &str) -> Result<String> {
        let tensor = self.tensor(&format!("{name}.weight"))?;
        let weights = (tensor.shape(), tensor.values(), None);
        Ok(self.conv(x, name, weights, Conv::SAME.linear()))
    }

    /// Adds a convolution with weights `[outputs, channels, taps, taps]`, or `[outputs, channels]` for a single tap.
    pub(super) fn conv(
        &mut self,
        x: &str,
        name: &str,
        (shape, values, bias): (&[usize], &[f32], Option<&[f32]>),
        conv: Conv,
    ) -> String {
        let side = |axis: usize| shape.get(axis).copied().unwrap_or(1);
        let (outputs, taps) = (side(0), side(2));
        let shape = [outputs, side(1), taps, side(3)];
        let mut inputs = vec![x.to_owned()];
        inputs.push(self.graph.floats(format!("{name}.weight"), &shape, values));
        if let Some(bias) = bias {
            inputs.push(self.graph.floats(format!("{name}.bias"), &[outputs], bias));
        }
        let inputs: Vec<&str> = inputs.iter().map(String::as_str).collect();
        let attributes = [
            ints("kernel_shape", &[taps as i64; 2]),
            ints("strides", &[conv.stride; 2]),
            ints("dilations", &[conv.dilation; 2]),
            ints("pads", &[conv.dilation * (taps as i64 / 2); 4]),
            int("group", conv.groups),
        ];
        let y = self.graph.node("Conv", &inputs, attributes);
        if conv.relu {
            self.graph.apply("Relu", &[&y])
        } else {
            y
        }
    }

    /// Adds an upsampled map to another one.
    pub(super) fn add_enlarged(&mut self, x: &str, coarse: &str) -> String {
        let size = self.graph.size(x);
        let enlarged = self.graph.resize(coarse, &size);
        self.graph.apply("Add", &[x, &enlarged])
    }
}
