//! A robot that looks at one place while its points change: the network runs once, and each set of points needs a fit. Depths
//! are written into a reused buffer.
//!
//!     cargo run --release -p lsdc-core --example robot

#![allow(clippy::print_stdout, clippy::unwrap_used)]

#[path = "room/mod.rs"]
mod files;

use lsdc_core::{Channels, Completer, Image, Observations, Weights};
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let rgb = files::image()?;
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let points = files::points(width)?;

    let completer = Completer::new(&Weights::builtin())?;
    let scene = completer.scene(&Image::new(width, height, Channels::Rgb, rgb.as_raw())?)?;
    let mut depth = vec![0.0_f32; width * height];
    let mut errors = Vec::new();
    for frame in 0..10 {
        // A different tenth of the points each time.
        let some: Observations = points.iter().skip(frame).step_by(10).copied().collect();
        let completion = scene.complete(&some)?;
        completion.write_depth(width, height, width, &mut depth)?;
        let off = |p: &lsdc_core::Observation| {
            let found = depth[p.v as usize * width + p.u as usize];
            f64::from((found - p.depth).abs())
        };
        let mean = points.iter().map(off).sum::<f64>() / points.len() as f64;
        println!(
            "frame {frame}: {} points, fit {:.0} ms, mean error at all points {mean:.3} m",
            some.len(),
            completion.report().fit.as_secs_f64() * 1e3
        );
        errors.push(mean);
    }
    println!(
        "the network took {:.0} ms, once",
        scene.network_time().as_secs_f64() * 1e3
    );
    assert!(errors.iter().all(|error| *error < 0.25), "{errors:?}");
    Ok(())
}
