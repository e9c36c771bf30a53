use super::*;
use burn::tensor::{Device, TensorData};

#[test]
fn sums_are_those_of_single_values() {
    let device = Device::flex();
    // More values than one thread takes.
    let values = |seed: usize| -> Vec<f32> {
        (0..70_000)
            .map(|i| ((i * seed) % 1009) as f32 / 7.0)
            .collect()
    };
    let tensor = |values: Vec<f32>| -> Tensor<2> {
        Tensor::from_data(TensorData::new(values, [100, 700]), &device)
    };
    let (x, y) = (values(3), values(5));
    // A transposed view is read in its own order.
    let flipped = tensor(y.clone()).reshape([700, 100]).transpose();
    let found = weighted_sum(tensor(x.clone()), 0.95, flipped, -2.5).into_data();
    for (at, found) in found.iter::<f32>().enumerate() {
        let (row, column) = (at / 700, at % 700);
        let expected = 0.95 * x[at] + -2.5 * y[column * 100 + row];
        assert!((found - expected).abs() < 1e-4, "{at}: {found} {expected}");
    }
}
