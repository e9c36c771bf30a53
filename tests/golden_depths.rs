//! Completed depth is what it was: results for rooms, on coarse grids, are those of `crates/weights/golden`
//! at every instruction set. So are predictions of a tiny Depth Anything.
//!
//! A change of numerics fails here until the file is updated on purpose:
//!
//!     LSDC_UPDATE_GOLDEN=1 cargo test --release --test golden_depths
//!
//! which replaces only what differs. The file identifies the numerics of the program, so results that were kept on disk
//! are then computed anew (`provenance::numerics`).

#![allow(clippy::print_stdout, clippy::unwrap_used)]

mod depth_anything;

use lsdc::config::Config;
use lsdc_classic::Classic;
use lsdc_core::fit::{Changes, FitConfig, FitMethod, Loss, PriorKind, Robust};
use lsdc_core::network::{DepthHead, Encoder, EncoderConfig};
use lsdc_core::weights::Tensor;
use lsdc_core::{
    Channels, Completer, Completion, DepthAnything, DepthGuide, GuideKind, Image, Observation,
    Observations, Quality,
};
use lsdc_eval::data::{Dataset, DepthMap, Frame, Rooms, RoomsConfig, Split};
use lsdc_eval::metrics::{Metric, Rules, Scores};
use lsdc_eval::predict::{complete_classic, guided_scene, scene};
use lsdc_eval::sampling::{Pattern, Protocol, Size};
use lsdc_kernels::simd::Level;
use lsdc_rng::Rng;
use lsdc_train::device::Device;
use lsdc_train::predict::completer;
use lsdc_train::training::{Trainer, TrainingEvent};
use lsdc_weights::open_weights;
use lsdc_weights::provenance;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::AtomicBool;

/// Results may differ by this share of the range of true depths. On another processor (Sapphire Rapids) than
/// the file was made on, results differ by up to 1.5e-5 with the same vectors: sums are cut into other blocks.
const TOLERANCE: f32 = 2e-5;
/// The same of the losses of a training, each of whose steps starts from the rounding of the ones before: up to 2.4e-5.
const TOLERANCE_TRAINED: f32 = 5e-5;
/// The same without fused multiply-add, where every product is rounded before it is added, in all layers of the network:
/// all but three of 134 results then differ by less than 1.2e-5 (the fit without a prior, and leave-one-out errors).
const TOLERANCE_PORTABLE: f32 = 3e-5;
/// A leave-one-out error is a residual over 1 - leverage, which multiplies what the residual is rounded by: without fused
/// multiply-add, two of them differ by 3.1e-5 and 4.6e-5. The fit without a prior is ill-conditioned: one differs by 4.6e-5.
/// No other depth differs by more than above.
const MULTIPLIED: f32 = 2.0;
/// Columns and rows of the grids.
const GRID: (usize, usize) = (24, 18);
/// Leave-one-out errors that are kept of a result.
const POINTS: usize = 16;

/// Values, and what they may differ by.
struct Result {
    values: Vec<f32>,
    tolerance: f32,
}

type Results = BTreeMap<String, Result>;

/// A room with the points of one input.
struct Input {
    name: &'static str,
    frame: Frame,
    points: Observations,
}

