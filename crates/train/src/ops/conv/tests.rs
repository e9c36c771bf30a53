//! The kernels against plain loops, on every instruction set of this machine, and their gradients as exact adjoints.

use super::{ConvSpec, conv2d};
use burn::tensor::{Device, Tensor, TensorData};
use lsdc_kernels::conv::{self, Layer, Shape};
use lsdc_kernels::simd::{Level, Scratch, Tail};
use lsdc_rng::Rng;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// Returns every kind of convolution, with sizes around those of tiles, vectors and panels.
fn cases() -> Vec<Shape> {
    let wide = ConvSpec {
        stride: 2,
        ..ConvSpec::pointwise()
    };
    let shape = |size: [usize; 3], channels, outputs, taps, spec| Shape {
        batch: size[0],
        height: size[1],
        width: size[2],
        channels,
        outputs,
        taps,
        spec,
    };
    let mut cases = Vec::new();
    for (h, w) in [(1, 1), (2, 5), (7, 9), (16, 16), (33, 20)] {
        for spec in [ConvSpec::same(1), ConvSpec::same(2), ConvSpec::halving()] {
            cases.push(shape([2, h, w], 3, 5, 3, spec));
        }
        for spec in [ConvSpec::pointwise(), wide] {
            cases.push(shape([2, h, w], 6, 4, 1, spec));
        }
    }
    for (channels, outputs) in [(8, 16), (17, 33), (40, 20), (64, 32)] {
        for spec in [ConvSpec::same(1), ConvSpec::same(2), ConvSpec::halving()] {
            cases.push(shape([2, 21, 18], channels, outputs, 3, spec));
        }
        cases.push(shape(
            [2, 21, 18],
            channels,
            outputs,
            1,
            ConvSpec::pointwise(),
        ));
    }
    for (taps, stride) in [(3, 1), (3, 2), (5, 1), (5, 2), (4, 3)] {
        for (size, channels) in [
            ([2, 1, 1], 3),
            ([2, 2, 5], 16),
            ([2, 21, 18], 24),
            ([1, 7, 9], 40),
        ] {
            let spec = ConvSpec::depthwise(taps, stride);
            cases.push(shape(size, channels, channels, taps, spec));
        }
    }
    // More pixels than one task processes.
    cases.push(shape([1, 60, 70], 40, 3, 3, ConvSpec::same(1)));
    // Enough tiles that gradients of weights are summed in parts.
    cases.push(shape([2, 66, 75], 16, 16, 3, ConvSpec::same(1)));
    cases.push(shape([2, 66, 75], 20, 40, 3, ConvSpec::same(2)));
    cases
}

fn random(count: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::stream(0, &["conv", name]);
    (0..count).map(|_| rng.normal()).collect()
}

/// Calls `visit(output, input, weight)` with the indices of every product.
fn products(shape: &Shape, mut visit: impl FnMut(usize, usize, usize)) {
    let (height, width) = shape.out();
    let Shape { channels, taps, .. } = *shape;
    for pixel in 0..shape.out_pixels() {
        let (image, row, column) = (
            pixel / width / height,
            pixel / width % height,
            pixel % width,
        );
        for tap in 0..taps * taps {
            let place = |i: usize, tap: usize, length: usize| {
                let place = i * shape.spec.stride + tap * shape.spec.dilation;
                place
                    .checked_sub(shape.spec.padding)
                    .filter(|p| *p < length)
            };
            let y = place(row, tap / taps, shape.height);
            let x = place(column, tap % taps, shape.width);
            let Some((y, x)) = y.zip(x) else { continue };
            for c in 0..channels {
                let input = ((image * shape.height + y) * shape.width + x) * channels + c;
                let mut visit = |o: usize, row: usize| {
                    visit(pixel * shape.outputs + o, input, row * taps * taps + tap);
                };
                if shape.spec.depthwise {
                    visit(c, c);
                } else {
                    (0..shape.outputs).for_each(|o| visit(o, o * channels + c));
                }
            }
        }
    }
}

