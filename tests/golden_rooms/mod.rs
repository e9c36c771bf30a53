//! Completions of rooms with the weights of the program and with classical methods, for comparison with
//! `crates/weights/golden/depths.safetensors` by the test `golden_depths`, and on other platforms by the example `golden` of
//! lsdc-eval.

use lsdc_classic::Classic;
use lsdc_core::fit::{Changes, FitMethod, Loss, PriorKind, Robust};
use lsdc_core::{Completer, Completion, DepthGuide, GuideKind, Observation, Observations, Quality};
use lsdc_eval::data::{Dataset, DepthMap, Frame, Rooms, RoomsConfig, Split};
use lsdc_eval::metrics::{Metric, Rules, Scores};
use lsdc_eval::predict::{complete_classic, guided_scene, scene};
use lsdc_eval::sampling::{Pattern, Protocol, Size};
use lsdc_kernels::simd::Level;
use lsdc_rng::Rng;
use safetensors::{SafeTensors, tensor::TensorView};
use std::collections::BTreeMap;

/// Tolerance relative to the range of true depths. On another processor (Sapphire Rapids) than that of the file, results differ
/// by up to 1.5e-5 with the same vector width, because sums are divided into other blocks.
pub(crate) const TOLERANCE: f32 = 2e-5;
/// Tolerance without fused multiply-add, where all layers of the network round every product before adding it. All but three of
/// 134 results (the fit without a prior, and leave-one-out errors) then differ by less than 1.2e-5.
const TOLERANCE_PORTABLE: f32 = 3e-5;
/// Factor of the tolerance of ill-conditioned results. A leave-one-out error is a residual divided by 1 - leverage, which
/// amplifies rounding errors: without fused multiply-add, two of them differ by 3.1e-5 and 4.6e-5. The fit without a prior
/// differs by 4.6e-5. All other depths are within the tolerances above.
const MULTIPLIED: f32 = 2.0;
/// Columns and rows of the grids.
const GRID: (usize, usize) = (24, 18);
/// Number of leave-one-out errors kept per result.
const POINTS: usize = 16;

/// Values, the scale of their differences, and the tolerance relative to the scale on processors like that of the file.
pub(crate) struct Result {
    pub(crate) values: Vec<f32>,
    pub(crate) scale: f32,
    pub(crate) tolerance: f32,
}

impl Result {
    /// Returns the tolerance for the current instruction set.
    pub(crate) fn allowed(&self) -> f32 {
        allowance() * self.tolerance
    }
}

pub(crate) type Results = BTreeMap<String, Result>;

/// A room with the points of one input.
pub(crate) struct Input {
    pub(crate) name: &'static str,
    pub(crate) frame: Frame,
    pub(crate) points: Observations,
}

pub(crate) fn room(index: usize, (width, height): (usize, usize)) -> Frame {
    let config = RoomsConfig {
        width,
        height,
        ..RoomsConfig::default()
    };
    Rooms::new(Split::Val, &config)
        .unwrap()
        .load(index)
        .unwrap()
}

/// Depths of a depth camera, with holes in blocks, along depth edges and beyond a range.
fn camera(frame: &Frame) -> DepthMap {
    let (width, height) = (frame.depth.width(), frame.depth.height());
    let far = 0.9 * frame.depth.range().unwrap().1;
    let value = |i: usize| {
        let (x, y) = (i % width, i / width);
        let depth = frame.depth.at(x, y);
        let jumps = [(x + 2, y), (x, y + 2)].into_iter().any(|(x, y)| {
            let other = frame.depth.get(x, y).unwrap_or(depth);
            (other - depth).abs() > 0.1 * depth
        });
        let block = (x / 24 + 5 * (y / 18)) % 11 == 0;
        if jumps || block || depth > far {
            0.0
        } else {
            depth
        }
    };
    DepthMap::new(width, height, (0..width * height).map(value).collect()).unwrap()
}

