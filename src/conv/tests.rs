//! The fast path against plain loops, and its gradients as exact adjoints.

use super::{ConvSpec, conv2d};
use crate::rng::Rng;
use burn::tensor::{Device, Tensor, TensorData};

/// Sizes of input `[b, c, h, w]` and kernel `[o, taps]`, and how it moves.
fn cases() -> Vec<([usize; 4], [usize; 2], ConvSpec)> {
    let wide = ConvSpec {
        stride: 2,
        ..ConvSpec::pointwise()
    };
    let mut cases = Vec::new();
    for (h, w) in [(1, 1), (2, 5), (7, 9), (16, 16), (33, 20)] {
        for spec in [ConvSpec::same(1), ConvSpec::same(2), ConvSpec::halving()] {
            cases.push(([2, 3, h, w], [5, 3], spec));
        }
        for spec in [ConvSpec::pointwise(), wide] {
            cases.push(([2, 6, h, w], [4, 1], spec));
        }
    }
    // More unfolded pixels than fit one strip.
    cases.push(([1, 40, 60, 70], [3, 3], ConvSpec::same(1)));
    cases
}

fn random(count: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::stream(0, &["conv", name]);
    (0..count).map(|_| rng.normal()).collect()
}

fn plain(
    x: &[f32],
    [b, c, h, w]: [usize; 4],
    weight: &[f32],
    [o, taps]: [usize; 2],
    spec: ConvSpec,
) -> Vec<f64> {
    let (oh, ow) = (spec.output(h, taps), spec.output(w, taps));
    let mut output = vec![0.0; b * o * oh * ow];
    for (i, value) in output.iter_mut().enumerate() {
        let (column, row) = (i % ow, i / ow % oh);
        let (channel, image) = (i / ow / oh % o, i / ow / oh / o);
        for ci in 0..c {
            for tap in 0..taps * taps {
                let y = (row * spec.stride + tap / taps * spec.dilation).checked_sub(spec.padding);
                let x_ =
                    (column * spec.stride + tap % taps * spec.dilation).checked_sub(spec.padding);
                if let (Some(y), Some(x_)) = (y.filter(|y| *y < h), x_.filter(|x| *x < w)) {
                    let pixel = x[((image * c + ci) * h + y) * w + x_];
                    let factor = weight[(channel * c + ci) * taps * taps + tap];
                    *value += f64::from(pixel) * f64::from(factor);
                }
            }
        }
    }
    output
}

fn dot(a: &[f32], b: &[f32]) -> f64 {
    a.iter()
        .zip(b)
        .map(|(x, y)| f64::from(*x) * f64::from(*y))
        .sum()
}

#[test]
fn the_fast_path_agrees_with_plain_loops_and_its_adjoints() {
    let device = Device::flex().autodiff();
    for (shape, [o, taps], spec) in cases() {
        let [b, c, h, w] = shape;
        let (x, weight) = (random(b * c * h * w, "x"), random(o * c * taps * taps, "w"));
        let data = |v: &[f32], s: [usize; 4]| TensorData::new(v.to_vec(), s);
        let input = Tensor::<4>::from_data(data(&x, shape), &device).require_grad();
        let kernel =
            Tensor::<4>::from_data(data(&weight, [o, c, taps, taps]), &device).require_grad();
        let output = conv2d(input.clone(), kernel.clone(), spec);
        let dims = output.dims();
        assert_eq!(dims, [b, o, spec.output(h, taps), spec.output(w, taps)]);

        let values: Vec<f32> = output.clone().into_data().iter::<f32>().collect();
        let expected = plain(&x, shape, &weight, [o, taps], spec);
        let scale = expected.iter().fold(1e-3_f64, |m, v| m.max(v.abs()));
        for (fast, slow) in values.iter().zip(&expected) {
            assert!(
                (f64::from(*fast) - slow).abs() < 1e-5 * scale,
                "{shape:?} {spec:?}"
            );
        }

        // <conv(x, w), g> = <x, gradient of x> = <w, gradient of w>, since conv is bilinear.
        let g = random(values.len(), "g");
        let gradients = (output * Tensor::from_data(data(&g, dims), &device))
            .sum()
            .backward();
        let read =
            |t: Option<Tensor<4>>| -> Vec<f32> { t.unwrap().into_data().iter::<f32>().collect() };
        let total = dot(&values, &g);
        let size = dot(&g, &g).sqrt() * dot(&values, &values).sqrt() + 1e-6;
        for product in [
            dot(&x, &read(input.grad(&gradients))),
            dot(&weight, &read(kernel.grad(&gradients))),
        ] {
            assert!(
                (product - total).abs() < 1e-5 * size,
                "{shape:?} {spec:?} {product} {total}"
            );
        }
    }
}
