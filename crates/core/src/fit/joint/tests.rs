//! The fit against dense equations, and fits without a point.

use super::merged_observations::MergedObservations;
use super::smoothness::Smoothness;
use crate::fit::{
    Affinities, BasisValues, CosineBasis, FieldGeometry, Fit, FitConfig, FitMethod, FitPoints,
    JointConfig, Lambda, Loss, NoisePrior, Prior, PriorKind, Robust, fit,
};
use crate::upsampling::Upsampling;
use faer::linalg::solvers::Solve as _;
use faer::{Mat, Side};
use lsdc_rng::Rng;

const HEIGHT: usize = 9;
const WIDTH: usize = 12;
const POINTS: usize = 20;

fn random(count: usize, name: &str) -> Vec<f64> {
    let mut rng = Rng::stream(0, &["joint", name]);
    (0..count).map(|_| f64::from(rng.normal())).collect()
}

fn affinities() -> Vec<f32> {
    let values = random(2 * HEIGHT * WIDTH, "edges");
    values.iter().map(|v| v.exp() as f32).collect()
}

/// On the centres of different pixels.
fn places() -> Vec<[f64; 2]> {
    let mut all = all_places();
    Rng::stream(1, &["places"]).choose(&mut all, POINTS);
    all.truncate(POINTS);
    all
}

/// A scene of its own: points of two basis functions and the constant, which a rough field is added
/// to.
struct Example {
    affinities: Affinities,
    bases: Vec<f32>,
    depths: Vec<f32>,
    places: Vec<[f64; 2]>,
}

impl Example {
    fn new() -> Self {
        Self::at(places())
    }

    /// With points at these places.
    fn at(places: Vec<[f64; 2]>) -> Self {
        let wobble = random(POINTS, "wobble");
        let pairs = places.iter().zip(wobble);
        let depth = |([x, y], w): (&[f64; 2], f64)| (3.0 + 0.1 * x - 0.05 * y + 0.1 * w) as f32;
        Self {
            affinities: Affinities::new((HEIGHT, WIDTH), &affinities()).unwrap(),
            bases: bases_at(&places),
            depths: pairs.map(depth).collect(),
            places,
        }
    }

    fn geometry(&self) -> FieldGeometry<'_> {
        FieldGeometry {
            affinities: &self.affinities,
            size: (HEIGHT, WIDTH),
            upsampling: None,
            transient: false,
        }
    }

    fn fit(&self, config: &FitConfig) -> Fit {
        self.fit_some(config, |_| true)
    }

    fn fit_some(&self, config: &FitConfig, keep: impl Fn(usize) -> bool) -> Fit {
        self.fit_in(config, (HEIGHT, WIDTH), keep)
    }

    /// Fits points whose positions are in an image of `size` (height, width).
    fn fit_in(
        &self,
        config: &FitConfig,
        size: (usize, usize),
        keep: impl Fn(usize) -> bool,
    ) -> Fit {
        let kept: Vec<usize> = (0..self.places.len()).filter(|&i| keep(i)).collect();
        let bases: Vec<f32> = kept
            .iter()
            .flat_map(|&i| self.bases[3 * i..3 * i + 3].to_vec())
            .collect();
        let depths: Vec<f32> = kept.iter().map(|&i| self.depths[i]).collect();
        let places: Vec<[f64; 2]> = kept.iter().map(|&i| self.places[i]).collect();
        let points = FitPoints {
            places: Some(&places),
            geometry: Some(FieldGeometry {
                size,
                ..self.geometry()
            }),
            ..FitPoints::new(&bases, &depths)
        };
        fit(&points, config, None).unwrap()
    }
}

/// The constant, and two functions of the place.
fn bases_at(places: &[[f64; 2]]) -> Vec<f32> {
    let row = |[x, y]: &[f64; 2]| [1.0, (x / 6.0 - 1.0) as f32, (y / 3.0).sin() as f32];
    places.iter().flat_map(row).collect()
}

fn all_places() -> Vec<[f64; 2]> {
    (0..HEIGHT * WIDTH)
        .map(|i| [(i % WIDTH) as f64, (i / WIDTH) as f64])
        .collect()
}

