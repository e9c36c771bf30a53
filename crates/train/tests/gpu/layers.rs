//! Values and gradients of the kernels of layers against burn's own operations on the CPU in f64.

use crate::{gpu, off};
use burn::tensor::{DType, Device, Tensor, TensorData};
use lsdc_rng::Rng;
use lsdc_train::ops::conv::{ConvSpec, conv2d};
use lsdc_train::ops::conv_norm::{ConvNormSpec, FixedNorm, conv_norm};
use lsdc_train::ops::interpolate::{
    Between, BilinearCell, PixelReads, interpolate, interpolate_pixels,
};
use lsdc_train::ops::norm::{NormSpec, moments, normalise};
use lsdc_train::ops::pack::Layout;
use lsdc_train::ops::weighted_sum::weighted_sum;

/// Draws random numbers around `mean`, from the stream of a name.
fn random(count: usize, name: &str, mean: f64) -> Vec<f64> {
    let mut rng = Rng::stream(0, &["layers", name]);
    (0..count)
        .map(|_| f64::from(rng.normal() + mean as f32))
        .collect()
}

fn tensor<const D: usize>(
    shape: [usize; D],
    (name, mean): (&str, f64),
    device: &Device,
    dtype: DType,
) -> Tensor<D> {
    let values = random(shape.iter().product(), name, mean);
    Tensor::from_data(TensorData::new(values, shape), (device, dtype))
}

fn read(data: TensorData) -> Vec<f64> {
    data.iter::<f64>().collect()
}

/// Compares the results of the GPU in f32 with those of the CPU in f64.
fn check(what: &str, tolerance: f64, run: impl Fn(&Device, DType) -> Vec<Vec<f64>>) {
    let Some(gpu) = gpu() else { return };
    let found = run(&gpu.autodiff(), DType::F32);
    let expected = run(&Device::flex().autodiff(), DType::F64);
    assert_eq!(found.len(), expected.len());
    for (part, (found, expected)) in found.iter().zip(&expected).enumerate() {
        let off = off(found, expected);
        assert!(off < tolerance, "{what}, part {part}: {off:.1e}");
    }
}

#[test]
fn convolutions_agree() {
    let wide = ConvSpec {
        stride: 2,
        ..ConvSpec::pointwise()
    };
    let three = [ConvSpec::same(1), ConvSpec::same(2), ConvSpec::halving()];
    let mut cases = Vec::new();
    for size in [[2, 1, 1], [2, 2, 5], [2, 7, 9], [1, 33, 20]] {
        cases.extend(three.map(|spec| (size, [3, 5], 3, spec)));
        cases.extend([ConvSpec::pointwise(), wide].map(|spec| (size, [6, 4], 1, spec)));
    }
    // Sizes around those of tiles, and gradients in several parts.
    for channels in [[16, 32], [17, 33], [64, 64], [70, 130], [130, 20]] {
        cases.extend(three.map(|spec| ([2, 31, 18], channels, 3, spec)));
        cases.push(([2, 31, 18], channels, 1, ConvSpec::pointwise()));
    }
    // As many pixels as larger tiles need.
    cases.push(([1, 258, 255], [5, 6], 3, ConvSpec::same(1)));
    for (taps, stride) in [(3, 1), (5, 2)] {
        cases.push(([2, 7, 9], [24, 24], taps, ConvSpec::depthwise(taps, stride)));
    }
    for (size, [channels, outputs], taps, spec) in cases {
        let [batch, height, width] = size;
        let what = format!("{size:?} {channels} {outputs} {taps} {spec:?}");
        check(&what, 2e-6, |device, dtype| {
            let shape = [batch, height, width, channels];
            let x = tensor(shape, ("x", 0.0), device, dtype).require_grad();
            let per_output = if spec.depthwise { 1 } else { channels };
            let shape = [outputs, per_output, taps, taps];
            let weight = tensor(shape, ("weight", 0.0), device, dtype).require_grad();
            let y = conv2d(x.clone(), weight.clone(), spec);
            let along = tensor(y.dims(), ("along", 0.0), device, dtype);
            let gradients = (y.clone() * along).sum().backward();
            vec![
                read(y.into_data()),
                read(x.grad(&gradients).unwrap().into_data()),
                read(weight.grad(&gradients).unwrap().into_data()),
            ]
        });
    }
}

