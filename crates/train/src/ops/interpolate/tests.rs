//! Values and gradients of the fast f32 path against burn's own operations in f64.

use super::{BilinearCell, interpolate};
use burn::tensor::{DType, Device, Tensor, TensorData};
use lsdc_rng::Rng;

fn random(count: usize, name: &str) -> Vec<f64> {
    let mut rng = Rng::stream(0, &["interpolate", name]);
    (0..count).map(|_| f64::from(rng.normal())).collect()
}

/// Returns the cells of an image of `rows` rows; many cells have the same row twice.
fn cells(count: usize, rows: usize, name: &str) -> Vec<BilinearCell> {
    let mut rng = Rng::stream(0, &["interpolate", name]);
    let mut cell = || BilinearCell {
        rows: std::array::from_fn(|_| rng.below(rows as u32)),
        shares: std::array::from_fn(|_| rng.normal()),
    };
    (0..count).map(|_| cell()).collect()
}

/// Returns the result and the gradient of its product with a random direction.
fn run([images, rows, channels]: [usize; 3], count: usize, dtype: DType) -> [Vec<f64>; 2] {
    let device = Device::flex().autodiff();
    let tensor = |shape: [usize; 2], name: &str| {
        let data = TensorData::new(random(shape[0] * shape[1], name), shape);
        Tensor::<2>::from_data(data, (&device, dtype))
    };
    let table = tensor([images * rows, channels], "table").require_grad();
    let lists = (0..images).map(|image| cells(count, rows, &image.to_string()));
    let output = interpolate(
        table.clone().reshape([images, rows, channels]),
        lists.collect(),
    );
    assert_eq!(output.dims(), [images * count, channels]);
    let direction = tensor([images * count, channels], "direction");
    let gradients = (output.clone() * direction).sum().backward();
    let gradient = table.grad(&gradients).expect("a gradient");
    [output.into_data(), gradient.into_data()].map(|data| data.iter::<f64>().collect())
}

#[test]
fn images_agree_with_burns_own_operations() {
    for (shape, count) in [
        ([1, 1, 1], 1),
        ([2, 6, 3], 40),
        ([3, 50, 19], 1300),
        ([1, 7, 32], 0),
    ] {
        let fast = run(shape, count, DType::F32);
        let reference = run(shape, count, DType::F64);
        for (fast, reference) in fast.iter().zip(&reference) {
            assert_eq!(fast.len(), reference.len());
            for (a, b) in fast.iter().zip(reference) {
                assert!((a - b).abs() < 1e-4 * (1.0 + b.abs()), "{shape:?}: {a} {b}");
            }
        }
    }
}
