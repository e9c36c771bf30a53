//! The op against central differences, the fit against dense equations and fits without a point.

use super::{JointConfig, joint};
use crate::fit::{
    Edges, Fit, FitConfig, FitMethod, Lambda, Loss, NoisePrior, Points, Prior, PriorKind, Robust,
    Scene, Waves, fit,
};
use crate::rng::Rng;
use burn::tensor::{DType, Device, Tensor, TensorData};
use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};

const HEIGHT: usize = 9;
const WIDTH: usize = 12;
const POINTS: usize = 20;
const FUNCTIONS: usize = 4;
const IMAGES: usize = 2;
const DRAWS: usize = 2;
/// Each part strong enough to show.
const CONFIG: JointConfig = JointConfig {
    data: 3.0,
    ridge: 0.2,
    level: 0.01,
    waves: 1.0,
    bending: 0.5,
};
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

fn edges() -> Vec<f64> {
    random(IMAGES * HEIGHT * WIDTH * 2, "edges")
        .iter()
        .map(|v| v.exp())
        .collect()
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
    let found = joint(
        values.bases.clone(),
        depths,
        tensor(draws(), shape),
        values.edges.clone(),
        places(),
        CONFIG,
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

/// A scene of its own: points of two base functions and the constant, which a rough field is added
/// to.
struct Example {
    edges: Edges,
    bases: Vec<f32>,
    depths: Vec<f32>,
    places: Vec<[usize; 2]>,
}

impl Example {
    fn new() -> Self {
        let strengths: Vec<f32> = edges()[..2 * HEIGHT * WIDTH]
            .iter()
            .map(|&v| v as f32)
            .collect();
        let place = |p: &u32| [*p as usize % WIDTH, *p as usize / WIDTH];
        let places: Vec<[usize; 2]> = places()[0].iter().map(place).collect();
        let wobble = random(POINTS, "wobble");
        let pairs = places.iter().zip(wobble);
        let depth = |([x, y], w): (&[usize; 2], f64)| {
            (3.0 + 0.1 * *x as f64 - 0.05 * *y as f64 + 0.1 * w) as f32
        };
        Self {
            edges: Edges::new((HEIGHT, WIDTH), &strengths),
            bases: bases_at(&places),
            depths: pairs.map(depth).collect(),
            places,
        }
    }

    fn scene(&self) -> Scene<'_> {
        Scene {
            edges: &self.edges,
            size: (HEIGHT, WIDTH),
        }
    }

    fn fit(&self, config: &FitConfig) -> Fit {
        self.fit_some(config, |_| true)
    }

    fn fit_some(&self, config: &FitConfig, keep: impl Fn(usize) -> bool) -> Fit {
        let kept: Vec<usize> = (0..self.places.len()).filter(|&i| keep(i)).collect();
        let bases: Vec<f32> = kept
            .iter()
            .flat_map(|&i| self.bases[3 * i..3 * i + 3].to_vec())
            .collect();
        let depths: Vec<f32> = kept.iter().map(|&i| self.depths[i]).collect();
        let places: Vec<[usize; 2]> = kept.iter().map(|&i| self.places[i]).collect();
        let points = Points {
            places: Some(&places),
            scene: Some(self.scene()),
            ..Points::new(&bases, &depths)
        };
        fit(&points, config, None).unwrap()
    }
}

/// The constant, and two functions of the place.
fn bases_at(places: &[[usize; 2]]) -> Vec<f32> {
    let row = |[x, y]: &[usize; 2]| [1.0, *x as f32 / 6.0 - 1.0, (*y as f32 / 3.0).sin()];
    places.iter().flat_map(row).collect()
}

fn all_places() -> Vec<[usize; 2]> {
    (0..HEIGHT * WIDTH)
        .map(|i| [i % WIDTH, i / WIDTH])
        .collect()
}

fn dense(fit: &Fit) -> Vec<f64> {
    let mut map: Vec<f32> = bases_at(&all_places())
        .chunks_exact(3)
        .map(|row| {
            row.iter()
                .zip(&fit.weights)
                .map(|(b, w)| b * *w as f32)
                .sum()
        })
        .collect();
    fit.smooth().unwrap().add_to((HEIGHT, WIDTH), &mut map);
    map.into_iter().map(f64::from).collect()
}

fn settings(method: FitMethod) -> FitConfig {
    FitConfig {
        method,
        prior: PriorKind::Flat,
        lambda: Lambda::Fixed(0.05),
        ..FitConfig::default()
    }
}

#[test]
fn left_out_residuals_are_those_of_fits_without_the_point() {
    let example = Example::new();
    for method in [FitMethod::Joint, FitMethod::Wls] {
        let all = example.fit(&settings(method));
        let left_out = all.left_out(&all.leverages(&example.bases));
        for (i, &[x, y]) in example.places.iter().enumerate() {
            let without = dense(&example.fit_some(&settings(method), |j| j != i));
            let expected = f64::from(example.depths[i]) - without[y * WIDTH + x];
            assert!(
                (left_out[i] - expected).abs() < 1e-5,
                "{i}: {} {expected}",
                left_out[i]
            );
        }
    }
}

#[test]
fn residuals_are_what_the_dense_depth_leaves() {
    let example = Example::new();
    for method in [FitMethod::Joint, FitMethod::Wls] {
        let fit = example.fit(&settings(method));
        let dense = dense(&fit);
        for (i, &[x, y]) in example.places.iter().enumerate() {
            let expected = f64::from(example.depths[i]) - dense[y * WIDTH + x];
            assert!((fit.residuals[i] - expected).abs() < 1e-6);
        }
        assert!(fit.rms() < 0.05);
    }
}

#[test]
fn deviations_are_those_of_the_gaussian_posterior() {
    let example = Example::new();
    let lambda = 0.05;
    let fit = example.fit(&settings(FitMethod::Joint));
    let found = fit.field_deviations(|_, pixels| {
        let places: Vec<_> = pixels.iter().map(|&p| all_places()[p as usize]).collect();
        bases_at(&places)
    });
    let mut deviations = vec![0.0; HEIGHT * WIDTH];
    found.unwrap().add_to((HEIGHT, WIDTH), &mut deviations);

    // Of field and weights together; nothing is assumed of the constant.
    let pixels = HEIGHT * WIDTH;
    let size = pixels + 3;
    let mut precision = precision(&example.edges, JointConfig::default().level, size);
    let functions = bases_at(&all_places());
    let row = |pixel: usize| {
        Mat::<f64>::from_fn(size, 1, |i, _| match i.checked_sub(pixels) {
            None => f64::from(i == pixel),
            Some(function) => f64::from(functions[3 * pixel + function]),
        })
    };
    for &[x, y] in &example.places {
        let row = row(y * WIDTH + x);
        precision += faer::Scale(100.0) * &row * row.transpose();
    }
    for i in pixels + 1..size {
        precision[(i, i)] += lambda;
    }
    let factor = precision.llt(Side::Lower).unwrap();
    for (pixel, found) in deviations.into_iter().enumerate() {
        let row = row(pixel);
        let variance = (row.transpose() * factor.solve(&row))[(0, 0)];
        let found = f64::from(found).powi(2);
        assert!(
            (found - variance).abs() < 1e-4 * variance,
            "{found} {variance}"
        );
    }
}

/// The precision of a field before it is observed, and zeros.
fn precision(edges: &Edges, level: f64, size: usize) -> Mat<f64> {
    let mut precision = Mat::<f64>::zeros(size, size);
    let grid = edges.grid(level);
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
            join(i, i + 1, grid.right[i]);
        }
        if i + WIDTH < pixels {
            join(i, i + WIDTH, grid.down[i]);
        }
    }
    precision
}