#[test]
fn normalisation_agrees() {
    for shape in [[1, 2, 5, 1], [2, 5, 4, 3], [1, 20, 9, 33], [3, 40, 30, 70]] {
        for (own, relu) in [(true, true), (true, false), (false, true), (false, false)] {
            let spec = NormSpec {
                epsilon: 1e-5,
                relu,
                own,
            };
            // A large mean must not cost precision of the variance.
            check(&format!("{shape:?} {spec:?}"), 1e-4, |device, dtype| {
                let x = tensor(shape, ("x", 20.0), device, dtype).require_grad();
                let vector = |name, mean| tensor([shape[3]], (name, mean), device, dtype);
                let gain = vector("gain", 0.5).require_grad();
                let shift = vector("shift", 0.2).require_grad();
                let (mean, variance) = if own {
                    moments(x.clone())
                } else {
                    (vector("mean", 20.0), vector("variance", 0.0).abs() + 0.5)
                };
                let statistics = [mean.clone(), variance.clone()];
                let y = normalise(x.clone(), gain.clone(), shift.clone(), mean, variance, spec);
                let along = tensor(shape, ("along", 0.0), device, dtype);
                let gradients = (y.clone() * along).sum().backward();
                let mut all = vec![
                    read(y.into_data()),
                    read(x.grad(&gradients).unwrap().into_data()),
                    read(gain.grad(&gradients).unwrap().into_data()),
                    read(shift.grad(&gradients).unwrap().into_data()),
                ];
                all.extend(statistics.map(|s| read(s.into_data())));
                all
            });
        }
    }
}

#[test]
fn convolutions_with_normalisation_agree() {
    let layers = [
        ([3, 5], 3, ConvSpec::same(1)),
        ([17, 33], 1, ConvSpec::pointwise()),
    ];
    for (([inputs, outputs], taps, conv), relu) in layers
        .into_iter()
        .flat_map(|layer| [true, false].map(|relu| (layer, relu)))
    {
        let spec = ConvNormSpec {
            conv,
            epsilon: 1e-5,
            relu,
        };
        check(&format!("{spec:?}"), 1e-4, |device, dtype| {
            let x = tensor([2, 13, 9, inputs], ("x", 0.3), device, dtype).require_grad();
            let weight = tensor(
                [outputs, inputs, taps, taps],
                ("weight", 0.0),
                device,
                dtype,
            );
            let weight = weight.require_grad();
            let vector = |name, mean| tensor([outputs], (name, mean), device, dtype);
            let gain = vector("gain", 0.5).require_grad();
            let shift = vector("shift", 0.2).require_grad();
            let fixed = FixedNorm {
                gain: gain.clone(),
                shift: shift.clone(),
                mean: vector("mean", 0.0),
                variance: vector("variance", 0.0).abs() + 0.5,
            };
            let y = conv_norm(x.clone(), weight.clone(), fixed, spec);
            let along = tensor(y.dims(), ("along", 0.0), device, dtype);
            let gradients = (y.clone() * along).sum().backward();
            vec![
                read(y.into_data()),
                read(x.grad(&gradients).unwrap().into_data()),
                read(weight.grad(&gradients).unwrap().into_data()),
                read(gain.grad(&gradients).unwrap().into_data()),
                read(shift.grad(&gradients).unwrap().into_data()),
            ]
        });
    }
}

