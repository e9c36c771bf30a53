//! Measures the effect of guides: completes frames of known depth with good and bad predictions derived from that depth, and
//! prints the RMSE and its ratio to the RMSE without a guide.
//!
//!     cargo run --release --example guides -- FRAMES/*.jpg        # beside each, its NAME_depth.png in millimetres

#![allow(clippy::print_stdout)]

use lsdc_core::{Completer, DepthGuide, GuideKind, Observations, Weights};
use lsdc_eval::data::{DepthMap, Frame, read_depth, read_rgb};
use lsdc_eval::metrics::{Metric, Rules, Scores};
use lsdc_eval::predict::guided_scene;
use lsdc_eval::sampling::Pattern;
use lsdc_files::error::{Error, Result};
use lsdc_rng::Rng;
use std::path::Path;

/// Numbers of points, each with its number of draws.
const POINTS: [(usize, u64); 4] = [(5, 3), (20, 2), (50, 1), (500, 1)];

/// Makes a prediction from the true depths of a frame and of another frame.
type Prediction = fn(&DepthMap, &DepthMap) -> Vec<f32>;

const GUIDES: [(&str, GuideKind, Prediction); 8] = [
    ("perfect", GuideKind::Depth, |truth, _| {
        truth.values().to_vec()
    }),
    ("other scale and shift", GuideKind::Depth, |truth, _| {
        each(truth, |d| 0.3 * d + 2.0)
    }),
    ("disparity, shifted", GuideKind::Disparity, |truth, _| {
        each(truth, |d| 7.0 / d - 1.0)
    }),
    ("logarithm, scaled", GuideKind::Log, |truth, _| {
        each(truth, |d| 0.4 * d.ln() - 3.0)
    }),
    ("warped by 6 pixels", GuideKind::Depth, |truth, _| {
        warped(truth)
    }),
    ("blurred, 13x13", GuideKind::Depth, |truth, _| {
        blurred(truth, 6)
    }),
    ("15 % of noise", GuideKind::Depth, |truth, _| noisy(truth)),
    ("of another image", GuideKind::Depth, |_, other| {
        other.values().to_vec()
    }),
];

fn main() -> Result<()> {
    let frames: Vec<Frame> = std::env::args()
        .skip(1)
        .map(|name| {
            let rgb = read_rgb(Path::new(&name))?;
            let depth = name.replace(".jpg", "_depth.png");
            Frame::new(name, rgb, read_depth(Path::new(&depth), 0.001)?)
        })
        .collect::<Result<_>>()?;
    if frames.is_empty() {
        return Err(Error::config(
            "expected images, NAME.jpg, each beside NAME_depth.png",
        ));
    }
    let completer = Completer::new(&Weights::builtin())?;
    let mut sums = [[0.0; GUIDES.len() + 1]; POINTS.len()];
    for (i, frame) in frames.iter().enumerate() {
        let other = &frames[(i + 1) % frames.len()].depth;
        let guide = |(_, kind, prediction): (&str, GuideKind, Prediction)| {
            let values = prediction(&frame.depth, other);
            let shape = if values.len() == frame.depth.values().len() {
                &frame.depth
            } else {
                other
            };
            DepthGuide::new(kind, shape.width(), shape.height(), &values).map(Some)
        };
        let guides: Vec<Option<DepthGuide>> = GUIDES
            .map(guide)
            .into_iter()
            .collect::<std::result::Result<_, _>>()?;
        for (k, guide) in std::iter::once(&None).chain(&guides).enumerate() {
            let scene = guided_scene(&completer, &frame.rgb, guide.as_ref())?;
            for ((points, draws), sums) in POINTS.into_iter().zip(&mut sums) {
                for seed in 0..draws {
                    let sparse = Pattern::Exactly(points).draw(frame, seed)?;
                    let found = scene.complete(&Observations::from_map(&sparse))?.depth()?;
                    let scores = Scores::of(&found, &frame.depth, &Rules::default())?;
                    sums[k] += scores[Metric::Rmse] / (draws as usize * frames.len()) as f64;
                }
            }
        }
    }
    let heads = POINTS.map(|(points, _)| format!("{points} points"));
    println!("| guide | {} |", heads.join(" | "));
    let names = std::iter::once("none").chain(GUIDES.map(|(name, ..)| name));
    for (k, name) in names.enumerate() {
        let cells = sums.map(|sums| format!("{:.3} ({:.2})", sums[k], sums[k] / sums[0]));
        println!("| {name} | {} |", cells.join(" | "));
    }
    Ok(())
}

/// Applies a function to each depth; NaN at pixels without depth.
fn each(truth: &DepthMap, of: impl Fn(f32) -> f32) -> Vec<f32> {
    let value = |d: &f32| if *d > 0.0 { of(*d) } else { f32::NAN };
    truth.values().iter().map(value).collect()
}

fn warped(truth: &DepthMap) -> Vec<f32> {
    let (width, height) = (truth.width(), truth.height());
    let pixel = |i: usize| {
        let (x, y) = ((i % width) as f64, (i / width) as f64);
        let inside = |v: f64, length: usize| v.clamp(0.0, (length - 1) as f64) as usize;
        let moved = [x + 6.0 * (y / 25.0).sin(), y + 6.0 * (x / 31.0).cos()];
        truth.at(inside(moved[0], width), inside(moved[1], height))
    };
    (0..width * height).map(pixel).collect()
}

fn blurred(truth: &DepthMap, radius: usize) -> Vec<f32> {
    let (width, height) = (truth.width(), truth.height());
    let pixel = |i: usize| {
        let (x, y) = (i % width, i / width);
        let rows = y.saturating_sub(radius)..(y + radius + 1).min(height);
        let columns = x.saturating_sub(radius)..(x + radius + 1).min(width);
        let around = rows.flat_map(|y| columns.clone().map(move |x| truth.at(x, y)));
        let known: Vec<f32> = around.filter(|d| *d > 0.0).collect();
        known.iter().sum::<f32>() / known.len() as f32
    };
    (0..width * height).map(pixel).collect()
}

fn noisy(truth: &DepthMap) -> Vec<f32> {
    let mut rng = Rng::stream(0, &["noise"]);
    let values = truth.values().iter();
    values
        .map(|d| d * (1.0 + 0.15 * rng.normal()).max(0.1))
        .collect()
}