/// Returns the shape of the weights.
fn kernel_of(shape: &Shape) -> [usize; 4] {
    let taps = shape.taps;
    [shape.outputs, shape.depth() / (taps * taps), taps, taps]
}

fn agree(fast: &[f32], slow: &[f64], context: &dyn std::fmt::Debug) {
    assert_eq!(fast.len(), slow.len());
    let scale = slow.iter().fold(1e-3_f64, |m, v| m.max(v.abs()));
    for (a, b) in fast.iter().zip(slow) {
        assert!(
            (f64::from(*a) - b).abs() < 3e-5 * scale,
            "{context:?}: {a} {b}"
        );
    }
}

#[test]
fn kernels_agree_with_plain_loops_on_every_level() {
    let scratch = Scratch::new();
    for shape in cases() {
        kernels_agree(&shape, &scratch);
    }
}

prop_compose! {
    fn any_shape()(
        batch in 1..3_usize,
        height in 1..28_usize,
        width in 1..28_usize,
        channels in 1..50_usize,
        outputs in 1..50_usize,
        (taps, spec) in prop::sample::select(vec![
            (3, ConvSpec::depthwise(3, 1)),
            (3, ConvSpec { dilation: 2, ..ConvSpec::depthwise(3, 1) }),
            (5, ConvSpec::depthwise(5, 2)),
            (3, ConvSpec::same(1)),
            (3, ConvSpec::same(2)),
            (3, ConvSpec::same(3)),
            (3, ConvSpec::halving()),
            (1, ConvSpec::pointwise()),
            (1, ConvSpec { stride: 2, ..ConvSpec::pointwise() }),
        ]),
    ) -> Shape {
        let outputs = if spec.depthwise { channels } else { outputs };
        Shape { batch, height, width, channels, outputs, taps, spec }
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 60,
        failure_persistence: None,
        // The same cases in every run.
        rng_seed: RngSeed::Fixed(1),
        ..ProptestConfig::default()
    })]

    #[test]
    fn kernels_agree_with_plain_loops_for_any_shape(shape in any_shape()) {
        kernels_agree(&shape, &Scratch::new());
    }
}

fn kernels_agree(shape: &Shape, scratch: &Scratch) {
    let inputs = shape.size().iter().product::<usize>() * shape.channels;
    let outputs = shape.out_pixels() * shape.outputs;
    let (x, grad) = (random(inputs, "x"), random(outputs, "grad"));
    let (skip, bias) = (random(outputs, "skip"), random(shape.outputs, "bias"));
    let weights = random(shape.outputs * shape.depth(), "weights");

    let mut plain: Vec<f64> = (0..outputs)
        .map(|i| f64::from(skip[i]) + f64::from(bias[i % shape.outputs]))
        .collect();
    let (mut plain_x, mut plain_weights) = (vec![0.0; x.len()], vec![0.0; weights.len()]);
    products(shape, |o, i, w| {
        let [x, weight, grad] = [x[i], weights[w], grad[o]].map(f64::from);
        plain[o] += x * weight;
        plain_x[i] += grad * weight;
        plain_weights[w] += grad * x;
    });
    let plain: Vec<f64> = plain.into_iter().map(|v| v.max(0.0)).collect();

    for level in Level::available() {
        let context = (level, shape);
        let [_, per_output, ..] = kernel_of(shape);
        let sizes = [shape.outputs, per_output, shape.taps];
        let prepared = Layer::new(level, &weights, sizes, &bias, shape.spec);
        let mut output = vec![f32::NAN; outputs];
        let tail = Tail {
            skip: Some(&skip),
            relu: true,
        };
        prepared.apply(&x, shape.size(), tail, scratch, &mut output);
        agree(&output, &plain, &context);
        let gradient = conv::input_gradient(level, &weights, &grad, shape, scratch);
        agree(&gradient, &plain_x, &context);
        let gradient = conv::weight_gradient(level, &x, &grad, shape, scratch);
        agree(&gradient, &plain_weights, &context);
    }
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(x, y)| f64::from(*x) * f64::from(*y))
        .sum()
}