#[test]
fn reading_between_pixels_agrees() {
    for ([images, rows, channels], count) in [
        ([1, 1, 1], 1),
        ([2, 6, 3], 40),
        ([3, 50, 19], 1300),
        ([1, 7, 32], 0),
    ] {
        let mut rng = Rng::stream(0, &["between", &count.to_string()]);
        let mut cell = || BilinearCell {
            rows: std::array::from_fn(|_| rng.below(rows as u32)),
            shares: std::array::from_fn(|_| rng.normal()),
        };
        let mut list = || (0..count).map(|_| cell()).collect();
        let cells: Vec<Vec<BilinearCell>> = (0..images).map(|_| list()).collect();
        check(
            &format!("{images} {rows} {channels}"),
            1e-6,
            |device, dtype| {
                let shape = [images, rows, channels];
                let table = tensor(shape, ("table", 0.0), device, dtype).require_grad();
                let values = interpolate(table.clone(), cells.clone());
                let along = tensor(values.dims(), ("along", 0.0), device, dtype);
                let gradients = (values.clone() * along).sum().backward();
                vec![
                    read(values.into_data()),
                    read(table.grad(&gradients).unwrap().into_data()),
                ]
            },
        );
    }
}

#[test]
fn reading_at_pixels_agrees() {
    // Maps smaller and larger than images, and of one value.
    for (map, size) in [
        ([3, 4], [9, 13]),
        ([9, 7], [5, 6]),
        ([1, 1], [4, 7]),
        ([5, 5], [5, 5]),
    ] {
        let axis = |from: usize, to: usize| -> Vec<Between> {
            let place = |i: usize| (i as f32 + 0.5) * to as f32 / from as f32 - 0.5;
            let between = |i: usize| {
                let place = place(i).clamp(0.0, (to - 1) as f32);
                let low = (place as usize).min(to.saturating_sub(2));
                (low, (low + 1).min(to - 1), place - low as f32)
            };
            (0..from).map(between).collect()
        };
        let axes = || [axis(size[0], map[0]), axis(size[1], map[1])];
        let mut rng = Rng::stream(0, &["pixels"]);
        let all = (size[0] * size[1]) as u32;
        // Some pixels twice, and others not at all.
        let lists: Vec<Vec<u32>> = (0..2)
            .map(|_| (0..all).map(|_| rng.below(all)).collect())
            .collect();
        for listed in [false, true] {
            check(
                &format!("{map:?} {size:?} {listed}"),
                1e-6,
                |device, dtype| {
                    let shape = [2, map[0], map[1], 5];
                    let maps = tensor(shape, ("maps", 0.0), device, dtype).require_grad();
                    let reads = if listed {
                        PixelReads::some(map, axes(), lists.clone())
                    } else {
                        PixelReads::every(map, 2, axes())
                    };
                    let values = interpolate_pixels(maps.clone(), reads);
                    let along = tensor(values.dims(), ("along", 0.0), device, dtype);
                    let gradients = (values.clone() * along).sum().backward();
                    vec![
                        read(values.into_data()),
                        read(maps.grad(&gradients).unwrap().into_data()),
                    ]
                },
            );
        }
    }
}

#[test]
fn parts_and_weighted_sums_agree() {
    let lengths = [3, 64, 65, 65, 1, 300, 7, 2, 130];
    check("parts", 1e-6, |device, dtype| {
        let device = &device.clone().inner();
        let mut layout = Layout::default();
        layout.push(1, 3);
        layout.push(1, 64);
        layout.push(2, 65);
        for &length in &lengths[4..] {
            layout.push(1, length);
        }
        let part = |i: usize| tensor([lengths[i]], (&format!("part {i}"), 0.0), device, dtype);
        let parts: Vec<Tensor<1>> = (0..lengths.len()).map(part).collect();
        let packed = layout.pack(&parts);
        // Parts of a vector are operands like any other.
        let own = (0..lengths.len()).map(|i| layout.part(&packed, i));
        let sums = own
            .zip(parts)
            .map(|(own, part)| weighted_sum(own, 2.0, part, -0.5));
        let mut all: Vec<Vec<f64>> = sums.map(|sum| read(sum.into_data())).collect();
        all.push(read(packed.into_data()));
        all
    });
}