fn room(index: usize, (width, height): (usize, usize)) -> Frame {
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

/// The depths of a depth camera: holes in blocks, along jumps of depth and beyond a range.
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

fn inputs() -> Vec<Input> {
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
    // Errors of known standard deviations at positions between pixels, and wrong depths.
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

fn grid(map: &DepthMap) -> Vec<f32> {
    let (columns, rows) = GRID;
    let place = |i: usize, of: usize, length: usize| (2 * i + 1) * length / (2 * of);
    let at = |i: usize| {
        let (x, y) = (i % columns, i / columns);
        map.at(place(x, columns, map.width()), place(y, rows, map.height()))
    };
    (0..columns * rows).map(at).collect()
}

/// Adds the results of `completer` for an input: the default settings in full, others by their depths.
fn of_network(results: &mut Results, name: &str, completer: &Completer, input: &Input) {
    let Input { frame, points, .. } = input;
    let (low, high) = frame.depth.range().unwrap();
    let mut add = |what: &str, values: Vec<f32>| {
        let ill_conditioned = ["left out", "paper"].contains(&what);
        let multiplied = if ill_conditioned { MULTIPLIED } else { 1.0 };
        let tolerance = multiplied * TOLERANCE * (high - low);
        let old = results.insert(
            format!("{name}/{}/{what}", input.name),
            Result { values, tolerance },
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

fn compute() -> Results {
    let inputs = inputs();
    let mut results = Results::new();
    for name in ["default", "small"] {
        let weights = open_weights(Some(name.as_ref())).unwrap();
        let completer = completer(&weights, &Device::flex()).unwrap();
        for input in &inputs {
            of_network(&mut results, name, &completer, input);
        }
    }
    let name = "depth-anything/inverse depth".to_owned();
    results.insert(name, inverse_depth(&inputs[2].frame));
    // What else numbers of evaluations are made of: other methods, resizing, measures.
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
    // `linear-inverse` shares the code of `linear` and is compared with SciPy (`golden.rs`): a new entry here would
    // change the hash of the file, and so make all earlier results obsolete.
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
                tolerance: TOLERANCE * (high - low),
            },
        );
        results.insert(
            name("scores"),
            Result {
                values: scores,
                tolerance: TOLERANCE * largest,
            },
        );
    }
    let values = trained();
    let tolerance = TOLERANCE_TRAINED * values[0];
    results.insert("training/losses".into(), Result { values, tolerance });
    results
}

/// What guides are made of, by encoder and depth head of random weights: the published ones are not in the program.
fn inverse_depth(frame: &Frame) -> Result {
    let (width, height) = (frame.rgb.width() as usize, frame.rgb.height() as usize);
    let image = Image::new(width, height, Channels::Rgb, frame.rgb.as_raw()).unwrap();
    let network = depth_anything::network();
    let (values, (height, width)) = network
        .inverse_depth(&image, DepthAnything::SHORT_SIDE)
        .unwrap();
    let largest = values.iter().fold(0.0, |most: f32, v| most.max(*v));
    assert!(largest > 0.0);
    Result {
        values: grid(&DepthMap::new(width, height, values).unwrap()),
        tolerance: TOLERANCE * largest,
    }
}

/// The losses of the first steps of a training, which its gradients decide.
fn trained() -> Vec<f32> {
    let folder = tempfile::tempdir().unwrap();
    let settings = [
        "data.rooms.width=64",
        "data.rooms.height=48",
        "data.rooms.train=8",
        "train.steps=4",
        "train.optimiser=sgd",
        "train.held_out=0",
        "train.calibrate=false",
    ];
    let settings = settings.map(String::from);
    let config = Config::load(Some("smoke.toml".as_ref()), &settings).unwrap();
    let frames = config.data.open(Split::Train, None).unwrap();
    let fit = config.fit.over(&FitConfig::default()).unwrap();
    let devices = [Device::flex()];
    let (network, train) = (config.network(), config.train);
    let trainer = Trainer::new(folder.path(), network, fit, train, frames, &devices).unwrap();
    let mut losses = Vec::new();
    let mut hear = |event: &TrainingEvent| {
        if let TrainingEvent::Step { loss, .. } = event {
            losses.push(*loss as f32);
        }
    };
    trainer.run(&AtomicBool::new(false), &mut hear).unwrap();
    losses
}

fn file() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("crates/weights/golden/depths.safetensors")
}

fn read() -> BTreeMap<String, Vec<f32>> {
    let bytes = std::fs::read(file()).unwrap();
    let tensors = SafeTensors::deserialize(&bytes).unwrap().tensors();
    let values = |view: &TensorView<'_>| {
        let (numbers, _) = view.data().as_chunks::<4>();
        numbers
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect()
    };
    tensors
        .iter()
        .map(|(name, view)| (name.clone(), values(view)))
        .collect()
}