#[test]
fn the_op_agrees_with_burn_and_its_gradients_are_adjoint() {
    let device = Device::flex().autodiff();
    for shape in cases() {
        let spec = shape.spec;
        let dims = [shape.batch, shape.height, shape.width, shape.channels];
        let (x, weights) = (
            random(dims.iter().product(), "x"),
            random(shape.outputs * shape.depth(), "w"),
        );
        let tensor = |v: &[f32], dims: [usize; 4]| {
            Tensor::<4>::from_data(TensorData::new(v.to_vec(), dims), &device)
        };
        let input = tensor(&x, dims).require_grad();
        let kernel = tensor(&weights, kernel_of(&shape)).require_grad();
        let output = conv2d(input.clone(), kernel.clone(), spec);
        let (height, width) = shape.out();
        let out_dims = [shape.batch, height, width, shape.outputs];
        assert_eq!(output.dims(), out_dims);
        let read = |t: Tensor<4>| t.into_data().iter::<f32>().collect::<Vec<f32>>();
        let values = read(output.clone());
        let reference = burn::tensor::module::conv2d(
            input.clone().permute([0, 3, 1, 2]),
            kernel.clone(),
            None,
            super::options(spec, &kernel.shape()),
        );
        let reference = read(reference.permute([0, 2, 3, 1]));
        let reference: Vec<f64> = reference.into_iter().map(f64::from).collect();
        agree(&values, &reference, &shape);

        // <conv(x, w), g> = <x, gradient of x> = <w, gradient of w>, since conv is bilinear.
        let g = random(values.len(), "g");
        let gradients = (output * tensor(&g, out_dims)).sum().backward();
        let total = dot(&values, &g);
        let size = dot(&g, &g).sqrt() * dot(&values, &values).sqrt() + 1e-6;
        for product in [
            dot(&x, &read(input.grad(&gradients).unwrap())),
            dot(&weights, &read(kernel.grad(&gradients).unwrap())),
        ] {
            assert!(
                (product - total).abs() < 1e-5 * size,
                "{shape:?} {product} {total}"
            );
        }
    }
}

#[test]
fn gradients_of_the_op_match_central_differences() {
    let device = Device::flex().autodiff();
    for shape in cases().into_iter().filter(|s| s.channels <= 17) {
        let dims = [shape.batch, shape.height, shape.width, shape.channels];
        let kernel = kernel_of(&shape);
        let tensor = |v: &[f32], dims: [usize; 4]| {
            Tensor::<4>::from_data(TensorData::new(v.to_vec(), dims), &device)
        };
        let (x, weights) = (
            random(dims.iter().product(), "x"),
            random(kernel.iter().product(), "w"),
        );
        // Quadratic in each argument: central differences with any step are exact.
        let loss = |x: Tensor<4>, w: Tensor<4>| conv2d(x, w, shape.spec).square().sum();
        let value = |x: &[f32], w: &[f32]| {
            let loss = loss(tensor(x, dims), tensor(w, kernel));
            f64::from(loss.into_scalar::<f32>())
        };
        let (a, b) = (
            tensor(&x, dims).require_grad(),
            tensor(&weights, kernel).require_grad(),
        );
        let gradients = loss(a.clone(), b.clone()).backward();
        let read = |t: Tensor<4>| t.into_data().iter::<f32>().collect::<Vec<f32>>();
        let gradients = [
            read(a.grad(&gradients).unwrap()),
            read(b.grad(&gradients).unwrap()),
        ];
        let scale = value(&x, &weights).abs().max(1.0);
        for (which, gradient) in gradients.iter().enumerate() {
            for i in (0..gradient.len()).step_by(gradient.len().div_ceil(5)) {
                let step = 0.5;
                let moved = |by: f32| {
                    let (mut x, mut weights) = (x.clone(), weights.clone());
                    [&mut x, &mut weights][which][i] += by;
                    value(&x, &weights)
                };
                let difference = (moved(step) - moved(-step)) / (2.0 * f64::from(step));
                let error = (difference - f64::from(gradient[i])).abs();
                assert!(error < 1e-5 * scale, "{shape:?} {which} {i}: {difference}");
            }
        }
    }
}
