//! The cosine basis on tensors, as columns after those of basis functions.

use burn::tensor::{Int, Tensor, TensorData};
use lsdc_core::fit::{CosineBasis, JointConfig};

/// The cosine basis over images of one size, scaled so that the weight of each cosine is penalised like those of basis
/// functions.
pub(super) struct CosineColumns {
    cosines: CosineBasis,
    size: (usize, usize),
    scales: Tensor<1>,
}

impl CosineColumns {
    /// Returns `None` without cosines; otherwise the basis, with the device and type of basis functions.
    pub(super) fn new(
        config: &JointConfig,
        size: (usize, usize),
        bases: &Tensor<3>,
    ) -> Option<Self> {
        let cosines = CosineBasis::up_to(config.cosines);
        if cosines.is_empty() {
            return None;
        }
        let ridges = cosines.ridges(config.bending).into_iter();
        let scales: Vec<f64> = ridges.map(|r| (config.ridge / r).sqrt()).collect();
        let scales = TensorData::new(scales, [cosines.len()]);
        Some(Self {
            scales: Tensor::from_data(scales, (&bases.device(), bases.dtype())),
            cosines,
            size,
        })
    }

    pub(super) fn count(&self) -> usize {
        self.cosines.len()
    }

    /// Returns the values `[images, points, cosines]` at pixels of each image.
    pub(super) fn at(&self, pixels: &[Vec<u32>]) -> Tensor<3> {
        let place = |&pixel: &u32| {
            let pixel = pixel as usize;
            [(pixel % self.size.1) as f64, (pixel / self.size.1) as f64]
        };
        let rows = pixels.iter().flat_map(|list| {
            let places: Vec<_> = list.iter().map(place).collect();
            self.cosines.append_to(&[], 0, self.size, &places)
        });
        let points = pixels.first().map_or(0, Vec::len);
        let shape = [pixels.len(), points, self.count()];
        self.constant::<3>(rows.collect(), shape) * self.scales.clone().unsqueeze()
    }

    /// Multiplies cosines by weights `[maps, cosines]` at every pixel: `[maps, height * width]`.
    pub(super) fn maps(&self, weights: Tensor<2>) -> Tensor<2> {
        let (height, width) = self.size;
        let [maps, cosines] = weights.dims();
        let [across, down] = [0, 1].map(|axis| self.cosines.most(axis) + 1);
        // Pairs that are left out read the 0 after the weights.
        let mut places = vec![cosines as i32; across * down];
        for (wave, &(p, q)) in self.cosines.pairs().iter().enumerate() {
            places[q * across + p] = wave as i32;
        }
        let places = TensorData::new(places, [across * down]);
        let places = Tensor::<1, Int>::from_data(places, &weights.device());
        let none = self.constant(vec![0.0; maps], [maps, 1]);
        let weights = Tensor::cat(vec![weights * self.scales.clone().unsqueeze(), none], 1);
        let weights = weights.select(1, places).reshape([maps, down, across]);
        let rows = self.constant::<3>(self.cosines.table(height, 1), [1, down, height]);
        let columns = self.constant::<3>(self.cosines.table(width, 0), [1, across, width]);
        let values = rows.transpose().matmul(weights).matmul(columns);
        values.reshape([maps, height * width])
    }

    fn constant<const D: usize>(&self, values: Vec<f32>, shape: [usize; D]) -> Tensor<D> {
        let place = (&self.scales.device(), self.scales.dtype());
        Tensor::from_data(TensorData::new(values, shape), place)
    }
}
