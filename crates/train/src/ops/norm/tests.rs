//! Values and gradients of the fast f32 path against burn's own operations in f64.

use super::{NormSpec, moments, normalise};
use burn::tensor::{DType, Device, Tensor, TensorData};
use lsdc_rng::Rng;

struct Outcome {
    output: Vec<f64>,
    gradients: [Vec<f64>; 3],
}

fn random(count: usize, name: &str) -> Vec<f64> {
    let mut rng = Rng::stream(0, &["norm", name]);
    (0..count).map(|_| f64::from(rng.normal()) + 0.3).collect()
}

fn run<const D: usize>(shape: [usize; D], own: bool, relu: bool, dtype: DType) -> Outcome {
    let device = Device::flex().autodiff();
    let count = shape.iter().product();
    let channels = shape[D - 1];
    let vector = |name: &str| {
        let data = TensorData::new(random(channels, name), [channels]);
        Tensor::<1>::from_data(data, (&device, dtype)).require_grad()
    };
    let full = |name: &str| {
        Tensor::<D>::from_data(
            TensorData::new(random(count, name), shape),
            (&device, dtype),
        )
    };
    let (x, gain, shift) = (full("x").require_grad(), vector("gain"), vector("shift"));
    let (mean, variance) = if own {
        moments(x.clone())
    } else {
        (
            vector("mean").detach(),
            vector("variance").abs().detach() + 0.5,
        )
    };
    let spec = NormSpec {
        epsilon: 1e-5,
        relu,
        own,
    };
    let y = normalise(x.clone(), gain.clone(), shift.clone(), mean, variance, spec);
    let gradients = (y.clone() * full("direction")).sum().backward();
    let read = |data: TensorData| data.iter::<f64>().collect::<Vec<_>>();
    Outcome {
        output: read(y.into_data()),
        gradients: [
            read(x.grad(&gradients).unwrap().into_data()),
            read(gain.grad(&gradients).unwrap().into_data()),
            read(shift.grad(&gradients).unwrap().into_data()),
        ],
    }
}

fn agree<const D: usize>(shape: [usize; D]) {
    for (own, relu) in [(true, true), (true, false), (false, true), (false, false)] {
        let fast = run(shape, own, relu, DType::F32);
        let reference = run(shape, own, relu, DType::F64);
        let pairs = [(&fast.output, &reference.output)]
            .into_iter()
            .chain(fast.gradients.iter().zip(&reference.gradients));
        for (a, b) in pairs {
            let scale = b.iter().fold(1.0_f64, |m, v| m.max(v.abs()));
            for (x, y) in a.iter().zip(b) {
                assert!(
                    (x - y).abs() < 2e-5 * scale,
                    "{shape:?} {own} {relu}: {x} {y}"
                );
            }
        }
    }
}

#[test]
fn images_agree() {
    agree([2, 7, 5, 3]);
    agree([3, 30, 41, 4]);
    agree([1, 9, 31, 70]);
}

#[test]
fn rows_agree() {
    agree([50, 6]);
    agree([2500, 9]);
}
