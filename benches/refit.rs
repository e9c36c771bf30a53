//! Percentiles of the times of further fits to one image, in which a tenth of the points is replaced before each fit.
//!
//!     cargo bench --bench refit -- [WIDTHxHEIGHT [POINTS]]

#![allow(clippy::print_stdout)]

use lsdc::process::keep_pages;
use lsdc_core::{Completer, Observations, Weights};
use lsdc_eval::data::{Dataset as _, Rooms, RoomsConfig, Split};
use lsdc_eval::predict::scene;
use lsdc_eval::sampling::Pattern;
use std::error::Error;
use std::hint::black_box;
use std::time::{Duration, Instant};

const FITS: usize = 400;

fn main() -> Result<(), Box<dyn Error>> {
    keep_pages();
    let mut args = std::env::args().skip(1).filter(|arg| !arg.starts_with('-'));
    let size = args.next().unwrap_or_else(|| "304x228".into());
    let (width, height) = size.split_once('x').ok_or("a size is WIDTHxHEIGHT")?;
    let count: usize = args.next().map_or(Ok(2000), |points| points.parse())?;
    let config = RoomsConfig {
        width: width.parse()?,
        height: height.parse()?,
        ..RoomsConfig::default()
    };
    let frame = Rooms::new(Split::Val, &config)?.load(0)?;
    // Thirty parts that cover the whole image, ten of them at a time.
    let all = Observations::from_map(&Pattern::Exactly(3 * count).draw(&frame, 0)?);
    let drawn = |fit: usize| -> Observations {
        let points = all.iter().enumerate();
        let present = points.filter(|(i, _)| (i + 30 - fit % 30) % 30 < 10);
        present.map(|(_, point)| *point).collect()
    };
    let prepared = scene(&Completer::new(&Weights::builtin())?, &frame.rgb)?;
    black_box(prepared.complete(&drawn(0))?.depth()?);
    let mut times: Vec<Duration> = (1..=FITS)
        .map(|fit| {
            let points = drawn(fit);
            let start = Instant::now();
            black_box(prepared.complete(black_box(&points))?.depth()?);
            Ok(start.elapsed())
        })
        .collect::<Result<_, lsdc_core::Error>>()?;
    times.sort_unstable();
    let percentile = |share: usize| times[(FITS - 1) * share / 100];
    println!("{size}, {count} points, {FITS} fits with new maps");
    for share in [50, 90, 99] {
        println!("{share} %: {:.1?}", percentile(share));
    }
    Ok(())
}