#[test]
fn the_op_minimises_over_field_waves_and_weights() {
    let example = Example::new();
    let device = Device::flex();
    let tensor = |values: Vec<f64>| {
        let count = values.len();
        Tensor::<1>::from_data(TensorData::new(values, [count]), (&device, DType::F64))
    };
    let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>();
    let places = &places()[0];
    let found = joint(
        tensor(wide(&example.bases)).reshape([1, POINTS, 3]),
        tensor(wide(&example.depths)).reshape([1, POINTS]),
        tensor(vec![1.0; POINTS]).reshape([1, POINTS]),
        tensor(edges()[..2 * HEIGHT * WIDTH].to_vec()).reshape([1, HEIGHT, WIDTH, 2]),
        vec![places.clone()],
        CONFIG,
    );
    let read = |values: Tensor<2>| values.into_data().iter::<f64>().collect::<Vec<_>>();
    let (weights, field) = (read(found.weights), read(found.field));

    let waves = Waves::up_to(CONFIG.waves);
    let pixels = HEIGHT * WIDTH;
    let every: Vec<u32> = (0..pixels as u32).collect();
    let columns = 3 + waves.len();
    let functions = waves.beside(&bases_at(&all_places()), 3, (HEIGHT, WIDTH), &every);
    let size = pixels + columns;
    let mut precision = precision(&example.edges, CONFIG.level, size);
    let ridges = waves.ridges(CONFIG.bending);
    for (i, ridge) in [CONFIG.ridge; 3].iter().chain(&ridges).enumerate() {
        precision[(pixels + i, pixels + i)] = *ridge;
    }
    let mut right = Mat::<f64>::zeros(size, 1);
    for (&pixel, &depth) in places.iter().zip(&example.depths) {
        let pixel = pixel as usize;
        let row = Mat::<f64>::from_fn(size, 1, |i, _| match i.checked_sub(pixels) {
            None => f64::from(i == pixel),
            Some(function) => f64::from(functions[columns * pixel + function]),
        });
        precision += faer::Scale(CONFIG.data) * &row * row.transpose();
        right += faer::Scale(CONFIG.data * f64::from(depth)) * &row;
    }
    let least = precision.llt(Side::Lower).unwrap().solve(&right);
    for (i, found) in weights.iter().enumerate() {
        let expected = least[(pixels + i, 0)];
        assert!((found - expected).abs() < 1e-5, "{i}: {found} {expected}");
    }
    for (pixel, found) in field.iter().enumerate() {
        let row = &functions[columns * pixel + 3..][..waves.len()];
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

#[test]
fn scaling_depths_scales_the_fit() {
    let example = Example::new();
    let far = Example {
        depths: example.depths.iter().map(|d| 8.0 * d).collect(),
        ..Example::new()
    };
    for lambda in [Lambda::Fixed(0.1), Lambda::Evidence] {
        for robust in [None, Some(Robust::new(Loss::Cauchy))] {
            let config = FitConfig {
                lambda,
                robust,
                ..settings(FitMethod::Joint)
            };
            let near = dense(&example.fit(&config));
            for (near, far) in near.iter().zip(dense(&far.fit(&config))) {
                assert!((8.0 * near - far).abs() < 1e-5 * far, "{near} {far}");
            }
        }
    }
}

#[test]
fn a_point_far_off_is_not_followed() {
    let mut example = Example::new();
    example.depths[3] += 2.0;
    for loss in [Loss::Huber, Loss::Cauchy, Loss::Gm, Loss::Tukey] {
        let config = FitConfig {
            robust: Some(Robust::new(loss)),
            ..settings(FitMethod::Joint)
        };
        let fit = example.fit(&config);
        assert!(
            fit.point_weights[3] < 0.01,
            "{loss:?} {:?}",
            fit.point_weights
        );
        assert!(fit.residuals[3] > 1.2, "{loss:?} {}", fit.residuals[3]);
    }
}

#[test]
fn points_of_one_pixel_are_averaged() {
    let mut example = Example::new();
    let (place, depth) = (example.places[0], example.depths[0]);
    example.depths[0] = depth + 0.5;
    example.places.push(place);
    example.depths.push(depth - 0.5);
    example.bases.extend_from_within(..3);
    let double = dense(&example.fit(&settings(FitMethod::Wls)));
    // Twice the weight of one, which meets the mean closely either way.
    let single = dense(&Example::new().fit(&settings(FitMethod::Wls)));
    for (a, b) in double.iter().zip(single) {
        assert!((a - b).abs() < 5e-3, "{a} {b}");
    }
}

#[test]
fn a_field_without_its_image_is_refused() {
    let example = Example::new();
    let points = Points::new(&example.bases, &example.depths);
    let error = fit(&points, &settings(FitMethod::Joint), None).unwrap_err();
    assert!(error.to_string().contains("needs the image"), "{error}");
}

/// Root mean square error between points of a slanted plane, base functions being the constant and
/// waves.
fn error_on_a_plane(frequency: f64, kind: PriorKind, lambda: f64) -> f64 {
    let (height, width) = (36, 48);
    let plane = |x: usize, y: usize| 2.0 + 0.03 * x as f32 + 0.02 * y as f32;
    let places: Vec<[usize; 2]> = (0..12).map(|i| [i % 4 * 12 + 6, i / 4 * 12 + 6]).collect();
    let depths: Vec<f32> = places.iter().map(|&[x, y]| plane(x, y)).collect();
    let waves = Waves::up_to(frequency);
    let rows = |pixels: &[u32]| waves.beside(&vec![1.0; pixels.len()], 1, (height, width), pixels);
    let pixels: Vec<u32> = places
        .iter()
        .map(|&[x, y]| (y * width + x) as u32)
        .collect();
    let edges = Edges::new((height, width), &vec![1.0; 2 * height * width]);
    let unknown = NoisePrior {
        mean: 0.0,
        deviation: None,
        trust: 0.0,
    };
    let prior = Prior::new(&[1.0], &[0.1], unknown).unwrap();
    let config = FitConfig {
        method: FitMethod::Joint,
        prior: kind,
        lambda: Lambda::Fixed(lambda),
        joint: JointConfig {
            waves: frequency,
            ..JointConfig::default()
        },
        ..FitConfig::default()
    };
    let points = Points {
        bases: &rows(&pixels),
        depths: &depths,
        deviations: None,
        places: Some(&places),
        scene: Some(Scene {
            edges: &edges,
            size: (height, width),
        }),
    };
    let fit = fit(&points, &config, Some(&prior)).unwrap();
    assert_eq!((fit.functions(), fit.weights.len()), (1, 1 + waves.len()));
    let mut dense = vec![fit.weights[0] as f32; height * width];
    waves.add_to((height, width), &fit.weights[1..], &mut dense);
    fit.smooth().unwrap().add_to((height, width), &mut dense);
    // Beyond the points nothing is known of slopes.
    let between = |i: &usize| (6..=42).contains(&(i % width)) && (6..=30).contains(&(i / width));
    let pixels: Vec<usize> = (0..dense.len()).filter(between).collect();
    let off = |&i: &usize| f64::from(dense[i] - plane(i % width, i / width)).powi(2);
    (pixels.iter().map(off).sum::<f64>() / pixels.len() as f64).sqrt()
}

#[test]
fn waves_carry_slopes_between_points() {
    // However strongly base functions are drawn to their prior, and whichever it is.
    for kind in [PriorKind::Learned, PriorKind::Flat, PriorKind::None] {
        for lambda in [1e-3, 1e9] {
            let [without, with] = [0.0, 3.0].map(|f| error_on_a_plane(f, kind, lambda));
            assert!(
                with < 0.67 * without,
                "{with} with waves, {without} without, {kind:?}, lambda {lambda}"
            );
        }
    }
}

#[test]
fn waves_without_their_columns_are_refused() {
    let example = Example::new();
    let points = Points {
        places: Some(&example.places),
        scene: Some(example.scene()),
        ..Points::new(&example.bases, &example.depths)
    };
    let config = FitConfig {
        joint: CONFIG,
        ..settings(FitMethod::Joint)
    };
    let error = fit(&points, &config, None).unwrap_err();
    assert!(error.to_string().contains("too few"), "{error}");
}