pub(crate) fn inputs() -> Vec<Input> {
    let small = (304, 228);
    let input = |name, index, size, points: &dyn Fn(&Frame) -> Observations| {
        let frame = room(index, size);
        let points = points(&frame);
        Input {
            name,
            frame,
            points,
        }
    };
    let drawn = |pattern: Pattern| {
        move |frame: &Frame| Observations::from_map(&pattern.draw(frame, 7).unwrap())
    };
    // Points between pixels with errors of known standard deviations, and outliers.
    let changed = |change: &dyn Fn(&mut Rng, &Observation) -> Observation, frame: &Frame| {
        let mut rng = Rng::stream(7, &["golden", &frame.id]);
        let points = drawn(Pattern::Exactly(500))(frame);
        points
            .iter()
            .map(|point| change(&mut rng, point))
            .collect::<Observations>()
    };
    let measured = |rng: &mut Rng, point: &Observation| {
        let sigma = 0.03 * point.depth * rng.range(0.5, 1.5);
        Observation {
            u: (point.u + f64::from(rng.range(-0.4, 0.4))).clamp(0.0, 303.0),
            v: (point.v + f64::from(rng.range(-0.4, 0.4))).clamp(0.0, 227.0),
            depth: (point.depth + sigma * rng.normal()).max(0.1),
            sigma: Some(sigma),
        }
    };
    let wrong = |rng: &mut Rng, point: &Observation| Observation {
        depth: point.depth
            * if rng.chance(0.1) {
                rng.range(1.5, 3.0)
            } else {
                1.0
            },
        ..*point
    };
    vec![
        input("one", 0, small, &drawn(Pattern::Exactly(1))),
        input("five", 1, small, &drawn(Pattern::Exactly(5))),
        input("random", 2, small, &drawn(Pattern::Exactly(500))),
        input("many", 3, small, &drawn(Pattern::Exactly(5000))),
        input("grid", 4, small, &drawn(Pattern::Grid(14))),
        input("lines", 5, small, &drawn(Pattern::Lines(12))),
        input("corners", 6, small, &drawn(Pattern::Corners(200))),
        input("half", 7, small, &drawn(Pattern::Half(200))),
        input("holes", 8, small, &|frame| {
            Observations::from_map(&camera(frame))
        }),
        input("sigma", 9, small, &|frame| changed(&measured, frame)),
        input("outliers", 10, small, &|frame| changed(&wrong, frame)),
        input("large", 11, (640, 480), &|frame| {
            Observations::from_map(&camera(frame))
        }),
    ]
}

pub(crate) fn grid(map: &DepthMap) -> Vec<f32> {
    let (columns, rows) = GRID;
    let place = |i: usize, of: usize, length: usize| (2 * i + 1) * length / (2 * of);
    let at = |i: usize| {
        let (x, y) = (i % columns, i / columns);
        map.at(place(x, columns, map.width()), place(y, rows, map.height()))
    };
    (0..columns * rows).map(at).collect()
}

/// Adds the results of `completer` for an input: all results of the default settings, and the depths of others.
fn of_network(results: &mut Results, name: &str, completer: &Completer, input: &Input) {
    let Input { frame, points, .. } = input;
    let (low, high) = frame.depth.range().unwrap();
    let mut add = |what: &str, values: Vec<f32>| {
        let ill_conditioned = ["left out", "paper"].contains(&what);
        let multiplied = if ill_conditioned { MULTIPLIED } else { 1.0 };
        let (scale, tolerance) = (high - low, multiplied * TOLERANCE);
        let old = results.insert(
            format!("{name}/{}/{what}", input.name),
            Result {
                values,
                scale,
                tolerance,
            },
        );
        assert!(old.is_none());
    };
    let depths = |found: &Completion| grid(&found.depth().unwrap());
    let shown = scene(completer, &frame.rgb).unwrap();
    let found = shown.complete(points).unwrap();
    add("depth", depths(&found));
    add("sigma", grid(&found.standard_deviation().unwrap()));
    let errors = found.leave_one_out();
    add(
        "left out",
        errors.iter().take(POINTS).map(|&e| e as f32).collect(),
    );

    let with = |changes: &Changes| {
        let completer = completer.with_fit(completer.fit_config().changed(changes));
        let shown = scene(&completer, &frame.rgb).unwrap();
        depths(&shown.complete(points).unwrap())
    };
    let mut fits = vec![(
        "robust",
        Changes {
            robust: Some(Some(Robust::new(Loss::Auto))),
            ..Changes::default()
        },
    )];
    let method = |method| Changes {
        method: Some(method),
        ..Changes::default()
    };
    fits.push(("field", method(FitMethod::Field)));
    fits.push(("lse", method(FitMethod::Lse)));
    if input.name == "random" {
        fits.push((
            "paper",
            Changes {
                prior: Some(PriorKind::None),
                ..method(FitMethod::Lse)
            },
        ));
    }
    if ["five", "random", "holes", "sigma", "outliers"].contains(&input.name) {
        for (what, changes) in &fits {
            add(what, with(changes));
        }
    }
    match input.name {
        "five" => {
            let before: Vec<f64> = found.weights().iter().map(|w| 1.1 * w).collect();
            add(
                "temporal",
                depths(&shown.complete_near(points, &before).unwrap()),
            );
        }
        "random" => {
            let guide: Vec<f32> = frame.depth.values().iter().map(|d| 3.0 / d + 0.2).collect();
            let (width, height) = (frame.depth.width(), frame.depth.height());
            let guide = DepthGuide::new(GuideKind::Disparity, width, height, &guide).unwrap();
            let guided = guided_scene(completer, &frame.rgb, Some(&guide)).unwrap();
            add("guide", depths(&guided.complete(points).unwrap()));
            let best = scene(&completer.with_quality(Quality::Best), &frame.rgb).unwrap();
            add("best", depths(&best.complete(points).unwrap()));
        }
        "large" => {
            let full = completer.with_working_size(480, 640).unwrap();
            let sparse = Observations::from_map(&Pattern::Exactly(500).draw(frame, 7).unwrap());
            add("sparse", depths(&shown.complete(&sparse).unwrap()));
            let full = scene(&full, &frame.rgb).unwrap();
            add("full", depths(&full.complete(&sparse).unwrap()));
        }
        _ => {}
    }
}

