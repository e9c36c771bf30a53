//! The operation against central differences and dense equations.

use super::joint;
use burn::tensor::{DType, Device, Tensor, TensorData};
use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};
use lsdc_core::fit::{CosineBasis, FitConfig, JointConfig, PriorKind};
use lsdc_rng::Rng;

const HEIGHT: usize = 9;
const WIDTH: usize = 12;
const POINTS: usize = 20;
const FUNCTIONS: usize = 4;
const IMAGES: usize = 2;
const DRAWS: usize = 2;
/// All parts are strong enough to have an effect.
const CONFIG: JointConfig = JointConfig {
    observation_precision: 3.0,
    ridge: 0.2,
    diagonal_regularisation: 0.01,
    cosines: 1.0,
    surface: false,
    bending: 0.5,
};
/// All weights have a ridge, or all but the first.
const PRIORS: [PriorKind; 2] = [PriorKind::None, PriorKind::Flat];
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
    random(DRAWS * IMAGES * POINTS, "draws")
        .iter()
        .map(keep)
        .collect()
}

fn affinities() -> Vec<f64> {
    random(IMAGES * HEIGHT * WIDTH * 2, "edges")
        .iter()
        .map(|v| v.exp())
        .collect()
}

fn fit(prior: PriorKind) -> FitConfig {
    FitConfig {
        joint: CONFIG,
        prior,
        ..FitConfig::default()
    }
}

struct Values {
    bases: Tensor<3>,
    affinities: Tensor<4>,
}

/// Returns the sum of the results times fixed numbers.
fn objective(values: &Values, prior: PriorKind) -> Tensor<1> {
    let device = values.bases.device();
    let tensor = |v: Vec<f64>, shape: [usize; 2]| {
        Tensor::<2>::from_data(TensorData::new(v, shape), (&device, DType::F64))
    };
    let shape = [DRAWS * IMAGES, POINTS];
    let depths = tensor(random(DRAWS * IMAGES * POINTS, "depths"), shape);
    let found = joint(
        values.bases.clone(),
        depths,
        tensor(draws(), shape),
        values.affinities.clone(),
        places(),
        &fit(prior),
    );
    let all = Tensor::cat(vec![found.weights, found.field], 1);
    let factors = random(DRAWS * IMAGES * LENGTH, "factors");
    (all * tensor(factors, [DRAWS * IMAGES, LENGTH])).sum()
}

fn values(bases: Vec<f64>, affinities: Vec<f64>, device: &Device) -> Values {
    let bases = TensorData::new(bases, [DRAWS * IMAGES, POINTS, FUNCTIONS]);
    let affinities = TensorData::new(affinities, [IMAGES, HEIGHT, WIDTH, 2]);
    Values {
        bases: Tensor::from_data(bases, (device, DType::F64)),
        affinities: Tensor::from_data(affinities, (device, DType::F64)),
    }
}

#[test]
fn gradients_are_those_of_central_differences() {
    PRIORS.into_iter().for_each(gradients_are_right);
}

fn gradients_are_right(prior: PriorKind) {
    const STEP: f64 = 1e-5;
    let bases = random(DRAWS * IMAGES * POINTS * FUNCTIONS, "bases");
    let device = Device::flex();
    let mut tracked = values(bases.clone(), affinities(), &device.clone().autodiff());
    tracked.bases = tracked.bases.require_grad();
    tracked.affinities = tracked.affinities.require_grad();
    let grads = objective(&tracked, prior).backward();
    let read = |data: TensorData| data.iter::<f64>().collect::<Vec<f64>>();
    let of_bases = read(tracked.bases.grad(&grads).unwrap().into_data());
    let of_affinities = read(tracked.affinities.grad(&grads).unwrap().into_data());
    let value = |bases: Vec<f64>, affinities: Vec<f64>| {
        objective(&values(bases, affinities, &device), prior).into_scalar::<f64>()
    };
    for i in (0..bases.len()).step_by(7) {
        let moved = |by: f64| {
            let mut bases = bases.clone();
            bases[i] += by;
            value(bases, affinities())
        };
        let expected = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
        let error = (of_bases[i] - expected).abs();
        assert!(error < 1e-6 * expected.abs().max(1.0), "{i}: {expected}");
    }
    for i in (0..affinities().len()).step_by(5) {
        let moved = |by: f64| {
            let mut affinities = affinities();
            affinities[i] += by;
            value(bases.clone(), affinities)
        };
        let expected = (moved(STEP) - moved(-STEP)) / (2.0 * STEP);
        let error = (of_affinities[i] - expected).abs();
        assert!(error < 1e-6 * expected.abs().max(1.0), "{i}: {expected}");
    }
}

