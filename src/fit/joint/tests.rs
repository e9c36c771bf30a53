//! The op against central differences.

use super::{JointConfig, joint};
use crate::rng::Rng;
use burn::tensor::{DType, Device, Tensor, TensorData};

const HEIGHT: usize = 9;
const WIDTH: usize = 12;
const POINTS: usize = 20;
const FUNCTIONS: usize = 4;
const IMAGES: usize = 2;
const DRAWS: usize = 2;
const LENGTH: usize = FUNCTIONS + HEIGHT * WIDTH;

fn random(count: usize, name: &str) -> Vec<f64> {
    let mut rng = Rng::stream(0, &["joint", name]);
    (0..count).map(|_| f64::from(rng.normal())).collect()
}

fn places() -> Vec<Vec<u32>> {
    let image = |seed: u64| {
        let mut all: Vec<u32> = (0..(HEIGHT * WIDTH) as u32).collect();
        Rng::stream(seed, &["places"]).choose(&mut all, POINTS);
        all.truncate(POINTS);
        all
    };
    vec![image(1), image(2)]
}

fn draws() -> Vec<f64> {
    let keep = |v: &f64| f64::from(u8::from(*v > -0.8));
    random(DRAWS * IMAGES * POINTS, "draws").iter().map(keep).collect()
}

fn edges() -> Vec<f64> {
    random(IMAGES * HEIGHT * WIDTH * 2, "edges").iter().map(|v| v.exp()).collect()
}

struct Values {
    bases: Tensor<3>,
    edges: Tensor<4>,
}

/// The sum of the results times fixed numbers.
fn objective(values: &Values) -> Tensor<1> {
    let device = values.bases.device();
    let tensor = |v: Vec<f64>, shape: [usize; 2]| {
        Tensor::<2>::from_data(TensorData::new(v, shape), (&device, DType::F64))
    };
    let shape = [DRAWS * IMAGES, POINTS];
    let depths = tensor(random(DRAWS * IMAGES * POINTS, "depths"), shape);
    let config = JointConfig {
        data: 3.0,
        ridge: 0.2,
    };
    let found = joint(
        values.bases.clone(),
        depths,
        tensor(draws(), shape),
        values.edges.clone(),
        places(),
        config,
    );
    let all = Tensor::cat(vec![found.weights, found.field], 1);
    let factors = random(DRAWS * IMAGES * LENGTH, "factors");
    (all * tensor(factors, [DRAWS * IMAGES, LENGTH])).sum()
}

fn values(bases: Vec<f64>, edges: Vec<f64>, device: &Device) -> Values {
    let bases = TensorData::new(bases, [DRAWS * IMAGES, POINTS, FUNCTIONS]);
    let edges = TensorData::new(edges, [IMAGES, HEIGHT, WIDTH, 2]);
    Values {
        bases: Tensor::from_data(bases, (device, DType::F64)),
        edges: Tensor::from_data(edges, (device, DType::F64)),
    }
}

#[test]
fn gradients_are_those_of_central_differences() {
    const STEP: f64 = 1e-5;
    let bases = random(DRAWS * IMAGES * POINTS * FUNCTIONS, "bases");
    let device = Device::flex();
    let mut tracked = values(bases.clone(), edges(), &device.clone().autodiff());
    tracked.bases = tracked.bases.require_grad();
    tracked.edges = tracked.edges.require_grad();
    let grads = objective(&tracked).backward();
    let read = |data: TensorData| data.iter::<f64>().collect::<Vec<f64>>();
    let of_bases = read(tracked.bases.grad(&grads).unwrap().into_data());
    let of_edges = read(tracked.edges.grad(&grads).unwrap().into_data());
    let value = |bases: Vec<f64>, edges: Vec<f64>| {
        objective(&values(bases, edges, &device)).into_scalar::<f64>()
    };
    for i in (0..bases.len()).step_by(7) {
        let moved = |by: f64| {
            let mut bases = bases.clone();
            bases[i] += by;
            value(bases, edges())
        };
        let expected = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
        let error = (of_bases[i] - expected).abs();
        assert!(error < 1e-6 * expected.abs().max(1.0), "{i}: {expected}");
    }
    for i in (0..edges().len()).step_by(5) {
        let moved = |by: f64| {
            let mut edges = edges();
            edges[i] += by;
            value(bases.clone(), edges)
        };
        let expected = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
        let error = (of_edges[i] - expected).abs();
        assert!(error < 1e-6 * expected.abs().max(1.0), "{i}: {expected}");
    }
}
