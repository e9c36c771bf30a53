//! The network on any burn device, for completion.

use super::{Bases, BasisNet, VisionTransformer};
use burn::tensor::{Device, Tensor, TensorData};
use lsdc_core::network::{
    Basis, Encoder, EncoderSide, FeatureMap, Forward, Network, PATCH, in_patches,
};
use lsdc_core::{Error, Result, WeightsError};
use std::sync::Arc;

/// A trained network on a device: the plain reference of the prepared one.
#[derive(Clone, Debug)]
pub struct OnDevice {
    net: BasisNet,
    encoder: Option<AnyEncoder>,
    device: Device,
}

/// The pretrained encoder of a network.
#[derive(Clone, Debug)]
pub enum AnyEncoder {
    /// Prepared for the CPU.
    Prepared(Arc<Encoder>),
    /// On the device of the network.
    OnDevice(Arc<VisionTransformer>),
}

impl OnDevice {
    /// Wraps a network with weights on `device`, with an encoder if it was trained on one.
    pub fn new(net: BasisNet, encoder: Option<AnyEncoder>, device: &Device) -> Self {
        Self {
            net,
            encoder,
            device: device.clone(),
        }
    }

    fn encoded(&self, image: &[f32], size: (usize, usize)) -> Result<Option<Tensor<4>>> {
        if self.net.extractor.encoded.is_none() {
            return Ok(None);
        }
        Ok(Some(match &self.encoder {
            None => return Err(WeightsError::NoEncoder.into()),
            Some(AnyEncoder::Prepared(encoder)) => encoded_tensor(
                &[&encoder.encode(image, size, EncoderSide::default())?],
                &self.device,
            ),
            Some(AnyEncoder::OnDevice(transformer)) => {
                let (image, (rows, columns)) = in_patches(image, size, EncoderSide::default())?;
                let shape = [1, rows * PATCH, columns * PATCH, 3];
                let image = Tensor::from_data(TensorData::new(image, shape), &self.device);
                transformer.forward(image)
            }
        }))
    }
}

/// Concatenates the features of images of the same size, `[images, rows, columns, channels]`.
pub fn encoded_tensor(images: &[&FeatureMap], device: &Device) -> Tensor<4> {
    let values: Vec<f32> = images
        .iter()
        .flat_map(|e| e.values.iter().copied())
        .collect();
    let (rows, columns) = images.first().map_or((0, 0), |e| (e.rows, e.columns));
    let channels = values.len() / (images.len() * rows * columns).max(1);
    let shape = [images.len(), rows, columns, channels];
    Tensor::from_data(TensorData::new(values, shape), device)
}

/// The features of an image.
#[derive(Debug)]
struct DeviceForward {
    net: BasisNet,
    image: Tensor<4>,
    encoded: Option<Tensor<4>>,
}

impl Network for OnDevice {
    fn forward(&self, image: &[f32], size: (usize, usize)) -> Result<Box<dyn Forward>, Error> {
        let encoded = self.encoded(image, size)?;
        let image = TensorData::new(image.to_vec(), [1, size.0, size.1, 3]);
        Ok(Box::new(DeviceForward {
            net: self.net.clone(),
            image: Tensor::from_data(image, &self.device),
            encoded,
        }))
    }
}

impl Forward for DeviceForward {
    fn basis(&self) -> Box<dyn Basis> {
        let bases = self.net.bases(self.image.clone(), self.encoded.clone());
        Box::new(DeviceBasis(bases))
    }

    fn affinities(&self) -> (Vec<f32>, (usize, usize)) {
        let values = self
            .net
            .affinities(self.image.clone(), self.encoded.clone());
        let [_, height, width, _] = values.dims();
        (values.into_data().iter::<f32>().collect(), (height, width))
    }
}

#[derive(Debug)]
struct DeviceBasis(Bases);

impl Basis for DeviceBasis {
    fn at(&self, size: (usize, usize), places: &[[f64; 2]]) -> Vec<f32> {
        if places.is_empty() {
            return Vec::new();
        }
        let values = self.0.at_places(size, places).into_data();
        values.iter::<f32>().collect()
    }

    fn combine(&self, size: (usize, usize), weights: &[f64]) -> Vec<f32> {
        let weights: Vec<f32> = weights.iter().map(|&w| w as f32).collect();
        self.0.combine(size, &weights)
    }
}
