//! Waves on tensors, as columns beside those of base functions.

use super::JointConfig;
use crate::fit::Waves;
use burn::tensor::{Int, Tensor, TensorData};

/// Waves over images of one size, each times such a number that its weight counts as much as those of
/// base functions.
pub(super) struct Columns {
    waves: Waves,
    size: (usize, usize),
    scales: Tensor<1>,
}

impl Columns {
    /// `None` without waves; otherwise where, and of the type that, base functions are.
    pub(super) fn new(
        config: &JointConfig,
        size: (usize, usize),
        bases: &Tensor<3>,
    ) -> Option<Self> {
        let waves = Waves::up_to(config.waves);
        if waves.is_empty() {
            return None;
        }
        let ridges = waves.ridges(config.bending).into_iter();
        let scales: Vec<f64> = ridges.map(|r| (config.ridge / r).sqrt()).collect();
        let scales = TensorData::new(scales, [waves.len()]);
        Some(Self {
            scales: Tensor::from_data(scales, (&bases.device(), bases.dtype())),
            waves,
            size,
        })
    }

    pub(super) fn count(&self) -> usize {
        self.waves.len()
    }

    /// Values `[images, points, waves]` at pixels of each image.
    pub(super) fn at(&self, pixels: &[Vec<u32>]) -> Tensor<3> {
        let rows = pixels.iter();
        let rows = rows.flat_map(|list| self.waves.beside(&[], 0, self.size, list));
        let points = pixels.first().map_or(0, Vec::len);
        let shape = [pixels.len(), points, self.count()];
        self.constant::<3>(rows.collect(), shape) * self.scales.clone().unsqueeze()
    }

    /// Columns x weights `[maps, waves]` at every pixel: `[maps, height * width]`.
    pub(super) fn maps(&self, weights: Tensor<2>) -> Tensor<2> {
        let (height, width) = self.size;
        let [maps, waves] = weights.dims();
        let [across, down] = [0, 1].map(|axis| self.waves.most(axis) + 1);
        // Pairs that are left out read the 0 behind the weights.
        let mut places = vec![waves as i32; across * down];
        for (wave, &(p, q)) in self.waves.pairs().iter().enumerate() {
            places[q * across + p] = wave as i32;
        }
        let places = TensorData::new(places, [across * down]);
        let places = Tensor::<1, Int>::from_data(places, &weights.device());
        let none = self.constant(vec![0.0; maps], [maps, 1]);
        let weights = Tensor::cat(vec![weights * self.scales.clone().unsqueeze(), none], 1);
        let weights = weights.select(1, places).reshape([maps, down, across]);
        let rows = self.constant::<3>(self.waves.table(height, 1), [1, down, height]);
        let columns = self.constant::<3>(self.waves.table(width, 0), [1, across, width]);
        let values = rows.transpose().matmul(weights).matmul(columns);
        values.reshape([maps, height * width])
    }

    fn constant<const D: usize>(&self, values: Vec<f32>, shape: [usize; D]) -> Tensor<D> {
        let place = (&self.scales.device(), self.scales.dtype());
        Tensor::from_data(TensorData::new(values, shape), place)
    }
}
