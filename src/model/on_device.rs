//! The network on any device of burn, as completion uses one.

use super::{Bases, BasisNet};
use burn::tensor::{Device, Tensor, TensorData};
use lsdc_core::network::{Basis, Network};

/// A network as it was trained, on a device: the plain reference of the prepared one.
#[derive(Clone, Debug)]
pub struct OnDevice {
    net: BasisNet,
    device: Device,
}

impl OnDevice {
    /// A network whose weights are on that device.
    pub fn new(net: BasisNet, device: &Device) -> Self {
        Self {
            net,
            device: device.clone(),
        }
    }
}

/// What it says of one image.
#[derive(Debug)]
struct OfImage {
    bases: Bases,
    net: BasisNet,
    image: Tensor<4>,
}

impl Network for OnDevice {
    fn basis(&self, image: &[f32], (height, width): (usize, usize)) -> Box<dyn Basis> {
        let image = TensorData::new(image.to_vec(), [1, height, width, 3]);
        let image = Tensor::<4>::from_data(image, &self.device);
        Box::new(OfImage {
            bases: self.net.bases(image.clone()),
            net: self.net.clone(),
            image,
        })
    }
}

impl Basis for OfImage {
    fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        if places.is_empty() {
            return Vec::new();
        }
        let values = self.bases.at_places(size, places).into_data();
        values.iter::<f32>().collect()
    }

    fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        let weights: Vec<f32> = weights.iter().map(|&w| w as f32).collect();
        self.bases.combine(size, &weights)
    }

    fn affinities(&self) -> (Vec<f32>, (usize, usize)) {
        let values = self.net.affinities(self.image.clone());
        let [_, height, width, _] = values.dims();
        (values.into_data().iter::<f32>().collect(), (height, width))
    }
}