fn pixel([x, y]: [f64; 2]) -> usize {
    y as usize * WIDTH + x as usize
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

/// A fit that is linear in the depths.
fn settings(method: FitMethod) -> FitConfig {
    FitConfig {
        method,
        joint: JointConfig {
            surface: false,
            ..JointConfig::default()
        },
        prior: PriorKind::Flat,
        lambda: Lambda::Fixed(0.05),
        ..FitConfig::default()
    }
}

#[test]
fn left_out_residuals_are_those_of_fits_without_the_point() {
    let example = Example::new();
    for method in [FitMethod::Joint, FitMethod::Field] {
        let all = example.fit(&settings(method));
        let left_out = all.leave_one_out(&all.leverages(&example.bases));
        for (i, &[x, y]) in example.places.iter().enumerate() {
            let without = dense(&example.fit_some(&settings(method), |j| j != i));
            let expected = f64::from(example.depths[i]) - without[pixel([x, y])];
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
    for method in [FitMethod::Joint, FitMethod::Field] {
        let fit = example.fit(&settings(method));
        let dense = dense(&fit);
        for (i, &[x, y]) in example.places.iter().enumerate() {
            let expected = f64::from(example.depths[i]) - dense[pixel([x, y])];
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
    let found = fit
        .variances(|_, places| bases_at(places))
        .unwrap()
        .unwrap();

    // For field and weights together; the constant has no prior.
    let pixels = HEIGHT * WIDTH;
    let size = pixels + 3;
    let mut precision = precision(
        &example.affinities,
        JointConfig::default().diagonal_regularisation,
        size,
    );
    let functions = bases_at(&all_places());
    let row = |pixel: usize| {
        Mat::<f64>::from_fn(size, 1, |i, _| match i.checked_sub(pixels) {
            None => f64::from(i == pixel),
            Some(function) => f64::from(functions[3 * pixel + function]),
        })
    };
    for &[x, y] in &example.places {
        let row = row(pixel([x, y]));
        precision += faer::Scale(100.0) * &row * row.transpose();
    }
    for i in pixels + 1..size {
        precision[(i, i)] += lambda;
    }
    let factor = precision.llt(Side::Lower).unwrap();
    // The field alone: were the weights known.
    let alone = precision.get(..pixels, ..pixels).llt(Side::Lower).unwrap();
    for pixel in 0..pixels {
        let row = row(pixel);
        let variance = (row.transpose() * factor.solve(&row))[(0, 0)];
        let unit = Mat::from_fn(pixels, 1, |i, _| f64::from(u8::from(i == pixel)));
        let field = alone.solve(&unit)[(pixel, 0)];
        for (found, expected) in [
            (found.field[pixel], field),
            (found.field[pixel] + found.weights[pixel], variance),
        ] {
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
        }
    }
}

/// With an edge down the middle, blocks of four pixels vary nearly as these do; far fewer pixels than that are
/// blocks of their own.
#[test]
fn rough_variances_are_nearly_those_of_the_pixels() {
    let example = Example::new();
    let small = example.fit(&settings(FitMethod::Joint));
    let exact = small.variances(|_, places| bases_at(places));
    let rough = small.rough_variances(|_, places| bases_at(places));
    let (exact, rough) = (exact.unwrap().unwrap(), rough.unwrap().unwrap());
    assert_eq!(rough.size, (HEIGHT, WIDTH));
    // There are no cosines here.
    let pairs = [
        (&rough.field, &exact.field),
        (&rough.weights, &exact.weights),
    ];
    for (one, other) in pairs
        .into_iter()
        .flat_map(|(rough, exact)| rough.iter().zip(exact))
    {
        assert!((one - other).abs() < 1e-9, "{one} {other}");
    }

    let (height, width) = (180, 240);
    let cut = |i: usize| {
        if i.is_multiple_of(2) && i / 2 % width == 99 {
            1e-3
        } else {
            1.0
        }
    };
    let values: Vec<f32> = (0..2 * height * width).map(cut).collect();
    let affinities = Affinities::new((height, width), &values).unwrap();
    let mut rng = Rng::stream(3, &["rough"]);
    let mut place = || {
        [f64::from(width as u32), f64::from(height as u32)]
            .map(|most| (most * f64::from(rng.unit())).floor())
    };
    let places: Vec<[f64; 2]> = (0..60).map(|_| place()).collect();
    let bases = bases_at(&places);
    let depths: Vec<f32> = places
        .iter()
        .map(|[x, y]| (2.0 + 0.01 * x + (0.1 * y).sin()) as f32)
        .collect();
    let points = FitPoints {
        places: Some(&places),
        geometry: Some(FieldGeometry {
            affinities: &affinities,
            size: (height, width),
            upsampling: None,
            transient: false,
        }),
        ..FitPoints::new(&bases, &depths)
    };
    let fit = fit(&points, &settings(FitMethod::Joint), None).unwrap();
    let exact = fit
        .variances(|_, places| bases_at(places))
        .unwrap()
        .unwrap();
    let rough = fit
        .rough_variances(|_, places| bases_at(places))
        .unwrap()
        .unwrap();
    assert_eq!(rough.size, (height / 2, width / 2));
    for (block, variance) in rough.field.iter().enumerate() {
        let (x, y) = (2 * (block % (width / 2)), 2 * (block / (width / 2)));
        let near = places
            .iter()
            .any(|[u, v]| (u - x as f64).hypot(v - y as f64) < 6.0);
        let pixels = [0, 1, width, width + 1].map(|next| exact.field[y * width + x + next]);
        let ratio = variance / (pixels.iter().sum::<f64>() / 4.0);
        assert!(near || (0.75..1.1).contains(&ratio), "{x} {y}: {ratio}");
    }
}

/// Weights, steps between neighbours and points drawn from the model: the error of the fit divided by its
/// predicted deviation has variance 1, at every pixel, within five standard errors, and with deviations of the
/// measurements that are known, too.
#[test]
fn errors_of_scenes_drawn_from_the_model_vary_as_predicted() {
    const DRAWS: usize = 400;
    let pixels = HEIGHT * WIDTH;
    let places = places();
    let lambda: f64 = 0.05;
    // Strong regularisation, so that the field can be drawn.
    let joint = JointConfig {
        diagonal_regularisation: 1e-2,
        ..JointConfig::default()
    };
    let config = FitConfig {
        method: FitMethod::Joint,
        prior: PriorKind::Flat,
        lambda: Lambda::Fixed(lambda),
        joint,
        ..FitConfig::default()
    };
    let affinities = Affinities::new((HEIGHT, WIDTH), &affinities()).unwrap();
    let precision = precision(&affinities, joint.diagonal_regularisation, pixels);
    let lower = precision.llt(Side::Lower).unwrap();
    let functions = bases_at(&all_places());
    let bases = bases_at(&places);
    for given in [None, Some(0.3_f64)] {
        let mut rng = Rng::stream(11, &["model"]);
        let mut sums = vec![0.0; pixels];
        let mut variances = None;
        let (mut noises, scale) = (0.0, 0.1);
        for _ in 0..DRAWS {
            // L^-T z has the covariance (L L^T)^-1.
            let mut field = Mat::from_fn(pixels, 1, |_, _| scale * f64::from(rng.normal()));
            faer::linalg::triangular_solve::solve_upper_triangular_in_place(
                lower.L().transpose(),
                field.as_mut(),
                faer::Par::Seq,
            );
            let weights: Vec<f64> = (0..3)
                .map(|i| {
                    let spread = scale / lambda.sqrt() * f64::from(rng.normal());
                    if i == 0 { 8.0 } else { spread }
                })
                .collect();
            let truth: Vec<f64> = (0..pixels)
                .map(|p| {
                    let row = functions[3 * p..][..3].iter().zip(&weights);
                    row.map(|(f, w)| f64::from(*f) * w).sum::<f64>() + field[(p, 0)]
                })
                .collect();
            let own = given.map_or(0.0, |sigma| sigma * scale);
            let noise = (scale * scale / joint.observation_precision + own * own).sqrt();
            let depths: Vec<f32> = places
                .iter()
                .map(|&place| (truth[pixel(place)] + noise * f64::from(rng.normal())) as f32)
                .collect();
            let sigmas = [Some(own as f32); POINTS];
            let points = FitPoints {
                bases: BasisValues::AtPoints(&bases),
                guides: 0,
                depths: &depths,
                deviations: given.is_some().then_some(&sigmas[..]),
                places: Some(&places),
                geometry: Some(FieldGeometry {
                    affinities: &affinities,
                    size: (HEIGHT, WIDTH),
                    upsampling: None,
                    transient: false,
                }),
            };
            let fit = fit(&points, &config, None).unwrap();
            noises += fit.noise() / DRAWS as f64;
            let mut found = vec![0.0; pixels];
            fit.smooth().unwrap().add_to((HEIGHT, WIDTH), &mut found);
            for p in 0..pixels {
                let row = functions[3 * p..][..3].iter().zip(&fit.weights);
                let depth = row.map(|(f, w)| f64::from(*f) * w).sum::<f64>() + f64::from(found[p]);
                sums[p] += (depth - truth[p]).powi(2) / DRAWS as f64;
            }
            variances.get_or_insert_with(|| {
                fit.variances(|_, places| bases_at(places))
                    .unwrap()
                    .unwrap()
            });
        }
        // The variance of the steps is found again: its standard error is sqrt(2 / (19 DRAWS)), 1.6 %, and somewhat
        // more beside noise of its own.
        let (ratio, most) = (
            noises / (scale * scale),
            if given.is_some() { 0.2 } else { 0.08 },
        );
        assert!((ratio - 1.0).abs() < most, "{given:?}: {ratio}");
        if given.is_some() {
            // Weights differ with the noise that each draw suggests; without deviations they do not.
            continue;
        }
        let variances = variances.unwrap();
        for (p, sum) in sums.iter().enumerate() {
            let expected = scale * scale * (variances.field[p] + variances.weights[p]);
            let ratio = sum / expected;
            assert!(
                (ratio - 1.0).abs() < 5.0 * (2.0 / DRAWS as f64).sqrt(),
                "{p}: {ratio}"
            );
        }
    }
}

/// The precision of a field before it is observed, and zeros.
fn precision(affinities: &Affinities, diagonal_regularisation: f64, size: usize) -> Mat<f64> {
    let mut precision = Mat::<f64>::zeros(size, size);
    let grid = affinities.grid(diagonal_regularisation);
    let pixels = HEIGHT * WIDTH;
    (0..pixels).for_each(|i| precision[(i, i)] = diagonal_regularisation);
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
    let double = dense(&example.fit(&settings(FitMethod::Field)));
    // Twice the weight of one, which meets the mean closely either way.
    let single = dense(&Example::new().fit(&settings(FitMethod::Field)));
    for (a, b) in double.iter().zip(single) {
        assert!((a - b).abs() < 5e-3, "{a} {b}");
    }
}

#[test]
fn a_field_without_its_image_is_refused() {
    let example = Example::new();
    let points = FitPoints::new(&example.bases, &example.depths);
    let error = fit(&points, &settings(FitMethod::Joint), None).unwrap_err();
    assert!(error.to_string().contains("needs the image"), "{error}");
}

/// Root mean square error between points of a slanted plane, basis functions being the constant and
/// cosines.
fn error_on_a_plane(frequency: f64, kind: PriorKind, lambda: f64) -> f64 {
    let (height, width) = (36, 48);
    let plane = |x: f64, y: f64| (2.0 + 0.03 * x + 0.02 * y) as f32;
    let place = |i: i32| [i % 4 * 12 + 6, i / 4 * 12 + 6].map(f64::from);
    let places: Vec<[f64; 2]> = (0..12).map(place).collect();
    let depths: Vec<f32> = places.iter().map(|&[x, y]| plane(x, y)).collect();
    let cosines = CosineBasis::up_to(frequency);
    let rows = cosines.append_to(&[1.0; 12], 1, (height, width), &places);
    let affinities = Affinities::new((height, width), &vec![1.0; 2 * height * width]).unwrap();
    let unknown = NoisePrior {
        mean: 0.0,
        deviation: None,
        equivalent_points: 0.0,
    };
    let prior = Prior::new(&[1.0], &[0.1], unknown).unwrap();
    let config = FitConfig {
        method: FitMethod::Joint,
        prior: kind,
        lambda: Lambda::Fixed(lambda),
        joint: JointConfig {
            cosines: frequency,
            ..JointConfig::default()
        },
        ..FitConfig::default()
    };
    let points = FitPoints {
        bases: BasisValues::AtPoints(&rows),
        guides: 0,
        depths: &depths,
        deviations: None,
        places: Some(&places),
        geometry: Some(FieldGeometry {
            affinities: &affinities,
            size: (height, width),
            upsampling: None,
            transient: false,
        }),
    };
    let fit = fit(&points, &config, Some(&prior)).unwrap();
    assert_eq!((fit.functions(), fit.weights.len()), (1, 1 + cosines.len()));
    let mut dense = vec![fit.weights[0] as f32; height * width];
    cosines.add_to((height, width), &fit.weights[1..], &mut dense);
    fit.smooth().unwrap().add_to((height, width), &mut dense);
    // Slopes are undetermined beyond the points.
    let between = |i: &usize| (6..=42).contains(&(i % width)) && (6..=30).contains(&(i / width));
    let pixels: Vec<usize> = (0..dense.len()).filter(between).collect();
    let off =
        |&i: &usize| f64::from(dense[i] - plane((i % width) as f64, (i / width) as f64)).powi(2);
    (pixels.iter().map(off).sum::<f64>() / pixels.len() as f64).sqrt()
}

#[test]
fn cosines_carry_slopes_between_points() {
    // However strongly basis functions are drawn to their prior, and whichever it is.
    for kind in [PriorKind::Learned, PriorKind::Flat, PriorKind::None] {
        for lambda in [1e-3, 1e9] {
            let [without, with] = [0.0, 3.0].map(|f| error_on_a_plane(f, kind, lambda));
            assert!(
                with < 0.67 * without,
                "{with} with cosines, {without} without, {kind:?}, lambda {lambda}"
            );
        }
    }
}

#[test]
fn cosines_without_their_columns_are_refused() {
    let example = Example::new();
    let points = FitPoints {
        places: Some(&example.places),
        geometry: Some(example.geometry()),
        ..FitPoints::new(&example.bases, &example.depths)
    };
    let config = FitConfig {
        joint: JointConfig {
            cosines: 1.0,
            ..JointConfig::default()
        },
        ..settings(FitMethod::Joint)
    };
    let error = fit(&points, &config, None).unwrap_err();
    assert!(error.to_string().contains("too few"), "{error}");
}

/// Places of an image three times as large as the field: between its pixels, and one beyond the centres
/// of the outermost.
fn places_between() -> Vec<[f64; 2]> {
    let [us, vs] = ["u", "v"].map(|name| random(POINTS, name));
    let inside = |value: f64, length: usize| f64::midpoint(value.sin(), 1.0) * length as f64 - 0.5;
    let pairs = us.into_iter().zip(vs);
    let place = |(u, v)| [inside(7.0 * u, 3 * WIDTH), inside(7.0 * v, 3 * HEIGHT)];
    let mut places: Vec<[f64; 2]> = pairs.map(place).collect();
    places[4] = [3.0 * WIDTH as f64 - 0.6, -0.4];
    places
}

/// Basis functions `[places, 3]` and the map of a fit at any places of the larger image.
fn read_at(fit: &Fit, places: &[[f64; 2]]) -> Vec<f64> {
    let size = (3 * HEIGHT, 3 * WIDTH);
    let mut field = vec![0.0; size.0 * size.1];
    fit.smooth().unwrap().add_to(size, &mut field);
    let field: Vec<f64> = field.into_iter().map(f64::from).collect();
    let rows = bases_at(places);
    let pairs = rows.chunks_exact(3).zip(places);
    pairs
        .map(|(row, &place)| {
            let functions: f64 = row
                .iter()
                .zip(&fit.weights)
                .map(|(b, w)| f64::from(*b) * w)
                .sum();
            functions + crate::bilinear::InterpolationWeights::new(place, size, size).read(&field)
        })
        .collect()
}

fn between(method: FitMethod) -> (Example, Fit) {
    let example = Example::at(places_between());
    let fit = example.fit_in(&settings(method), (3 * HEIGHT, 3 * WIDTH), |_| true);
    (example, fit)
}

#[test]
fn residuals_between_pixels_are_those_of_the_map_that_is_written() {
    // On centres of the larger image, where the written map has values.
    let centres = |p: [f64; 2]| p.map(|v| v.round().max(0.0));
    for method in [FitMethod::Joint, FitMethod::Field] {
        let mut example = Example::at(places_between().into_iter().map(centres).collect());
        example.depths[7] += 0.4;
        let fit = example.fit_in(&settings(method), (3 * HEIGHT, 3 * WIDTH), |_| true);
        let written = read_at(&fit, &example.places);
        for (i, written) in written.into_iter().enumerate() {
            let expected = f64::from(example.depths[i]) - written;
            assert!(
                (fit.residuals[i] - expected).abs() < 1e-5,
                "{i}: {} {expected}",
                fit.residuals[i]
            );
        }
    }
}

#[test]
fn leave_one_out_residuals_between_pixels_are_those_of_fits_without_the_point() {
    let size = (3 * HEIGHT, 3 * WIDTH);
    // So far from each other that none is lumped: others might not be without it.
    let places = places_between();
    let cells = places
        .iter()
        .map(|place| place.map(|v| ((v + 0.5) / 3.0).floor()));
    let cells: Vec<[f64; 2]> = cells.collect();
    let mut kept: Vec<usize> = Vec::new();
    for i in 0..POINTS {
        let apart = |j: &usize| (0..2).any(|axis| (cells[i][axis] - cells[*j][axis]).abs() > 3.0);
        if kept.iter().all(apart) {
            kept.push(i);
        }
    }
    let few = |i: usize| kept.contains(&i);
    for method in [FitMethod::Joint, FitMethod::Field] {
        let example = Example::at(places.clone());
        let all = example.fit_in(&settings(method), size, few);
        let found = all.leave_one_out(&all.leverages(&example.bases));
        assert!(found.len() > 3, "{}", found.len());
        for (i, found) in (0..POINTS).filter(|&i| few(i)).zip(found) {
            let without = example.fit_in(&settings(method), size, |j| few(j) && j != i);
            // The field itself is linear between the centres of its own pixels only.
            let field = without.smooth().unwrap();
            let mut own = vec![0.0; HEIGHT * WIDTH];
            field.add_to((HEIGHT, WIDTH), &mut own);
            let own: Vec<f64> = own.into_iter().map(f64::from).collect();
            let interpolation = crate::bilinear::InterpolationWeights::new(
                example.places[i],
                size,
                (HEIGHT, WIDTH),
            );
            let row = &example.bases[3 * i..][..3];
            let functions = row
                .iter()
                .zip(&without.weights)
                .map(|(b, w)| f64::from(*b) * w);
            let expected =
                f64::from(example.depths[i]) - functions.sum::<f64>() - interpolation.read(&own);
            assert!((found - expected).abs() < 1e-5, "{i}: {found} {expected}");
        }
    }
}

#[test]
fn the_order_of_points_changes_no_bit() {
    let (example, fit) = between(FitMethod::Joint);
    let turn = |i: usize| (i * 7 + 3) % POINTS;
    let turned = Example {
        affinities: Affinities::new((HEIGHT, WIDTH), &affinities()).unwrap(),
        bases: (0..POINTS)
            .flat_map(|i| example.bases[3 * turn(i)..][..3].to_vec())
            .collect(),
        depths: (0..POINTS).map(|i| example.depths[turn(i)]).collect(),
        places: (0..POINTS).map(|i| example.places[turn(i)]).collect(),
    };
    let other = turned.fit_in(&settings(FitMethod::Joint), (3 * HEIGHT, 3 * WIDTH), |_| {
        true
    });
    assert_eq!(fit.weights, other.weights);
    assert_eq!(fit.smooth(), other.smooth());
}

/// More points than a fit from the moments of all columns takes, on a grid of `MANY` x `MANY` pixels; a constant,
/// two functions and cosines.
const MANY: usize = 40;

struct Many {
    affinities: Affinities,
    places: Vec<[f64; 2]>,
    rows: Vec<f32>,
    depths: Vec<f32>,
    config: FitConfig,
}

impl Many {
    fn new() -> Self {
        let size = (MANY, MANY);
        let values = random(2 * MANY * MANY, "many edges");
        let values: Vec<f32> = values.iter().map(|v| v.exp() as f32).collect();
        let mut places: Vec<[f64; 2]> = (0..MANY * MANY)
            .map(|i| [(i % MANY) as f64, (i / MANY) as f64])
            .collect();
        Rng::stream(2, &["many"]).choose(&mut places, 1200);
        places.truncate(1200);
        let cosines = CosineBasis::up_to(0.5);
        let rows = cosines.append_to(&bases_at(&places), 3, size, &places);
        let wobble = random(places.len(), "many wobble");
        let depth = |([x, y], w): (&[f64; 2], &f64)| {
            (3.0 + 0.1 * x - 0.05 * y + (0.2 * x).sin() + 0.1 * w) as f32
        };
        let depths = places.iter().zip(&wobble).map(depth).collect();
        let config = FitConfig {
            joint: JointConfig {
                cosines: 0.5,
                ..JointConfig::default()
            },
            ..settings(FitMethod::Joint)
        };
        Self {
            affinities: Affinities::new(size, &values).unwrap(),
            places,
            rows,
            depths,
            config,
        }
    }

    fn fit(&self) -> Fit {
        let points = FitPoints {
            bases: BasisValues::AtPoints(&self.rows),
            guides: 0,
            depths: &self.depths,
            deviations: None,
            places: Some(&self.places),
            geometry: Some(FieldGeometry {
                affinities: &self.affinities,
                size: (MANY, MANY),
                upsampling: None,
                transient: false,
            }),
        };
        fit(&points, &self.config, None).unwrap()
    }

    /// The equations of field and weights together, and their right-hand side.
    fn equations(&self) -> (Mat<f64>, Mat<f64>) {
        let (pixels, columns) = (MANY * MANY, self.rows.len() / self.places.len());
        let size = pixels + columns;
        let joint = self.config.joint;
        let mut matrix = Mat::<f64>::zeros(size, size);
        let grid = self.affinities.grid(joint.diagonal_regularisation);
        for i in 0..pixels {
            matrix[(i, i)] += joint.diagonal_regularisation;
            let right = ((i + 1) % MANY > 0).then_some((i + 1, grid.right[i]));
            let down = (i + MANY < pixels).then_some((i + MANY, grid.down[i]));
            for (j, strength) in right.into_iter().chain(down) {
                for (a, b, sign) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
                    matrix[(a, b)] += sign * strength;
                }
            }
        }
        let mut right = Mat::<f64>::zeros(size, 1);
        for (p, [x, y]) in self.places.iter().enumerate() {
            let mut row = vec![(*y as usize * MANY + *x as usize, 1.0)];
            let own = self.rows[p * columns..][..columns].iter().enumerate();
            row.extend(own.map(|(j, value)| (pixels + j, f64::from(*value))));
            for &(i, a) in &row {
                right[(i, 0)] += joint.observation_precision * a * f64::from(self.depths[p]);
                for &(j, b) in &row {
                    matrix[(i, j)] += joint.observation_precision * a * b;
                }
            }
        }
        // The constant is not penalised.
        let ridges = CosineBasis::up_to(joint.cosines).ridges(joint.bending);
        let penalties = [0.05; 2].into_iter().chain(ridges);
        for (i, penalty) in penalties.enumerate() {
            matrix[(pixels + 1 + i, pixels + 1 + i)] += penalty;
        }
        (matrix, right)
    }
}

#[test]
fn many_points_have_the_field_of_the_dense_equations() {
    let many = Many::new();
    let (matrix, right) = many.equations();
    let found = many.fit();
    let (pixels, columns) = (MANY * MANY, found.weights.len());
    // The equations of the field for the fitted weights.
    let weights = Mat::from_fn(columns, 1, |j, _| found.weights[j]);
    let right_of_field = right.get(..pixels, ..) - matrix.get(..pixels, pixels..) * weights;
    let own = matrix.get(..pixels, ..pixels).llt(Side::Lower).unwrap();
    let expected = own.solve(right_of_field);
    let mut field = vec![0.0; pixels];
    found.smooth().unwrap().add_to((MANY, MANY), &mut field);
    for (value, expected) in field.iter().zip(expected.col(0).iter()) {
        assert!(
            (f64::from(*value) - expected).abs() < 1e-5,
            "{value} {expected}"
        );
    }
}

#[test]
fn weights_of_many_points_are_nearly_those_of_the_dense_equations() {
    let many = Many::new();
    let (matrix, right) = many.equations();
    let equations = matrix.llt(Side::Lower).unwrap();
    let expected = equations.solve(&right);
    let covariance = equations.solve(Mat::<f64>::identity(right.nrows(), right.nrows()));
    let found = many.fit();
    let first = MANY * MANY;
    // They are estimated from a part of the points, so their errors are larger than with all points.
    for (j, weight) in found.weights.iter().enumerate() {
        let deviation = (covariance[(first + j, first + j)] * found.noise).sqrt();
        let off = (weight - expected[(first + j, 0)]) / deviation;
        assert!(off.abs() < 3.0, "{j}: {off}");
    }
}

#[test]
fn leverages_of_many_points_have_the_sum_of_the_exact_ones() {
    let many = Many::new();
    let (matrix, _) = many.equations();
    let factor = matrix.llt(Side::Lower).unwrap();
    let (pixels, columns) = (MANY * MANY, many.rows.len() / many.places.len());
    let rows = Mat::from_fn(pixels + columns, many.places.len(), |i, p| {
        match i.checked_sub(pixels) {
            None => f64::from(u8::from(
                i == many.places[p][1] as usize * MANY + many.places[p][0] as usize,
            )),
            Some(j) => f64::from(many.rows[p * columns + j]),
        }
    });
    let solved = factor.solve(&rows);
    let exact = |p: usize| 100.0 * (rows.col(p).transpose() * solved.col(p));
    let expected: f64 = (0..many.places.len()).map(|p| 1.0 - exact(p)).sum();
    let fit = many.fit();
    let leverages = fit.leverages(&many.rows);
    let found: f64 = leverages.iter().map(|h| 1.0 - h).sum();
    assert!((found / expected - 1.0).abs() < 0.02, "{found} {expected}");
}

/// Colours of an image three times as large as the field.
fn upsampling() -> Upsampling {
    let colours = |count: usize, name: &str| {
        let values = random(3 * count, name);
        values.iter().map(|v| (128.0 + 10.0 * v) as u8).collect()
    };
    let (size, grid) = ((3 * HEIGHT, 3 * WIDTH), (HEIGHT, WIDTH));
    let image = (colours(size.0 * size.1, "image"), size);
    Upsampling::new(image, (colours(grid.0 * grid.1, "grid"), grid)).unwrap()
}

/// Step terms of a point have a hundredth of its weight times the shares of its pixels, where affinities are low: compares both
/// forms of the field with dense equations.
#[test]
fn points_of_a_larger_image_have_step_terms() {
    let upsampling = upsampling();
    let edges = random(2 * HEIGHT * WIDTH, "weak edges");
    let edges: Vec<f32> = edges.iter().map(|v| (2.0 * v - 3.0).exp() as f32).collect();
    let example = Example {
        affinities: Affinities::new((HEIGHT, WIDTH), &edges).unwrap(),
        ..Example::at(places_between())
    };
    let geometry = FieldGeometry {
        affinities: &example.affinities,
        size: (3 * HEIGHT, 3 * WIDTH),
        upsampling: Some(&upsampling),
        transient: false,
    };
    let points = FitPoints {
        places: Some(&example.places),
        ..FitPoints::new(&example.bases, &example.depths)
    };
    let rows = points.rows().unwrap();
    let joint = JointConfig {
        diagonal_regularisation: 1e-2,
        ..JointConfig::default()
    };
    let merged = MergedObservations::new(&rows, &rows.weights, geometry, &joint).unwrap();

    let pixels = HEIGHT * WIDTH;
    let mut equations = precision(&example.affinities, joint.diagonal_regularisation, pixels);
    let seen = Mat::from_fn(merged.interpolation.len(), pixels, |i, pixel| {
        let own = merged.interpolation[i]
            .iter()
            .filter(|tap| tap.0 as usize == pixel);
        own.map(|tap| tap.1).sum::<f64>()
    });
    let grid = example.affinities.grid(joint.diagonal_regularisation);
    let (mut tied, mut apart) = (0, 0);
    for (i, weight) in merged.weights.iter().enumerate() {
        for one in 0..pixels {
            for (other, along) in [(one + 1, grid.right), (one + WIDTH, grid.down)] {
                let inside = other < pixels && (other != one + 1 || other % WIDTH > 0);
                if !inside || seen[(i, one)] * seen[(i, other)] == 0.0 {
                    continue;
                }
                let strength = 0.01 * weight * seen[(i, one)] * seen[(i, other)];
                if strength <= 4.0 * along[one] {
                    apart += 1;
                    continue;
                }
                tied += 1;
                equations[(one, one)] += strength;
                equations[(other, other)] += strength;
                equations[(one, other)] -= strength;
                equations[(other, one)] -= strength;
            }
        }
    }
    assert!(tied > 5 && apart > 5, "{tied} {apart}");
    let covariance = &seen * equations.partial_piv_lu().solve(seen.transpose());
    let noisy = Mat::from_fn(seen.nrows(), seen.nrows(), |i, j| {
        let noise = if i == j {
            merged.weights[i].recip()
        } else {
            0.0
        };
        covariance[(i, j)] + noise
    });
    let sample = merged.sample(merged.len(), &rows).unwrap();
    let columns = sample.columns() + 1;
    let targets = Mat::from_fn(seen.nrows(), columns, |i, j| sample.rows[i * columns + j]);
    let expected = targets.transpose() * noisy.partial_piv_lu().solve(&targets);
    let smoothness = Smoothness {
        affinities: example.affinities.clone(),
        regularisation: joint.diagonal_regularisation,
        smooths_steps: true,
        lumped: false,
    };
    let few = smoothness.covariance_solver(&sample).unwrap();
    let many = smoothness
        .observed(&merged.interpolation, &merged.weights)
        .unwrap();
    for moments in [few.moments().clone(), many.moments(&sample.rows, columns)] {
        for j in 0..columns {
            for i in j..columns {
                let (found, expected) = (moments[(i, j)], expected[(i, j)]);
                assert!(
                    (found - expected).abs() < 1e-9 * expected.abs().max(1.0),
                    "{found} {expected}"
                );
            }
        }
    }
}

#[test]
fn a_larger_image_is_observed_as_it_is_read() {
    let upsampling = upsampling();
    let example = Example::at(places_between());
    let size = (3 * HEIGHT, 3 * WIDTH);
    let points = FitPoints {
        places: Some(&example.places),
        geometry: Some(FieldGeometry {
            size,
            upsampling: Some(&upsampling),
            transient: false,
            ..example.geometry()
        }),
        ..FitPoints::new(&example.bases, &example.depths)
    };
    let fit = fit(&points, &settings(FitMethod::Joint), None).unwrap();
    let leverages = fit.leverages(&example.bases);
    for (i, &place) in example.places.iter().enumerate() {
        let row = example.bases[3 * i..][..3].iter().zip(&fit.weights);
        let functions: f64 = row.map(|(b, w)| f64::from(*b) * w).sum();
        let smooth = fit
            .smooth()
            .unwrap()
            .read(&upsampling.interpolation(place, size));
        let expected = f64::from(example.depths[i]) - functions - smooth;
        assert!((fit.residuals[i] - expected).abs() < 1e-6);
        assert!((0.0..=1.0).contains(&leverages[i]));
    }
}