/// Returns the results for all inputs with each of the program's weights and with classical methods.
pub(crate) fn of_rooms(inputs: &[Input], completer: impl Fn(&str) -> Completer) -> Results {
    let mut results = Results::new();
    for name in ["default", "small"] {
        let completer = completer(name);
        for input in inputs {
            of_network(&mut results, name, &completer, input);
        }
    }
    // Other parts of evaluations: classical methods, resizing, measures.
    let frame = room(2, (304, 228));
    let protocol = Protocol {
        resize: Some(Size {
            height: 120,
            width: 160,
        }),
        ..Protocol::default()
    };
    let frame = protocol.apply(&frame).unwrap();
    let sparse = Pattern::Bernoulli(300).draw(&frame, 7).unwrap();
    let (low, high) = frame.depth.range().unwrap();
    // `linear-inverse` shares the code of `linear` and is compared with SciPy (`golden.rs`). A new entry here would change the
    // hash of the file and thereby invalidate all earlier results.
    let methods = Classic::ALL.into_iter();
    for method in methods.filter(|method| *method != Classic::LinearInverse) {
        let depth = complete_classic(method, &frame.rgb, &sparse).unwrap();
        let scores = Scores::of(&depth, &frame.depth, &Rules::default()).unwrap();
        let scores: Vec<f32> = Metric::ALL
            .iter()
            .map(|&metric| scores[metric] as f32)
            .collect();
        let largest = scores.iter().fold(0.0, |most: f32, s| most.max(s.abs()));
        let name = |what: &str| format!("{}/{what}", method.name());
        results.insert(
            name("depth"),
            Result {
                values: grid(&depth),
                scale: high - low,
                tolerance: TOLERANCE,
            },
        );
        results.insert(
            name("scores"),
            Result {
                values: scores,
                scale: largest,
                tolerance: TOLERANCE,
            },
        );
    }
    results
}

/// Reads golden values from the bytes of their file.
pub(crate) fn read(bytes: &[u8]) -> BTreeMap<String, Vec<f32>> {
    let tensors = SafeTensors::deserialize(bytes).unwrap().tensors();
    let values = |view: &TensorView<'_>| {
        let (numbers, _) = view.data().as_chunks::<4>();
        numbers
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect()
    };
    let named = tensors.iter();
    named
        .map(|(name, view)| (name.clone(), values(view)))
        .collect()
}

/// Factor of the tolerance for the current instruction set, relative to the instruction sets of the file.
fn allowance() -> f32 {
    match Level::here() {
        Level::Portable => TOLERANCE_PORTABLE / TOLERANCE,
        Level::Neon | Level::Avx2 | Level::Avx512 => 1.0,
    }
}

/// Largest difference in multiples of the tolerance; infinite if the number of values differs or only one of two values is NaN.
pub(crate) fn difference(golden: Option<&Vec<f32>>, found: &Result) -> f32 {
    let Some(golden) = golden.filter(|golden| golden.len() == found.values.len()) else {
        return f32::INFINITY;
    };
    let pairs = golden.iter().zip(&found.values);
    let tolerance = found.allowed() * found.scale;
    pairs.fold(0.0, |most: f32, (a, b)| {
        let apart = if a == b || (a.is_nan() && b.is_nan()) {
            0.0
        } else {
            (a - b).abs() / tolerance
        };
        most.max(if apart.is_nan() { f32::INFINITY } else { apart })
    })
}