/// Returns the prior precision of a field, padded with zeros.
fn precision(affinities: &[f64], level: f64, size: usize) -> Mat<f64> {
    let mut precision = Mat::<f64>::zeros(size, size);
    let pixels = HEIGHT * WIDTH;
    (0..pixels).for_each(|i| precision[(i, i)] = level);
    let mut join = |i: usize, j: usize, strength: f64| {
        precision[(i, i)] += strength;
        precision[(j, j)] += strength;
        precision[(i, j)] -= strength;
        precision[(j, i)] -= strength;
    };
    for i in 0..pixels {
        if (i + 1) % WIDTH > 0 {
            join(i, i + 1, affinities[2 * i]);
        }
        if i + WIDTH < pixels {
            join(i, i + WIDTH, affinities[2 * i + 1]);
        }
    }
    precision
}

#[test]
fn the_op_minimises_over_field_cosines_and_weights() {
    PRIORS.into_iter().for_each(the_sum_is_least);
}

fn the_sum_is_least(prior: PriorKind) {
    let place = |i: usize| [(i % WIDTH) as f64, (i / WIDTH) as f64];
    let bases_at = |places: &[[f64; 2]]| -> Vec<f32> {
        let row = |[x, y]: &[f64; 2]| [1.0, (x / 6.0 - 1.0) as f32, (y / 3.0).sin() as f32];
        places.iter().flat_map(row).collect()
    };
    let device = Device::flex();
    let tensor = |values: Vec<f64>| {
        let count = values.len();
        Tensor::<1>::from_data(TensorData::new(values, [count]), (&device, DType::F64))
    };
    let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    let pixels_of_points = &places()[0];
    let places: Vec<_> = pixels_of_points
        .iter()
        .map(|&p| place(p as usize))
        .collect();
    let depths: Vec<f32> = random(POINTS, "wobble")
        .iter()
        .map(|w| (3.0 + 0.3 * w) as f32)
        .collect();
    let found = joint(
        tensor(wide(&bases_at(&places))).reshape([1, POINTS, 3]),
        tensor(wide(&depths)).reshape([1, POINTS]),
        tensor(vec![1.0; POINTS]).reshape([1, POINTS]),
        tensor(affinities()[..2 * HEIGHT * WIDTH].to_vec()).reshape([1, HEIGHT, WIDTH, 2]),
        vec![pixels_of_points.clone()],
        &fit(prior),
    );
    let read = |values: Tensor<2>| values.into_data().iter::<f64>().collect::<Vec<_>>();
    let (weights, field) = (read(found.weights), read(found.field));

    let cosines = CosineBasis::up_to(CONFIG.cosines);
    let pixels = HEIGHT * WIDTH;
    let every: Vec<_> = (0..pixels).map(place).collect();
    let columns = 3 + cosines.len();
    let functions = cosines.append_to(&bases_at(&every), 3, (HEIGHT, WIDTH), &every);
    let size = pixels + columns;
    let mut precision = precision(&affinities(), CONFIG.diagonal_regularisation, size);
    let ridges = cosines.ridges(CONFIG.bending);
    let first = match prior {
        PriorKind::Flat => 0.0,
        _ => CONFIG.ridge,
    };
    let penalties = [first, CONFIG.ridge, CONFIG.ridge];
    for (i, ridge) in penalties.iter().chain(&ridges).enumerate() {
        precision[(pixels + i, pixels + i)] = *ridge;
    }
    let mut right = Mat::<f64>::zeros(size, 1);
    for (&pixel, &depth) in pixels_of_points.iter().zip(&depths) {
        let pixel = pixel as usize;
        let row = Mat::<f64>::from_fn(size, 1, |i, _| match i.checked_sub(pixels) {
            None => f64::from(i == pixel),
            Some(function) => f64::from(functions[columns * pixel + function]),
        });
        precision += faer::Scale(CONFIG.observation_precision) * &row * row.transpose();
        right += faer::Scale(CONFIG.observation_precision * f64::from(depth)) * &row;
    }
    let least = precision.llt(Side::Lower).unwrap().solve(&right);
    for (i, found) in weights.iter().enumerate() {
        let expected = least[(pixels + i, 0)];
        assert!((found - expected).abs() < 1e-5, "{i}: {found} {expected}");
    }
    for (pixel, found) in field.iter().enumerate() {
        let row = &functions[columns * pixel + 3..][..cosines.len()];
        let smooth = row
            .iter()
            .zip(3..)
            .map(|(v, i)| f64::from(*v) * least[(pixels + i, 0)]);
        let expected = least[(pixel, 0)] + smooth.sum::<f64>();
        assert!(
            (found - expected).abs() < 1e-5,
            "{pixel}: {found} {expected}"
        );
    }
}
