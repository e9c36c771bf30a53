//! Values and gradients of the folded f32 path against burn's own operations in f64, and gradients against differences.

use super::{ConvNormSpec, FixedNorm, conv_norm, linear_norm};
use crate::ops::conv::ConvSpec;
use burn::tensor::{DType, Device, Tensor, TensorData};
use lsdc_rng::Rng;

/// Sizes of a layer: batch, height, width, inputs, outputs, taps.
type Sizes = [usize; 6];

fn random(count: usize, name: &str) -> Vec<f64> {
    let mut rng = Rng::stream(0, &["conv-norm", name]);
    (0..count).map(|_| f64::from(rng.normal()) + 0.3).collect()
}

/// Returns input, weights, gain and shift.
fn arguments([batch, height, width, inputs, outputs, taps]: Sizes) -> [Vec<f64>; 4] {
    [
        random(batch * height * width * inputs, "x"),
        random(outputs * inputs * taps * taps, "weight"),
        random(outputs, "gain"),
        random(outputs, "shift"),
    ]
}

/// Returns a weighted sum of the outputs, all outputs, and the gradients of the sum.
fn run(
    sizes: Sizes,
    arguments: &[Vec<f64>; 4],
    spec: ConvNormSpec,
    dtype: DType,
) -> (f64, Vec<f64>, [Vec<f64>; 4]) {
    let [batch, height, width, inputs, outputs, taps] = sizes;
    let device = Device::flex().autodiff();
    let images = |values: &[f64], dims: [usize; 4]| {
        Tensor::<4>::from_data(TensorData::new(values.to_vec(), dims), (&device, dtype))
    };
    let vector = |values: &[f64]| {
        Tensor::<1>::from_data(
            TensorData::new(values.to_vec(), [outputs]),
            (&device, dtype),
        )
    };
    let x = images(&arguments[0], [batch, height, width, inputs]).require_grad();
    let weight = images(&arguments[1], [outputs, inputs, taps, taps]).require_grad();
    let (gain, shift) = (vector(&arguments[2]), vector(&arguments[3]));
    let (gain, shift) = (gain.require_grad(), shift.require_grad());
    let fixed = FixedNorm {
        gain: gain.clone(),
        shift: shift.clone(),
        mean: vector(&random(outputs, "mean")),
        variance: vector(&random(outputs, "variance")).abs() + 0.5,
    };
    let y = conv_norm(x.clone(), weight.clone(), fixed, spec);
    let dims = y.dims();
    let direction = images(&random(dims.iter().product(), "direction"), dims);
    let sum = (y.clone() * direction).sum();
    let gradients = sum.backward();
    let read = |data: TensorData| data.iter::<f64>().collect::<Vec<_>>();
    let gradients = [
        read(x.grad(&gradients).unwrap().into_data()),
        read(weight.grad(&gradients).unwrap().into_data()),
        read(gain.grad(&gradients).unwrap().into_data()),
        read(shift.grad(&gradients).unwrap().into_data()),
    ];
    (sum.into_scalar::<f64>(), read(y.into_data()), gradients)
}

fn specs(conv: ConvSpec) -> [ConvNormSpec; 2] {
    [true, false].map(|relu| ConvNormSpec {
        conv,
        epsilon: 1e-5,
        relu,
    })
}

#[test]
fn folded_layers_agree_with_one_layer_after_the_other() {
    for (sizes, conv) in [
        ([2, 7, 9, 3, 5, 3], ConvSpec::same(1)),
        ([1, 30, 41, 17, 33, 3], ConvSpec::same(2)),
        ([2, 21, 18, 8, 16, 3], ConvSpec::halving()),
        ([3, 40, 50, 6, 4, 1], ConvSpec::pointwise()),
        // More pixels than one chunk of a sum.
        ([2, 61, 70, 6, 17, 1], ConvSpec::pointwise()),
    ] {
        for spec in specs(conv) {
            let arguments = arguments(sizes);
            let (_, fast, fast_gradients) = run(sizes, &arguments, spec, DType::F32);
            let (_, plain, plain_gradients) = run(sizes, &arguments, spec, DType::F64);
            let pairs = [(&fast, &plain)].into_iter();
            for (a, b) in pairs.chain(fast_gradients.iter().zip(&plain_gradients)) {
                assert_eq!(a.len(), b.len());
                let largest = b.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
                for (x, y) in a.iter().zip(b) {
                    let off = (x - y).abs();
                    assert!(off < 2e-5 * largest, "{sizes:?} {spec:?}: {x} {y}");
                }
            }
        }
    }
}

#[test]
fn gradients_are_those_of_differences() {
    let sizes = [1, 4, 5, 2, 3, 3];
    for spec in specs(ConvSpec::same(1)) {
        let arguments = arguments(sizes);
        let (_, _, gradients) = run(sizes, &arguments, spec, DType::F64);
        for (which, gradient) in gradients.iter().enumerate() {
            for (i, gradient) in gradient.iter().enumerate() {
                let at = |step: f64| {
                    let mut moved = arguments.clone();
                    moved[which][i] += step;
                    run(sizes, &moved, spec, DType::F64).0
                };
                let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
                let off = (numeric - gradient).abs();
                assert!(off < 1e-6 * gradient.abs().max(1.0), "{numeric} {gradient}");
            }
        }
    }
}

#[test]
fn rows_are_pixels() {
    let device = Device::flex();
    let tensor = |values: Vec<f32>, dims: [usize; 2]| {
        Tensor::<2>::from_data(TensorData::new(values, dims), &device)
    };
    let vector = |values: [f32; 2]| Tensor::<1>::from_data(values, &device);
    let fixed = FixedNorm {
        gain: vector([2.0, -1.0]),
        shift: vector([0.5, 1.0]),
        mean: vector([1.0, 0.0]),
        variance: vector([4.0, 0.25]),
    };
    let x = tensor(vec![1.0, 2.0, 3.0, -1.0, 0.0, 1.0], [2, 3]);
    let weight = tensor(vec![1.0, 0.0, 0.0, 1.0, 1.0, 1.0], [3, 2]);
    let y = linear_norm(x, weight, fixed, 0.0, true);
    // Sums (4, 5) and (0, 1); then (4 - 1) / 2 * 2 + 0.5, 1 - 5 / 0.5, clipped at 0, and so on.
    let y: Vec<f32> = y.into_data().iter().collect();
    assert_eq!(y, [3.5, 0.0, 0.0, 0.0]);
}
