use super::*;
use crate::model::random_encoder::{random_tensors, short};
use lsdc_core::network::Encoder;
use lsdc_kernels::simd::Level;
use lsdc_rng::Rng;

#[test]
fn it_computes_what_the_prepared_encoder_does() {
    let tensors = random_tensors();
    let device = Device::flex().autodiff();
    let transformer = VisionTransformer::new(short(), &tensors, &device).unwrap();
    let prepared = Encoder::new(short(), &tensors, Level::here()).unwrap();
    let mut rng = Rng::stream(0, &["vision"]);
    let (height, width) = (3 * PATCH, 4 * PATCH);
    let images: Vec<Vec<f32>> = (0..2)
        .map(|_| (0..3 * height * width).map(|_| rng.normal()).collect())
        .collect();
    let data = TensorData::new(images.concat(), [2, height, width, 3]);
    let input = Tensor::<4>::from_data(data, &device).require_grad();
    let output = transformer.forward(input.clone());
    assert_eq!(output.dims(), [2, 3, 4, short().channels()]);
    let gradients = output.clone().sum().backward();
    assert!(input.grad(&gradients).is_some());
    let found: Vec<f32> = output.into_data().iter::<f32>().collect();
    let channels = short().width;
    for (image, found) in images.iter().zip(found.chunks(found.len() / 2)) {
        let expected = prepared.features(image, (height, width)).unwrap();
        for (patch, found) in found.chunks(short().channels()).enumerate() {
            for (tap, found) in expected.taps.iter().zip(found.chunks(channels)) {
                for (a, b) in found.iter().zip(&tap[patch * channels..]) {
                    assert!((a - b).abs() < 2e-4, "{a} {b}");
                }
            }
        }
    }
}
