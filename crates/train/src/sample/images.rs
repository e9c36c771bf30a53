//! Conversion of images to normalised colours, the input of networks.

use burn::tensor::{Device, Tensor, TensorData};
use image::RgbImage;
use lsdc_core::weights::Normalisation;
use lsdc_files::error::{Error, Result};

/// Converts images to `[batch, height, width, 3]`; colours become (value / 255 - mean) / deviation.
///
/// # Errors
/// No image, or images of different sizes.
pub fn image_tensor(
    images: &[&RgbImage],
    normalisation: Normalisation,
    device: &Device,
) -> Result<Tensor<4>> {
    let first = images
        .first()
        .ok_or_else(|| Error::shape("a batch needs an image"))?;
    let (width, height) = first.dimensions();
    if images.iter().any(|i| i.dimensions() != (width, height)) {
        return Err(Error::shape("the images of a batch differ in size"));
    }
    let (width, height) = (width as usize, height as usize);
    let values = images
        .iter()
        .flat_map(|image| image_values(image, normalisation))
        .collect();
    let shape = [images.len(), height, width, 3];
    Ok(Tensor::from_data(TensorData::new(values, shape), device))
}

/// Converts an image to `[height, width, 3]`; colours become (value / 255 - mean) / deviation.
pub fn image_values(image: &RgbImage, normalisation: Normalisation) -> Vec<f32> {
    let Normalisation {
        mean, deviation, ..
    } = normalisation;
    let tables: [[f32; 256]; 3] = std::array::from_fn(|c| {
        std::array::from_fn(|v| (v as f32 / 255.0 - mean[c]) / deviation[c])
    });
    let colours = image.as_raw().iter().enumerate();
    colours.map(|(i, &v)| tables[i % 3][v as usize]).collect()
}