fn write(golden: &BTreeMap<String, Vec<f32>>) {
    let bytes: BTreeMap<&String, Vec<u8>> = golden
        .iter()
        .map(|(name, values)| (name, values.iter().flat_map(|v| v.to_le_bytes()).collect()))
        .collect();
    let views = bytes.iter().map(|(name, bytes)| {
        (
            *name,
            TensorView::new(Dtype::F32, vec![bytes.len() / 4], bytes).unwrap(),
        )
    });
    std::fs::write(file(), safetensors::serialize(views, None).unwrap()).unwrap();
}

/// How the tolerance of this level compares with that of the levels that the file is made at.
fn allowance() -> f32 {
    match Level::here() {
        Level::Portable => TOLERANCE_PORTABLE / TOLERANCE,
        Level::Neon | Level::Avx2 | Level::Avx512 => 1.0,
    }
}

/// The largest difference in multiples of the tolerance; infinite for another number of values or one that is none.
fn difference(golden: Option<&Vec<f32>>, found: &Result) -> f32 {
    let Some(golden) = golden.filter(|golden| golden.len() == found.values.len()) else {
        return f32::INFINITY;
    };
    let pairs = golden.iter().zip(&found.values);
    let tolerance = allowance() * found.tolerance;
    pairs.fold(0.0, |most: f32, (a, b)| {
        let apart = if a == b || (a.is_nan() && b.is_nan()) {
            0.0
        } else {
            (a - b).abs() / tolerance
        };
        most.max(if apart.is_nan() { f32::INFINITY } else { apart })
    })
}

fn updates() -> bool {
    std::env::var_os("LSDC_UPDATE_GOLDEN").is_some()
}

#[test]
fn depths_are_the_golden_ones() {
    let found = compute();
    let mut golden = read();
    // Fits of the logarithm were removed after 0.2.0. Their results stay in the file, whose hash identifies numerics that
    // did not change.
    for name in ["default/random/log", "small/random/log"] {
        golden.remove(name);
    }
    if updates() {
        golden.retain(|name, _| found.contains_key(name));
        for (name, found) in &found {
            if difference(golden.get(name), found) > 1.0 {
                golden.insert(name.clone(), found.values.clone());
            }
        }
        write(&golden);
    }
    let differences: Vec<(f32, &String)> = found
        .iter()
        .map(|(name, found)| (difference(golden.get(name), found), name))
        .collect();
    let largest = differences
        .iter()
        .fold(0.0, |most: f32, (apart, _)| most.max(*apart));
    println!(
        "{}: {} results, largest difference {largest:.3} of the tolerance",
        Level::here().name(),
        found.len()
    );
    let wrong: Vec<_> = differences
        .iter()
        .filter(|(apart, _)| *apart > 1.0)
        .collect();
    assert!(
        wrong.is_empty() && golden.len() == found.len(),
        "{} of {} results at {} are not the golden ones, apart by so many tolerances: {wrong:?}\n\
         If that is meant: LSDC_UPDATE_GOLDEN=1 cargo test --release --test golden_depths",
        wrong.len(),
        golden.len(),
        Level::here().name(),
    );
}

#[test]
fn depths_are_the_golden_ones_at_every_other_level() {
    if updates() {
        return;
    }
    let others = Level::ALL
        .into_iter()
        .filter(|level| level.is_available() && *level != Level::here());
    for level in others {
        let run = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "depths_are_the_golden_ones", "--nocapture"])
            .env("LSDC_SIMD", level.name())
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&run.stdout) + String::from_utf8_lossy(&run.stderr);
        print!("{text}");
        assert!(run.status.success(), "{text}");
        assert!(text.contains(&format!("{}: ", level.name())));
    }
}

#[test]
fn the_golden_file_identifies_the_numerics() {
    let bytes = std::fs::read(file()).unwrap();
    assert!(bytes.len() < 300_000, "{}", bytes.len());
    let numerics = provenance::numerics();
    assert_eq!(numerics["golden"], lsdc_weights::golden());
    assert_eq!(numerics["simd"], Level::here().name());
}
