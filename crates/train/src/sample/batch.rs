//! Batches: samples as tensors.

use super::Sample;
use super::images::image_tensor;
use crate::model::encoded_tensor;
use burn::tensor::{Device, Tensor, TensorData};
use image::RgbImage;
use lsdc_core::network::FeatureMap;
use lsdc_core::weights::Normalisation;
use lsdc_files::error::{Error, Result};

/// A batch of samples of the same size on a device.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Normalised images `[batch, height, width, 3]`.
    pub images: Tensor<4>,
    /// Features of a pretrained encoder, `[batch, rows, columns, channels]`.
    pub encoded: Option<Tensor<4>>,
    /// Rows and columns of the images.
    pub size: (usize, usize),
    /// Pixels of each image at which basis functions are evaluated.
    pub pixels: Vec<Vec<u32>>,
    /// Depths of the candidate points `[batch, points]` in metres; 0 = none.
    pub measured: Tensor<2>,
    /// Target depths at these pixels `[batch, pixels]` in metres; 0 = none.
    pub depths: Tensor<2>,
    /// Target depths of the whole images `[batch, height, width]` in metres; 0 = none.
    pub maps: Tensor<3>,
    /// Weights of errors in the whole images `[batch, height, width]`; `None` if they are equal.
    pub weights: Option<Tensor<3>>,
    /// Number of candidate points at the start of `pixels`.
    pub points: usize,
    /// Masks of the draws over the candidate points `[draws * batch, points]`, draw by draw.
    pub draws: Tensor<2>,
    /// Rows and columns of each patch.
    pub patch: (usize, usize),
}

impl Batch {
    /// Transfers samples to a device; colours become (value / 255 - mean) / deviation.
    ///
    /// # Errors
    /// No sample, or samples of different sizes.
    pub fn new(samples: &[Sample], normalisation: Normalisation, device: &Device) -> Result<Self> {
        let first = samples
            .first()
            .ok_or_else(|| Error::shape("a batch needs a sample"))?;
        let pixels = first.pixels.len();
        let points = first.draws.first().map_or(0, Vec::len);
        let draws = first.draws.len();
        if samples.iter().any(|s| {
            s.pixels.len() != pixels || s.patch != first.patch || s.map.len() != first.map.len()
        }) {
            return Err(Error::shape("the frames of a batch differ in size")
                .hint("set `protocol.resize` or `protocol.crop` so that all frames are alike"));
        }
        let images: Vec<&RgbImage> = samples.iter().map(|s| &s.rgb).collect();
        let features: Option<Vec<&FeatureMap>> =
            samples.iter().map(|s| s.encoded.as_ref()).collect();
        let encoded = features.map(|features| encoded_tensor(&features, device));
        let all = |of: fn(&Sample) -> &Vec<f32>| -> Vec<f32> {
            samples.iter().flat_map(|s| of(s).iter().copied()).collect()
        };
        let masks: Vec<f32> = (0..draws)
            .flat_map(|d| samples.iter().flat_map(move |s| s.draws[d].iter().copied()))
            .collect();
        let (height, width) = (first.rgb.height() as usize, first.rgb.width() as usize);
        let whole = |values: Vec<f32>| tensor(values, [samples.len(), height, width], device);
        let weighted = samples.iter().any(|s| s.weights.is_some());
        let weights = weighted.then(|| {
            let weights = samples.iter().flat_map(|s| match &s.weights {
                Some(weights) => weights.clone(),
                None => vec![1.0; s.map.len()],
            });
            whole(weights.collect())
        });
        Ok(Self {
            measured: tensor(all(|s| &s.measured), [samples.len(), points], device),
            maps: whole(all(|s| &s.map)),
            weights,
            images: image_tensor(&images, normalisation, device)?,
            encoded,
            size: (height, width),
            pixels: samples.iter().map(|s| s.pixels.clone()).collect(),
            depths: tensor(all(|s| &s.depths), [samples.len(), pixels], device),
            points,
            draws: tensor(masks, [draws * samples.len(), points], device),
            patch: first.patch,
        })
    }
}

fn tensor<const D: usize>(values: Vec<f32>, shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values, shape), device)
}
